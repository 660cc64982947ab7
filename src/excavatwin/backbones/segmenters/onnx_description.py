"""The small TOML that says how an ONNX model wants its pictures and what its numbers mean."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import UInt8

from excavatwin.backbones.lattices import Fit, Mode, fit, lattice_shape
from excavatwin.errors import InputError
from excavatwin.vocabularies import read_vocabulary

Layout = Literal["NCHW", "NHWC"]
Kind = Literal["logits", "sigmoid", "probabilities", "labels"]
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Description:
    """How a model is fed and read. Each field is a key of the TOML file; only ``model`` and ``classes`` are needed."""

    model: Path
    """The ``.onnx`` file, relative to the TOML file."""
    classes: tuple[str, ...]
    """Names of the model's classes in the order of its channels (or labels), or the name of a shipped vocabulary."""
    ids: tuple[int, ...]
    """Label of each class, for ``kind = "labels"``: 0, 1, 2, ..., or the ids of the vocabulary. No key of its own."""
    input: str = ""
    """Name of the model's input; may be left out when there is one."""
    size: tuple[int, int] | None = None
    """(H, W) of its input [px]; may be left out when the model declares it, or with ``long_side``."""
    long_side: int | None = None
    """Long side of its input [px], for models that take any size."""
    multiple: int = 32
    """With ``long_side``: what the sides of its input are multiples of [px]."""
    resize: Mode = "stretch"
    """How a photo comes to that size: stretched, or at equal scale padded or cropped."""
    fill: int = 0
    """Value of the padding, 0..255."""
    layout: Layout = "NCHW"
    """Order of the axes of its input."""
    output_layout: Layout | None = None
    """Order of the axes of its output; as ``layout`` when left out."""
    colours: Literal["rgb", "bgr"] = "rgb"
    """Order of its channels."""
    scale: float = 255.0
    """What values 0..255 are divided by first."""
    mean: Triple = (0.0, 0.0, 0.0)
    """Subtracted after that, red, green, blue in this order, whatever ``colours`` says."""
    std: Triple = (1.0, 1.0, 1.0)
    """Divided by after that, in the same order."""
    output: str = ""
    """Name of the output that is used; may be left out when there is one."""
    kind: Kind = "logits"
    """What it holds: logits of classes that exclude each other (softmax), or do not (sigmoid), probabilities, or the
    label of each pixel."""
    mapping: str = ""
    """Class mapping; chosen by the names when left out."""
    remap: Mapping[str, str] = field(default_factory=dict)
    """Table: class -> task class, above the mapping."""

    def fit(self, size: tuple[int, int], declared: tuple[int | None, int | None]) -> Fit:
        """How a picture of ``size`` (width, height) becomes the input.

        Args:
            size: (width, height) of the picture [px].
            declared: (H, W) that the model declares, None where it takes any.

        Raises:
            InputError: the size is not known, or not the one that the model declares.
        """
        if self.size is None and self.long_side is not None:
            shape = lattice_shape(size, self.long_side, self.multiple, self.resize)
        elif self.size is not None:
            shape = self.size
        elif declared[0] is not None and declared[1] is not None:
            shape = (declared[0], declared[1])
        else:
            raise InputError(
                f"{self.model.name} takes pictures of any size; write size = [H, W] or long_side = 1024 in its TOML."
            )
        if any(d is not None and d != s for d, s in zip(declared, shape, strict=True)):
            raise InputError(
                f"{self.model.name} declares an input of {declared[0]} x {declared[1]} px (H x W), but its TOML makes "
                f"{shape[0]} x {shape[1]}; correct size."
            )
        return fit(size, shape, self.resize)

    def tensor(self, image: UInt8[np.ndarray, "H W 3"], kind: str) -> np.ndarray:
        """The input (1, ...) from an RGB image of its size.

        Args:
            image: RGB.
            kind: number type that the model declares, as onnxruntime names it.

        Raises:
            InputError: bytes are wanted, but the TOML scales them.
        """
        scaled = self.scale != 1 or any(self.mean) or set(self.std) != {1.0}
        if kind == "tensor(uint8)" and scaled:
            raise InputError(
                f"{self.model.name} takes bytes 0..255; write scale = 1 and neither mean nor std in its TOML."
            )
        mean, std = np.asarray(self.mean, np.float32), np.asarray(self.std, np.float32)
        values: np.ndarray = image if not scaled else (image.astype(np.float32) / np.float32(self.scale) - mean) / std
        values = values[..., ::-1] if self.colours == "bgr" else values
        values = values.transpose(2, 0, 1) if self.layout == "NCHW" else values
        types = {"tensor(uint8)": np.uint8, "tensor(float16)": np.float16, "tensor(float)": np.float32}
        return np.ascontiguousarray(values[None], types[kind])


