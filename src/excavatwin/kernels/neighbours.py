"""Exact k nearest neighbours of points that lie on surfaces.

Points are sorted by cell; the 27-cell block around a cell is gathered once for all of its points. A point whose k-th
candidate is farther than the block reaches could have a nearer one outside: it is marked and left to the caller.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange


@njit(cache=True)
def _gather(key: np.ndarray, start: np.ndarray, centre: int, out: np.ndarray) -> int:
    """Positions (in cell order) of all points in the 27 cells around the cell of key ``centre``; returns their count,
    negative when ``out`` is too small."""
    count = 0
    for dx in range(-1, 2):
        for dy in range(-1, 2):
            base = centre + (np.int64(dx) << 42) + (np.int64(dy) << 21)
            low = np.searchsorted(key, base - 1)
            high = np.searchsorted(key, base + 2)
            for m in range(start[low], start[high]):
                if count == len(out):
                    return -1
                out[count] = m
                count += 1
    return count


@njit(cache=True)
def _nearest(xyz: np.ndarray, i: int, candidate: np.ndarray, n: int, k: int, d2: np.ndarray, who: np.ndarray) -> int:
    """The k nearest of the first n candidates to row i, itself left out, by insertion; returns how many there are."""
    found = 0
    for m in range(n):
        j = candidate[m]
        if j == i:
            continue
        dx, dy, dz = xyz[j, 0] - xyz[i, 0], xyz[j, 1] - xyz[i, 1], xyz[j, 2] - xyz[i, 2]
        d = dx * dx + dy * dy + dz * dz
        if found == k and d >= d2[k - 1]:
            continue
        slot = found if found < k else k - 1
        while slot > 0 and d2[slot - 1] > d:
            d2[slot] = d2[slot - 1]
            who[slot] = who[slot - 1]
            slot -= 1
        d2[slot] = d
        who[slot] = j
        if found < k:
            found += 1
    return found


@njit(cache=True, parallel=True)
def block_neighbours(
    xyz: np.ndarray, origin: np.ndarray, edge: float, key: np.ndarray, start: np.ndarray, k: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """k nearest neighbours of points sorted by cell.

    Args:
        xyz: (n, 3) float32, ordered by cell.
        origin: (3,) corner of cell (0, 0, 0).
        edge: edge length of a cell.
        key: (c,) ascending keys of the occupied cells, coordinates packed 21 bits each, z fastest.
        start: (c + 1,) first point of every cell.
        k: number of neighbours.

    Returns:
        (neighbours (n, k) int32 nearest first, distances (n, k) float32, complete (n,) bool: false where the block
        was too small to be sure).
    """
    n = len(xyz)
    neighbour = np.zeros((n, k), np.int32)
    distance = np.full((n, k), np.inf, np.float32)
    complete = np.zeros(n, np.bool_)
    for c in prange(len(key)):
        capacity = 1024
        candidate = np.empty(capacity, np.int64)
        count = _gather(key, start, key[c], candidate)
        while count < 0:
            capacity *= 2
            candidate = np.empty(capacity, np.int64)
            count = _gather(key, start, key[c], candidate)
        d2 = np.empty(k, np.float32)
        who = np.empty(k, np.int64)
        for i in range(start[c], start[c + 1]):
            if _nearest(xyz, i, candidate, count, k, d2, who) < k:
                continue
            reach = edge
            for a in range(3):
                inside = (xyz[i, a] - origin[a]) % edge
                reach = min(reach, edge + min(inside, edge - inside))
            for m in range(k):
                neighbour[i, m] = who[m]
                distance[i, m] = np.sqrt(d2[m])
            complete[i] = distance[i, k - 1] <= reach
    return neighbour, distance, complete
