"""Grey-scale morphology that knows holes: a NaN cell neither lowers nor raises its neighbours, and is left alone."""

from __future__ import annotations

import numpy as np
from numba import njit, prange


@njit(cache=True)
def _running_extreme(line: np.ndarray, radius: int, sign: float, out: np.ndarray, queue: np.ndarray) -> None:
    """Maximum of ``sign * line`` over windows of +-radius with a monotonic queue; NaN where a window is all NaN."""
    n = len(line)
    head, tail = 0, 0
    for i in range(n + radius):
        if i < n and not np.isnan(line[i]):
            while tail > head and sign * line[queue[tail - 1]] <= sign * line[i]:
                tail -= 1
            queue[tail] = i
            tail += 1
        j = i - radius
        if j >= 0:
            while head < tail and queue[head] < j - radius:
                head += 1
            out[j] = line[queue[head]] if tail > head else np.nan


@njit(cache=True, parallel=True)
def windowed_extreme(H: np.ndarray, radius: int, maximum: bool) -> np.ndarray:
    """Minimum or maximum over the (2 radius + 1)-square window of every cell, ignoring NaN."""
    rows, cols = H.shape
    sign = 1.0 if maximum else -1.0
    along = np.empty_like(H)
    out = np.empty_like(H)
    for y in prange(rows):
        _running_extreme(H[y], radius, sign, along[y], np.empty(cols + 1, np.int64))
    for x in prange(cols):
        column = along[:, x].copy()
        result = np.empty(rows, H.dtype)
        _running_extreme(column, radius, sign, result, np.empty(rows + 1, np.int64))
        out[:, x] = result
    return out


@njit(cache=True)
def opening(H: np.ndarray, radius: int) -> np.ndarray:
    """Erosion then dilation by a square; NaN cells stay NaN."""
    opened = windowed_extreme(windowed_extreme(H, radius, False), radius, True)
    rows, cols = H.shape
    for y in range(rows):
        for x in range(cols):
            if np.isnan(H[y, x]):
                opened[y, x] = np.nan
    return opened
