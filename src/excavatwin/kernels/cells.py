"""Statistics of the points in every cell of a grid."""

from __future__ import annotations

import numpy as np
from numba import njit, prange


@njit(cache=True)
def group_rows(cell: np.ndarray, n_cells: int) -> tuple[np.ndarray, np.ndarray]:
    """Counting sort: points ordered by cell, negative cells left out.

    Returns:
        (start (n_cells + 1,) of every cell in ``member``; member: point indices, ascending within a cell).
    """
    start = np.zeros(n_cells + 1, np.int64)
    for i in range(len(cell)):
        if cell[i] >= 0:
            start[cell[i] + 1] += 1
    for c in range(n_cells):
        start[c + 1] += start[c]
    cursor = start[:-1].copy()
    member = np.empty(start[n_cells], np.int64)
    for i in range(len(cell)):
        c = cell[i]
        if c >= 0:
            member[cursor[c]] = i
            cursor[c] += 1
    return start, member


@njit(cache=True, parallel=True)
def cell_quantile(value: np.ndarray, start: np.ndarray, member: np.ndarray, q: float) -> np.ndarray:
    """q-quantile (linear interpolation) of the values of every cell; NaN where a cell has none."""
    out = np.full(len(start) - 1, np.nan, np.float32)
    for c in prange(len(start) - 1):
        n = start[c + 1] - start[c]
        if n == 0:
            continue
        ordered = np.empty(n, np.float64)
        for m in range(n):
            ordered[m] = value[member[start[c] + m]]
        ordered.sort()
        position = q * (n - 1)
        low = int(np.floor(position))
        high = min(low + 1, n - 1)
        out[c] = ordered[low] + (position - low) * (ordered[high] - ordered[low])
    return out


@njit(cache=True, parallel=True)
def cell_spread(
    value: np.ndarray, weight: np.ndarray, centre: np.ndarray, start: np.ndarray, member: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Normalised median absolute deviation from ``centre`` and effective number of points (sum w)^2 / sum w^2."""
    spread = np.full(len(start) - 1, np.nan, np.float32)
    effective = np.zeros(len(start) - 1, np.float32)
    for c in prange(len(start) - 1):
        n = start[c + 1] - start[c]
        if n == 0:
            continue
        deviation = np.empty(n, np.float64)
        w1, w2 = 0.0, 0.0
        for m in range(n):
            i = member[start[c] + m]
            deviation[m] = abs(value[i] - centre[c])
            w1 += weight[i]
            w2 += weight[i] * weight[i]
        spread[c] = 1.4826 * np.median(deviation)
        effective[c] = w1 * w1 / w2 if w2 > 0.0 else 0.0
    return spread, effective


@njit(cache=True)
def weighted_votes(cell: np.ndarray, label: np.ndarray, weight: np.ndarray, n_cells: int, n_labels: int) -> np.ndarray:
    """Sum of the weights of every label in every cell, (n_cells, n_labels) float64; negative cells are left out."""
    votes = np.zeros((n_cells, n_labels), np.float64)
    for i in range(len(cell)):
        if cell[i] >= 0:
            votes[cell[i], label[i]] += weight[i]
    return votes
