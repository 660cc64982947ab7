"""Finished labels of one photo, whatever file they came from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, Integer

#: Class of pixels that nobody labelled, and of ids that mean void.
VOID = -1


@dataclass(frozen=True)
class Labelled:
    """A picture of numbers that covers the photo, and what each number is."""

    index: Integer[np.ndarray, "h w"]
    """Number of each pixel, 0..n-1."""
    classes: Int64[np.ndarray, "n"]
    """Class of each number, as a place in the names of the source; -1 is void."""
    scores: Float32[np.ndarray, "n"]
    """How sure the labels are, in [0, 1]."""
    doubts: tuple[str, ...] = ()
    """What the user should know, without the photo's name."""


class LabelSource(Protocol):
    """A folder or file with labels of many photos."""

    @property
    def names(self) -> tuple[str, ...]:
        """The classes."""
        ...

    def of(self, photo: str, size: tuple[int, int]) -> Labelled | None:
        """Labels of a photo by its file name; None when it has none.

        Args:
            photo: file name.
            size: (width, height) of the photo as displayed [px].
        """
        ...


@dataclass(frozen=True)
class Instance:
    """One thing that was outlined."""

    place: int
    """Its class, as a place in the names of the source."""
    score: float
    """How sure it is, in [0, 1]."""
    area: float
    """Its size [px]."""
    mask: Callable[[], Bool[np.ndarray, "h w"]]
    """Draws it: masks of large photos are big, so they are not kept."""


def of_instances(instances: Sequence[Instance], size: tuple[int, int], doubts: tuple[str, ...] = ()) -> Labelled:
    """Instances painted over each other: the surest on top, of equally sure ones the smallest.

    Args:
        instances: in any order.
        size: (width, height) of the picture [px].
        doubts: what the user should know.
    """
    order = sorted(instances, key=lambda one: (one.score, -one.area, one.place))
    index = np.zeros((size[1], size[0]), np.int32)
    for number, one in enumerate(order, 1):
        index[one.mask()] = number
    classes = np.array([VOID, *(one.place for one in order)], np.int64)
    return Labelled(index, classes, np.array([0.0, *(one.score for one in order)], np.float32), doubts)


def polygon_area(corners: Float64[np.ndarray, "n 2"]) -> float:
    """Area inside a polygon."""
    x, y = corners.T
    return float(abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2)


def polygon_mask(corners: Float64[np.ndarray, "n 2"], width: int, height: int) -> Bool[np.ndarray, "h w"]:
    """Pixels whose centres lie inside a polygon; drawing libraries would add the pixels of its border.

    Args:
        corners: x, y [px], pixel centres at +0.5.
        width: of the mask [px].
        height: of the mask [px].
    """
    mask = np.zeros((height, width), bool)
    low = np.maximum(np.floor(corners.min(0)), 0).astype(int)
    high = np.minimum(np.ceil(corners.max(0)), (width, height)).astype(int)
    w, h = high - low
    if w <= 0 or h <= 0:
        return mask
    crossed = np.zeros((h, w + 1), np.int32)
    local = corners - low
    for (x0, y0), (x1, y1) in zip(local, np.roll(local, -1, axis=0), strict=True):
        first, last = np.ceil(np.clip([min(y0, y1), max(y0, y1)], 0, h) - 0.5).astype(int)
        if last <= first:
            continue
        rows = np.arange(first, last)
        x = x0 + (rows + 0.5 - y0) * (x1 - x0) / (y1 - y0)
        np.add.at(crossed, (rows, np.clip(np.ceil(x - 0.5), 0, w).astype(int)), 1)
    mask[low[1] : high[1], low[0] : high[0]] = np.cumsum(crossed, axis=1)[:, :w] % 2 == 1
    return mask
