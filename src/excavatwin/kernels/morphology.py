"""Grey-scale morphology that knows holes: a NaN cell neither lowers nor raises its neighbours, and is left alone."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

#: Columns that one thread works on at a time: a strip of them stays in the first-level cache.
STRIP = 64


@njit(cache=True, parallel=True)
def _vertical_minimum(A: np.ndarray, radius: int) -> np.ndarray:
    """Minimum over the 2 radius + 1 rows around every row (van Herk, 1992; Gil and Werman, 1993); no NaN allowed.

    Windows are cut into blocks of their own length: a running minimum from the block's start and one from its end meet
    in every window, so the cost does not depend on the radius. The inner loop runs along a row.
    """
    rows, cols = A.shape
    width = 2 * radius + 1
    padded = -(-(rows + 2 * radius) // width) * width
    out = np.empty_like(A)
    for strip in prange(-(-cols // STRIP)):
        left = strip * STRIP
        n = min(STRIP, cols - left)
        ahead = np.full((padded, n), np.inf, A.dtype)
        for y in range(rows):
            for x in range(n):
                ahead[radius + y, x] = A[y, left + x]
        back = ahead.copy()
        for y in range(1, padded):
            if y % width:
                for x in range(n):
                    ahead[y, x] = min(ahead[y, x], ahead[y - 1, x])
        for y in range(padded - 2, -1, -1):
            if (y + 1) % width:
                for x in range(n):
                    back[y, x] = min(back[y, x], back[y + 1, x])
        for y in range(rows):
            for x in range(n):
                out[y, left + x] = min(back[y, x], ahead[y + 2 * radius, x])
    return out


@njit(cache=True)
def windowed_extreme(H: np.ndarray, radius: int, maximum: bool) -> np.ndarray:
    """Minimum or maximum over the (2 radius + 1)-square window of every cell, ignoring NaN; NaN where all are."""
    sign = -1.0 if maximum else 1.0
    A = np.empty_like(H)
    for y in range(H.shape[0]):
        for x in range(H.shape[1]):
            A[y, x] = np.inf if np.isnan(H[y, x]) else sign * H[y, x]
    low = _vertical_minimum(np.ascontiguousarray(_vertical_minimum(A, radius).T), radius).T
    out = np.empty_like(H)
    for y in range(H.shape[0]):
        for x in range(H.shape[1]):
            out[y, x] = np.nan if low[y, x] == np.inf else sign * low[y, x]
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