def read_description(path: Path) -> Description:
    """The description of a model from its TOML file.

    Raises:
        InputError: the file is missing, not TOML, or a key is missing, unknown or wrong.
    """
    table = _table(path)
    names = {one.name for one in fields(Description)} - {"ids"}
    for key in table:
        if key not in names:
            near = difflib.get_close_matches(key, names, 1, 0.5)
            hint = f"did you mean {near[0]}?" if near else f"there are: {', '.join(sorted(names))}."
            raise InputError(f"{path} has a key {key!r} that is not known; {hint}")
    for key in ("model", "classes"):
        if key not in table:
            raise InputError(f'{path} has no {key!r}; write model = "FILE.onnx" and classes = [names] or a vocabulary.')
    model = path.parent / str(table["model"])
    if not model.is_file():
        raise InputError(
            f"{path} names the model {table['model']!r}, but there is no {model}; paths are relative to it."
        )
    classes, ids = _classes(table["classes"], path)
    given = {key: _CHECKS[key](value, key, path) for key, value in table.items() if key not in ("model", "classes")}
    description = Description(model=model, classes=classes, ids=ids, **given)
    highest = max(abs(value) for value in description.mean)
    if (description.scale > 2 and highest > 2) or (description.scale == 1 and 0 < highest <= 1):
        raise InputError(
            f"{path}: mean {list(description.mean)} does not fit scale = {description.scale:g}: it is subtracted after "
            "values 0..255 are divided by scale; write scale = 255 with means below 1, or scale = 1 with larger means."
        )
    return description


def _table(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text("utf-8"))
    except (OSError, UnicodeDecodeError):
        raise InputError(
            f"{str(path)!r} is not a readable file; give the TOML of an ONNX model (docs/labels-and-onnx.md)."
        ) from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path} is not valid TOML: {error}.") from None


def _classes(value: object, path: Path) -> tuple[tuple[str, ...], tuple[int, ...]]:
    if isinstance(value, str):
        vocabulary = read_vocabulary(value)
        if not vocabulary.names:
            raise InputError(f"{path}: the vocabulary {value} has no order; list the names of the classes instead.")
        return tuple(vocabulary.names.values()), tuple(vocabulary.names)
    if not isinstance(value, list) or not value or not all(isinstance(name, str) for name in value):
        raise InputError(f"{path}: classes is {value!r}; give a list of names, or the name of a shipped vocabulary.")
    return tuple(value), tuple(range(len(value)))


def _text(value: object, key: str, path: Path) -> str:
    if not isinstance(value, str):
        raise InputError(f"{path}: {key} is {value!r}; give text.")
    return value


def _choice(allowed: tuple[str, ...]) -> Any:
    def check(value: object, key: str, path: Path) -> str:
        if value not in allowed:
            raise InputError(f"{path}: {key} is {value!r}; give one of: {', '.join(allowed)}.")
        return str(value)

    return check


def _whole(low: int, high: int | None = None) -> Any:
    def check(value: object, key: str, path: Path) -> int:
        if type(value) is not int or value < low or (high is not None and value > high):
            raise InputError(f"{path}: {key} is {value!r}; give a whole number of at least {low}.")
        return value

    return check


def _size(value: object, key: str, path: Path) -> tuple[int, int]:
    if not isinstance(value, list) or len(value) != 2 or not all(type(v) is int and v > 0 for v in value):
        raise InputError(f"{path}: {key} is {value!r}; give [height, width] in pixels.")
    return value[0], value[1]


def _positive(value: object, key: str, path: Path) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not value > 0:
        raise InputError(f"{path}: {key} is {value!r}; give a number above 0.")
    return float(value)


def _triple(value: object, key: str, path: Path) -> Triple:
    numbers = isinstance(value, list) and len(value) == 3 and all(type(v) in (int, float) for v in value)
    if not numbers or (key == "std" and 0 in value):  # type: ignore[operator]
        raise InputError(
            f"{path}: {key} is {value!r}; give three numbers, for red, green and blue, of values after scale."
        )
    a, b, c = (float(v) for v in value)  # type: ignore[attr-defined]
    return a, b, c


def _remap(value: object, key: str, path: Path) -> dict[str, str]:
    if not isinstance(value, dict) or not all(isinstance(v, str) for v in value.values()):
        raise InputError(f'{path}: [{key}] is {value!r}; write one line per class: gravel = "construction_terrain".')
    return value


_LAYOUT = _choice(get_args(Layout))
#: How the value of each key is checked.
_CHECKS: dict[str, Any] = {
    "input": _text,
    "output": _text,
    "mapping": _text,
    "size": _size,
    "long_side": _whole(1),
    "multiple": _whole(1),
    "fill": _whole(0, 255),
    "resize": _choice(get_args(Mode)),
    "layout": _LAYOUT,
    "output_layout": _LAYOUT,
    "colours": _choice(("rgb", "bgr")),
    "kind": _choice(get_args(Kind)),
    "scale": _positive,
    "mean": _triple,
    "std": _triple,
    "remap": _remap,
}
