"""From an image lattice to a table of points."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def valid_points(
    p: np.ndarray, A: np.ndarray, centre: np.ndarray, focal: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The finite points of a lattice, mapped by a similarity.

    Args:
        p: (H W, 3) float32 points, NaN = none.
        A: (3, 4) float64 similarity.
        centre: (3,) camera centre after the similarity.
        focal: focal length of the lattice [px].

    Returns:
        (flat pixel indices (n,), mapped points (n, 3) float32, footprint of each pixel (n,) float32).
    """
    at = np.empty(len(p), np.int64)
    xyz = np.empty((len(p), 3), np.float32)
    footprint = np.empty(len(p), np.float32)
    n = 0
    for i in range(len(p)):
        x, y, z = np.float64(p[i, 0]), np.float64(p[i, 1]), np.float64(p[i, 2])
        if not (np.isfinite(x) and np.isfinite(y) and np.isfinite(z)):
            continue
        d2 = 0.0
        for a in range(3):
            q = A[a, 0] * x + A[a, 1] * y + A[a, 2] * z + A[a, 3]
            xyz[n, a] = q
            d2 += (q - centre[a]) ** 2
        at[n] = i
        footprint[n] = np.sqrt(d2) / focal
        n += 1
    return at[:n].copy(), xyz[:n].copy(), footprint[:n].copy()
