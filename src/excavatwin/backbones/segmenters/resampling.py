"""Values on a network's coarse grid, read at the centres of a picture's pixels; centres lie at +0.5 on both sides."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Float32, Float64, Int64

if TYPE_CHECKING:
    from torch import Tensor


def centres(count: int, onto: int) -> Float64[np.ndarray, "count"]:
    """Where the centres of ``count`` pixels lie along an axis that shows the same extent with ``onto`` pixels [px]."""
    return (np.arange(count) + 0.5) * (onto / count)


def neighbours(
    at: Float64[np.ndarray, "n"], size: int
) -> tuple[Int64[np.ndarray, "n"], Int64[np.ndarray, "n"], Float32[np.ndarray, "n"]]:
    """Indices of the two cells around each coordinate, and the share of the second; constant beyond the border."""
    place = np.clip(at - 0.5, 0, size - 1)
    first = np.floor(place).astype(np.int64)
    return first, np.minimum(first + 1, size - 1), (place - first).astype(np.float32)


def bilinear(
    values: Float[Tensor, "C h w"], y: Float64[np.ndarray, "n"], x: Float64[np.ndarray, "m"]
) -> Float[Tensor, "C n m"]:
    """Values at the points (x, y) of a grid whose pixel centres lie at +0.5, constant beyond the outer centres.

    With ``y = centres(n, h)`` and ``x = centres(m, w)`` this is ``interpolate(..., align_corners=False)``; rows and
    columns are given so that windows and paddings of a picture can be read, and a picture strip by strip.
    """
    return _along(_along(values, y, 1), x, 2)


def _along(values: Float[Tensor, "..."], at: Float64[np.ndarray, "n"], axis: int) -> Float[Tensor, "..."]:
    """Linear interpolation along one axis; indices and weights are made in float64, whatever the device can do."""
    import torch

    first, second, share = (torch.from_numpy(part).to(values.device) for part in neighbours(at, values.shape[axis]))
    weight = share.reshape([-1 if a == axis else 1 for a in range(values.ndim)])
    here, following = values.index_select(axis, first), values.index_select(axis, second)
    return here + (following - here) * weight
