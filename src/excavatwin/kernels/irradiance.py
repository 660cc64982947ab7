"""Filter of Monte Carlo irradiance: the edge-avoiding a-trous wavelet (Dammertz, Sewtz, Hanika and Lensch 2010)."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

SPLINE = np.array([1 / 16, 1 / 4, 3 / 8, 1 / 4, 1 / 16])


@njit(cache=True, parallel=True)
def smoothed(light, depth, normal, slope, step, turn, reach):
    """One level: mean of 5 x 5 pixels ``step`` apart that lie on the same surface.

    Args:
        light: (H, W, 3); NaN-free.
        depth: (H, W), NaN where there is nothing: such pixels keep their value [m].
        normal: (H, W, 3), unit.
        slope: (H, W) edge of a pixel on a surface that faces the camera [m].
        turn: 1 - cosine between normals at which a neighbour counts exp(-1).
        reach: offset from the tangent plane, in pixels, at which a neighbour counts exp(-1).
    """
    height, width = depth.shape
    out = light.copy()
    for row in prange(height):
        total = np.zeros(3)
        for col in range(width):
            z = depth[row, col]
            if np.isnan(z):
                continue
            total[:] = 0.0
            weights = 0.0
            for j in range(-2, 3):
                r = row + j * step
                if r < 0 or r >= height:
                    continue
                for i in range(-2, 3):
                    c = col + i * step
                    if c < 0 or c >= width or np.isnan(depth[r, c]):
                        continue
                    bend = 1 - (
                        normal[row, col, 0] * normal[r, c, 0]
                        + normal[row, col, 1] * normal[r, c, 1]
                        + normal[row, col, 2] * normal[r, c, 2]
                    )
                    pixels = max(1.0, step * np.sqrt(float(i * i + j * j)))
                    jump = abs(depth[r, c] - z) / (slope[row, col] * pixels * reach)
                    weight = SPLINE[j + 2] * SPLINE[i + 2] * np.exp(-bend / turn - jump)
                    weights += weight
                    for k in range(3):
                        total[k] += weight * light[r, c, k]
            for k in range(3):
                out[row, col, k] = total[k] / weights
    return out
