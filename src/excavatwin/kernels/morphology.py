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


@njit(cache=True, parallel=True)
def disc_drop(H: np.ndarray, outside: np.ndarray, reach: int) -> np.ndarray:
    """Height of every cell above the lowest cell of ``outside`` within ``reach`` cells of it; 0 where there is none."""
    rows, cols = H.shape
    drop = np.zeros((rows, cols), H.dtype)
    for y in prange(rows):
        for x in range(cols):
            lowest = np.inf
            for dy in range(-reach, reach + 1):
                for dx in range(-reach, reach + 1):
                    v, u = y + dy, x + dx
                    if dy * dy + dx * dx > reach * reach or v < 0 or v >= rows or u < 0 or u >= cols:
                        continue
                    if outside[v, u] and H[v, u] < lowest:
                        lowest = H[v, u]
            if lowest < np.inf and H[y, x] > lowest:
                drop[y, x] = H[y, x] - lowest
    return drop


@njit(cache=True, parallel=True)
def step_across(H: np.ndarray, region: np.ndarray, reach: int) -> np.ndarray:
    """Height of every rim cell of a region above the nearest cell of another region within ``reach`` cells.

    Rim cells have a cell that is not of their region among their 8 neighbours; others, and those with no other region
    in reach, are NaN. Regions are ids >= 0.
    """
    rows, cols = H.shape
    step = np.full((rows, cols), np.nan, H.dtype)
    for y in prange(rows):
        for x in range(cols):
            own = region[y, x]
            if own < 0:
                continue
            rim = False
            for v in range(max(0, y - 1), min(rows, y + 2)):
                for u in range(max(0, x - 1), min(cols, x + 2)):
                    rim = rim or region[v, u] != own
            if not rim:
                continue
            nearest = reach * reach + 1
            for dy in range(-reach, reach + 1):
                for dx in range(-reach, reach + 1):
                    v, u = y + dy, x + dx
                    if v < 0 or v >= rows or u < 0 or u >= cols or region[v, u] < 0 or region[v, u] == own:
                        continue
                    if dy * dy + dx * dx < nearest:
                        nearest = dy * dy + dx * dx
                        step[y, x] = H[y, x] - H[v, u]
    return step


@njit(cache=True)
def grow_without_rising(H: np.ndarray, region: np.ndarray, allowed: np.ndarray, rise: float) -> np.ndarray:
    """Regions (ids > 0) grown over the ``allowed`` cells, from cell to 8-neighbour that is at most ``rise`` higher."""
    rows, cols = H.shape
    grown = region.copy()
    queue = np.empty(rows * cols, np.int64)
    head, tail = 0, 0
    for y in range(rows):
        for x in range(cols):
            if grown[y, x] > 0:
                queue[tail] = y * cols + x
                tail += 1
    while head < tail:
        y, x = queue[head] // cols, queue[head] % cols
        head += 1
        for v in range(max(0, y - 1), min(rows, y + 2)):
            for u in range(max(0, x - 1), min(cols, x + 2)):
                if grown[v, u] == 0 and allowed[v, u] and H[v, u] <= H[y, x] + rise:
                    grown[v, u] = grown[y, x]
                    queue[tail] = v * cols + u
                    tail += 1
    return grown
