"""Connected components: of points within a radius, of cells on a grid."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def find(parent: np.ndarray, i: int) -> int:
    """Root of ``i``, halving the path on the way."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True)
def union(parent: np.ndarray, i: int, j: int) -> None:
    """Merge two trees below the smaller root, so that the result does not depend on the order of the merges."""
    a, b = find(parent, i), find(parent, j)
    if a < b:
        parent[b] = a
    elif b < a:
        parent[a] = b


@njit(cache=True)
def number_roots(parent: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Components as ids from 0 in order of their first member, and their sizes."""
    n = len(parent)
    component = np.empty(n, np.int32)
    size = np.zeros(n, np.int64)
    count = 0
    for i in range(n):
        root = find(parent, i)
        if root == i:
            component[i] = count
            count += 1
        else:
            component[i] = component[root]  # the root is the smallest member, so it is numbered already
        size[component[i]] += 1
    return component, size[:count].copy()


@njit(cache=True)
def radius_components(
    xyz: np.ndarray, kind: np.ndarray, radius: float, order: np.ndarray, key: np.ndarray, cell: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Single-linkage clusters: points of equal ``kind`` at most ``radius`` apart are in one component.

    Args:
        xyz: (n, 3) positions.
        kind: (n,) int; only points of the same kind are linked.
        radius: linkage distance.
        order: (n,) points in ascending order of their cell key.
        key: (n,) the sorted cell keys, ``(x * 2^21 + y) * 2^21 + z`` of ``cell``.
        cell: (n, 3) integer cell of every point, cells of edge ``radius``, coordinates >= 1.

    Returns:
        (component of every point (n,) from 0, size of every component).
    """
    n = len(xyz)
    parent = np.arange(n).astype(np.int32)
    r2 = radius * radius
    for a in range(n):
        i = order[a]
        for dx in range(-1, 2):
            for dy in range(-1, 2):
                base = ((np.int64(cell[i, 0]) + dx) << 42) | ((np.int64(cell[i, 1]) + dy) << 21)
                low = np.searchsorted(key, base + np.int64(cell[i, 2]) - 1)
                high = np.searchsorted(key, base + np.int64(cell[i, 2]) + 2)
                for b in range(low, high):
                    j = order[b]
                    if j <= i or kind[j] != kind[i]:
                        continue
                    d2 = (xyz[i, 0] - xyz[j, 0]) ** 2 + (xyz[i, 1] - xyz[j, 1]) ** 2 + (xyz[i, 2] - xyz[j, 2]) ** 2
                    if d2 <= r2:
                        union(parent, i, j)
    return number_roots(parent)


@njit(cache=True)
def continuous_cells(H: np.ndarray, member: np.ndarray, step: float, slope: float, spacing: float) -> np.ndarray:
    """Regions of 8-adjacent member cells whose heights differ by at most ``step + slope * d`` (eq:gc_continuity).

    Returns:
        (Y, X) int32 region id from 0 in order of the first cell; -1 where ``member`` is false.
    """
    rows, cols = H.shape
    parent = np.arange(rows * cols).astype(np.int32)
    diagonal = spacing * np.sqrt(2.0)
    for y in range(rows):
        for x in range(cols):
            if not member[y, x]:
                continue
            for m in range(4):  # the four neighbours that come later: E, SW, S, SE
                v, u = (y, x + 1) if m == 0 else (y + 1, x + m - 2)
                if v >= rows or u < 0 or u >= cols or not member[v, u]:
                    continue
                d = spacing if (v == y or u == x) else diagonal
                if abs(H[y, x] - H[v, u]) <= step + slope * d:
                    union(parent, y * cols + x, v * cols + u)
    region = np.full((rows, cols), -1, np.int32)
    number = np.full(rows * cols, -1, np.int32)
    count = 0
    for y in range(rows):
        for x in range(cols):
            if member[y, x]:
                root = find(parent, y * cols + x)
                if number[root] < 0:
                    number[root] = count
                    count += 1
                region[y, x] = number[root]
    return region
