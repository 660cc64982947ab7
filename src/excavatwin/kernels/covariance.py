"""Covariance features of neighbourhoods: moments, eigen-decomposition and tangent-plane residuals in one pass."""

from __future__ import annotations

import numpy as np
from numba import njit, prange


@njit(cache=True)
def symmetric_eigen(C: np.ndarray, values: np.ndarray, vectors: np.ndarray) -> None:
    """Eigen-decomposition of a symmetric 3x3 matrix by cyclic Jacobi rotations, eigenvalues ascending.

    ``C`` is destroyed; ``values`` (3,) and the columns of ``vectors`` (3, 3) are written. (Golub and Van Loan, 8.5.)
    """
    for a in range(3):
        for b in range(3):
            vectors[a, b] = 1.0 if a == b else 0.0
    for _ in range(12):
        off = C[0, 1] ** 2 + C[0, 2] ** 2 + C[1, 2] ** 2
        if off <= 1e-30 * (C[0, 0] ** 2 + C[1, 1] ** 2 + C[2, 2] ** 2) + 1e-300:
            break
        for p in range(2):
            for q in range(p + 1, 3):
                if C[p, q] == 0.0:
                    continue
                theta = (C[q, q] - C[p, p]) / (2.0 * C[p, q])
                t = 1.0 / (abs(theta) + np.sqrt(theta * theta + 1.0))
                if theta < 0.0:
                    t = -t
                c = 1.0 / np.sqrt(t * t + 1.0)
                s = t * c
                for m in range(3):
                    x, y = C[m, p], C[m, q]
                    C[m, p], C[m, q] = c * x - s * y, s * x + c * y
                for m in range(3):
                    x, y = C[p, m], C[q, m]
                    C[p, m], C[q, m] = c * x - s * y, s * x + c * y
                for m in range(3):
                    x, y = vectors[m, p], vectors[m, q]
                    vectors[m, p], vectors[m, q] = c * x - s * y, s * x + c * y
    for m in range(3):
        values[m] = C[m, m]
    for p in range(2):  # selection sort of three
        least = p
        for q in range(p + 1, 3):
            if values[q] < values[least]:
                least = q
        if least != p:
            values[p], values[least] = values[least], values[p]
            for m in range(3):
                vectors[m, p], vectors[m, least] = vectors[m, least], vectors[m, p]


@njit(cache=True, parallel=True)
def local_features(xyz: np.ndarray, neighbours: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Features of the neighbourhood N_i = {i} and its k neighbours.

    Returns:
        (normal (J, 3) upward; eigenvalues (J, 3) ascending; height variance (J,); median absolute distance to the
        tangent plane (J,)), all float32.
    """
    n, k = neighbours.shape
    normal = np.empty((n, 3), np.float32)
    eigenvalue = np.empty((n, 3), np.float32)
    height_variance = np.empty(n, np.float32)
    residual = np.empty(n, np.float32)
    for i in prange(n):
        local = np.empty((k + 1, 3), np.float64)
        mean = np.zeros(3)
        for m in range(k + 1):
            j = np.int64(i) if m == 0 else np.int64(neighbours[i, m - 1])
            for c in range(3):
                local[m, c] = np.float64(xyz[j, c]) - np.float64(xyz[i, c])  # relative: keeps the moments exact
                mean[c] += local[m, c]
        mean /= k + 1
        C = np.zeros((3, 3))
        for m in range(k + 1):
            for a in range(3):
                local[m, a] -= mean[a]
            for a in range(3):
                for b in range(a, 3):
                    C[a, b] += local[m, a] * local[m, b]
        C /= k + 1
        C[1, 0], C[2, 0], C[2, 1] = C[0, 1], C[0, 2], C[1, 2]
        height_variance[i] = C[2, 2]
        values = np.empty(3)
        vectors = np.empty((3, 3))
        symmetric_eigen(C, values, vectors)
        sign = -1.0 if vectors[2, 0] < 0.0 else 1.0
        for c in range(3):
            normal[i, c] = sign * vectors[c, 0]
            eigenvalue[i, c] = max(values[c], 0.0)
        distance = np.empty(k + 1)
        for m in range(k + 1):
            distance[m] = abs(local[m, 0] * vectors[0, 0] + local[m, 1] * vectors[1, 0] + local[m, 2] * vectors[2, 0])
        residual[i] = np.median(distance)
    return normal, eigenvalue, height_variance, residual
