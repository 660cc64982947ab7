"""Pictures as the networks of Hugging Face's transformers want them, by the file that lies beside their weights.

We do it ourselves and not by their image processors, because we must know where every pixel went.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, UInt8

from excavatwin.backbones.lattices import IMAGENET, normalised
from excavatwin.errors import InputError


@dataclass(frozen=True)
class Preparation:
    """Size, filter and normalisation of a network's input; the defaults are the library's documented ones."""

    shortest: int
    """Shorter side of the resized picture [px]."""
    longest: int | None = None
    """The longer side does not exceed this [px]; None: no limit."""
    multiple: int = 1
    """Sides are rounded up to multiples of this; the picture is stretched by it, as the library does [px]."""
    resample: int = 2
    """Filter by Pillow's number: 2 bilinear, 3 bicubic; both with antialiasing where the picture shrinks."""
    scale: float = 1 / 255
    """What values 0..255 are multiplied by before the mean is taken away."""
    mean: tuple[float, float, float] = IMAGENET[0]
    """Of red, green and blue, after scaling."""
    std: tuple[float, float, float] = IMAGENET[1]
    """Of red, green and blue, after scaling."""

    def shape(self, height: int, width: int, long_side: int = 0) -> tuple[int, int]:
        """(h, w) of the resized picture; ``long_side`` > 0 stands above the sides of the weights [px]."""
        short, long = min(height, width), max(height, width)
        factor = long_side / long if long_side else self.shortest / short
        if not long_side and self.longest is not None:
            factor = min(factor, self.longest / long)

        def rounded(side: int) -> int:
            return max(1, math.ceil(round(side * factor) / self.multiple)) * self.multiple

        return rounded(height), rounded(width)

    def pixels(
        self, image: UInt8[np.ndarray, "H W 3"], shape: tuple[int, int], canvas: tuple[int, int] | None = None
    ) -> Float32[np.ndarray, "3 h w"]:
        """What the network sees: RGB, resized to ``shape``, in the upper left corner of a black ``canvas`` (h, w)."""
        from PIL import Image

        small = np.asarray(Image.fromarray(image).resize(shape[::-1], Image.Resampling(self.resample)))
        if canvas is not None and canvas != shape:
            small = np.pad(small, ((0, canvas[0] - shape[0]), (0, canvas[1] - shape[1]), (0, 0)))
        unit = 255 * self.scale
        r, g, b = (value / unit for value in self.mean)
        return normalised(small, (r, g, b), (self.std[0] / unit, self.std[1] / unit, self.std[2] / unit))


def read_settings(folder: Path) -> dict[str, Any]:
    """``preprocessor_config.json`` of a folder of weights; empty when it has none.

    Raises:
        InputError: the file is not JSON.
    """
    settings = read_json(folder / "preprocessor_config.json") or {}
    if not settings:
        settings = (read_json(folder / "processor_config.json") or {}).get("image_processor", {})
    return settings


def read_json(path: Path) -> dict[str, Any] | None:
    """A JSON table; None when there is no such file.

    Raises:
        InputError: it is not JSON.
    """
    if not path.is_file():
        return None
    try:
        table = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path} is not readable JSON ({error}); fetch the weights again.") from None
    if not isinstance(table, dict):
        raise InputError(f"{path} is not a JSON table; fetch the weights again.")
    return table


def preparation(settings: Mapping[str, Any], default: Preparation) -> Preparation:
    """What the settings say, and the default where they say nothing."""
    unscaled = settings.get("do_rescale") is False
    plain = settings.get("do_normalize") is False
    shortest, longest = _sides(settings, default)
    return replace(
        default,
        shortest=shortest,
        longest=longest,
        multiple=_given(settings, ("size_divisor", "size_divisibility"), default.multiple) or 1,
        resample=_given(settings, ("resample",), default.resample),
        scale=1.0 if unscaled else _given(settings, ("rescale_factor",), default.scale),
        mean=(0.0, 0.0, 0.0) if plain else tuple(_given(settings, ("image_mean",), default.mean)),
        std=(1.0, 1.0, 1.0) if plain else tuple(_given(settings, ("image_std",), default.std)),
    )


def _given(settings: Mapping[str, Any], names: tuple[str, ...], default: Any) -> Any:
    return next((settings[name] for name in names if settings.get(name) is not None), default)


def _sides(settings: Mapping[str, Any], default: Preparation) -> tuple[int, int | None]:
    """Shorter side and limit of the longer, from the forms that the library has had.

    Squares (height, width: SegFormer) become the shorter side: the picture keeps its shape, as in the evaluation of
    SegFormer's authors, where the library's own processor would squeeze it into the square.
    """
    size = settings.get("size")
    if isinstance(size, int):
        return size, settings.get("max_size")
    if not isinstance(size, Mapping):
        return default.shortest, default.longest
    if size.get("shortest_edge"):
        return int(size["shortest_edge"]), size.get("longest_edge") or settings.get("max_size")
    sides = [int(size[name]) for name in ("height", "width") if size.get(name)]
    return (min(sides), None) if sides else (default.shortest, default.longest)
