"""A network's input looked at whole or in overlapping windows, and the answers put back onto the pixels of the picture.

The resized picture has its upper left corner in that of the input; both show the same extent, so that a pixel centre
x + 0.5 of the picture lies at (x + 0.5) * w / W of the input.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64

from excavatwin.backbones.segmenters.readings import Reading
from excavatwin.backbones.segmenters.resampling import centres

#: Interpolated values held at once (float32: 64 MB).
_AT_ONCE = 1 << 24


@dataclass(frozen=True)
class Window:
    """Part of a network's input: rows top..bottom and columns left..right [px]."""

    top: int
    bottom: int
    left: int
    right: int

    @classmethod
    def whole(cls, shape: tuple[int, int]) -> Window:
        """All of an input (h, w)."""
        return cls(0, shape[0], 0, shape[1])

    @property
    def rows(self) -> slice:
        """Its rows of the input."""
        return slice(self.top, self.bottom)

    @property
    def columns(self) -> slice:
        """Its columns of the input."""
        return slice(self.left, self.right)


def split(shape: tuple[int, int], side: int) -> list[Window]:
    """Squares of ``side`` along the longer side of an input, whose shorter side they span, evenly overlapping.

    As many as are needed to cover it: the windows of EoMT's semantic inference (Kerssies et al., CVPR 2025).
    """
    long = max(shape)
    count = -(-long // side)
    starts = [i * (long - side) // max(count - 1, 1) for i in range(count)]
    if shape[0] > shape[1]:
        return [Window(start, start + side, 0, shape[1]) for start in starts]
    return [Window(0, shape[0], start, start + side) for start in starts]


def gathered(
    readings: Sequence[Reading],
    windows: Sequence[Window],
    shape: tuple[int, int],
    size: tuple[int, int],
    columns: Float32[np.ndarray, "V C"],
) -> Float32[np.ndarray, "H W C"]:
    """``sum_v p(v) columns[v]`` on the pixels of a picture, the mean of the windows that show a pixel.

    Args:
        readings: what the network said, one for each window.
        windows: of the input.
        shape: (h, w) of the part of the input that shows the picture, from its upper left corner.
        size: (H, W) of the picture.
        columns: weights of the V classes.
    """
    import torch

    total = np.zeros((*size, columns.shape[1]), np.float32)
    times = np.zeros(size, np.float32)
    y, x = centres(size[0], shape[0]), centres(size[1], shape[1])
    with torch.inference_mode():
        for reading, window in zip(readings, windows, strict=True):
            rows, at_y = _inside(y, window.top, window.bottom, reading.grid[0])
            cols, at_x = _inside(x, window.left, window.right, reading.grid[1])
            for strip in _strips(len(at_y), reading.depth * max(len(at_x), 1)):
                there = slice(rows.start + strip.start, rows.start + strip.stop)
                values = reading.at(at_y[strip], at_x, columns)
                total[there, cols] += values.permute(1, 2, 0).cpu().numpy()
            times[rows, cols] += 1
    return total / times[..., None]


def _inside(at: Float64[np.ndarray, "n"], first: int, last: int, cells: int) -> tuple[slice, Float64[np.ndarray, "m"]]:
    """Pixels whose centres lie in a window, and where they lie on its grid of ``cells`` cells."""
    start, stop = np.searchsorted(at, [first, last])
    return slice(int(start), int(stop)), (at[start:stop] - first) * (cells / (last - first))


def _strips(rows: int, row: int) -> Iterator[slice]:
    """Rows in as many strips as keep ``row`` values per row within memory."""
    step = max(1, _AT_ONCE // row)
    return (slice(start, min(start + step, rows)) for start in range(0, rows, step))
