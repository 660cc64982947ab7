"""Whether a segmenter's network is fed what it was trained on: red first, not inverted, the right way round."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from excavatwin.backbones.conformance.calls import first_line
from excavatwin.backbones.conformance.report import Row, failed, judged, unchecked
from excavatwin.errors import ExcavatwinError

NAME = "prepare: input of the network"
SHAPE = (96, 160)
"""(H, W) of the cards [px]."""
_COLOURS = np.array(
    [(0, 0, 0), (255, 255, 255), (230, 20, 30), (25, 210, 40), (30, 50, 220), (200, 190, 20), (20, 180, 200),
     (190, 30, 200), (120, 80, 60), (60, 110, 150), (90, 160, 70), (160, 120, 200)], np.uint8,
)  # fmt: skip
_NAMES = ("red", "green", "blue")
Prepare = Callable[[UInt8[np.ndarray, "H W 3"]], Float32[np.ndarray, "3 h w"]]


@runtime_checkable
class Prepares(Protocol):
    """A segmenter that shows what its network is fed."""

    def prepare(self, image: UInt8[np.ndarray, "H W 3"]) -> Float32[np.ndarray, "3 h w"]:
        """The input of the network for an RGB picture."""
        ...


def prepare_row(segmenter: Any) -> Row:
    """Channels, normalisation and orientation of what the network is fed, proved by cards of known colours."""
    if not isinstance(segmenter, Prepares):
        return unchecked(NAME, "the class has no prepare(image) -> Float32 (3, h, w), which would show it.")
    try:
        return judged(NAME, _mistakes(segmenter.prepare), "RGB, affine with positive slope, the right way round")
    except ExcavatwinError as error:
        return unchecked(NAME, str(error))
    except Exception as error:
        return failed(NAME, f"prepare() raised {type(error).__name__}: {first_line(error)}.")


def _mistakes(prepare: Prepare) -> Iterator[str]:
    flat = [prepare(np.full((*SHAPE, 3), colour, np.uint8)) for colour in _COLOURS]
    shape = _shape_mistake(flat[0])
    if shape:
        yield shape
        return
    wrong = list(_colour_mistakes(np.stack([_middle(one) for one in flat])))
    yield from wrong
    if not wrong:
        yield from _direction_mistakes(prepare)


def _shape_mistake(made: Any) -> str:
    if not isinstance(made, np.ndarray) or made.dtype != np.float32:
        return f"prepare() gives {getattr(made, 'dtype', type(made).__name__)}; expected a float32 NumPy array"
    if made.ndim != 3 or made.shape[0] != 3:
        hint = ": the channels must come first" if made.ndim == 3 and made.shape[-1] == 3 else ""
        return f"prepare() gives shape {made.shape}; expected (3, h, w){hint}"
    h, w = made.shape[1:]
    if h > w:
        return f"a picture {SHAPE[1]} px wide and {SHAPE[0]} high becomes {w} wide and {h} high: H and W are swapped"
    return ""


def _middle(made: Float32[np.ndarray, "3 h w"]) -> Float64[np.ndarray, "3"]:
    h, w = made.shape[1:]
    return np.median(made[:, h * 2 // 5 : h * 3 // 5 + 1, w * 2 // 5 : w * 3 // 5 + 1].astype(float), axis=(1, 2))


def _colour_mistakes(made: Float64[np.ndarray, "n 3"]) -> Iterator[str]:
    """Regression of what the network is fed on the colours of the cards."""
    card = np.column_stack([_COLOURS / 255.0, np.ones(len(_COLOURS))])
    if not np.isfinite(made).all() or np.ptp(made, axis=0).min() < 1e-6:
        yield "the input of the network does not depend on all three colours"
        return
    found = np.linalg.lstsq(card, made, rcond=None)[0]
    mix = found[:3].T
    rest = np.abs(card @ found - made).max() / np.ptp(made)
    if rest > 0.02:
        yield f"values are not normalised by one factor and one offset a channel (off by {rest:.0%} of their range)"
        return
    order = [int(np.abs(row).argmax()) for row in mix]
    leak = np.abs(mix[np.arange(3), order]) < 20 * (np.abs(mix).sum(axis=1) - np.abs(mix[np.arange(3), order]))
    if leak.any() or len(set(order)) < 3:
        yield "channels are mixtures of red, green and blue"
    elif order == [2, 1, 0]:
        yield "the channels are BGR: the network is fed blue as red; reverse the last axis of the picture"
    elif order != [0, 1, 2]:
        yield f"the channels are {', '.join(_NAMES[one] for one in order)}; expected red, green, blue"
    if (mix[np.arange(3), order] <= 0).any():
        yield "larger values become smaller ones: the normalisation has a negative slope"


def _direction_mistakes(prepare: Prepare) -> Iterator[str]:
    """Cards that grow brighter to the right, or downwards; padding cancels against a grey card."""
    grey = prepare(np.full((*SHAPE, 3), 128, np.uint8))
    for axis, way, back in ((1, "to the right", "left and right are"), (0, "downwards", "up and down are")):
        line = np.linspace(0, 255, SHAPE[axis]).round().astype(np.uint8)
        shape = (1, -1) if axis == 1 else (-1, 1)
        card = np.ascontiguousarray(np.broadcast_to(line.reshape(*shape, 1), (*SHAPE, 3)))
        grown = (prepare(card) - grey).mean(axis=0, dtype=float)
        down, right = (np.polyfit(np.arange(side), grown.mean(axis=1 - i), 1)[0] * side
                       for i, side in enumerate(grown.shape))  # fmt: skip
        along, across = (right, down) if axis == 1 else (down, right)
        if abs(across) > abs(along):
            yield f"a card that grows brighter {way} does so in the other direction: H and W are swapped"
            return
        if along <= 0:
            yield f"a card that grows brighter {way} grows darker: {back} exchanged"
