"""Depth maps: agreement between those of two views, and the size of connected surfaces in one."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

_jit = njit(cache=True, nogil=True, error_model="numpy")


@_jit
def _sample(depth, u, v, relative):
    """Depth at (u, v), pixel centres at +0.5: bilinear on a surface, the nearest pixel next to an edge; NaN = none."""
    rows, cols = depth.shape
    if not (0 <= u < cols and 0 <= v < rows):
        return np.nan
    i, j = min(int(v), rows - 1), min(int(u), cols - 1)
    nearest = depth[i, j]
    x, y = u - 0.5, v - 0.5
    if not (0 <= x < cols - 1 and 0 <= y < rows - 1):
        return nearest
    i, j = int(y), int(x)
    a, b, c, d = depth[i, j], depth[i, j + 1], depth[i + 1, j], depth[i + 1, j + 1]
    if max(max(a, b), max(c, d)) - min(min(a, b), min(c, d)) < relative * nearest:  # False when any is NaN
        fx, fy = x - j, y - i
        return (a * (1 - fx) + b * fx) * (1 - fy) + (c * (1 - fx) + d * fx) * fy
    return nearest


@_jit
def add_agreement(depth, other, M, t, N, n, pixels, relative, votes, meeting, weight):
    """Let another view vote on a depth map, by forward-backward reprojection; find where each ray meets its surface.

    Args:
        depth: (H, W) float32 along the optical axis, NaN = none; other: (Ho, Wo), the other view's.
        M, t: (3, 3), (3,) float64: pixel p at depth D lies at ``D M p + t`` (homogeneous) in the other view.
        N, n: the same from the other view back.
        pixels: largest distance of the returning point from its pixel [px]; relative: of its depth, as a share.
        votes: (H, W) float32, grows by 1 where the views agree.
        meeting: (H, W) float64, grows there by ``weight`` times the inverse depth where the ray meets the surface.
    """
    rows, cols = depth.shape
    for r in range(rows):
        for c in range(cols):
            near = float(depth[r, c])
            if not near > 0:
                continue
            px, py = c + 0.5, r + 0.5
            mx = M[0, 0] * px + M[0, 1] * py + M[0, 2]
            my = M[1, 0] * px + M[1, 1] * py + M[1, 2]
            mz = M[2, 0] * px + M[2, 1] * py + M[2, 2]
            z = near * mz + t[2]
            if z <= 0:
                continue
            u, v = (near * mx + t[0]) / z, (near * my + t[1]) / z
            s = _sample(other, u, v, relative)
            back = s * (N[2, 0] * u + N[2, 1] * v + N[2, 2]) + n[2]
            if not (s > 0 and abs(back - near) <= relative * near):
                continue
            bx = (s * (N[0, 0] * u + N[0, 1] * v + N[0, 2]) + n[0]) / back
            by = (s * (N[1, 0] * u + N[1, 1] * v + N[1, 2]) + n[1]) / back
            if math.hypot(bx - px, by - py) > pixels:
                continue
            votes[r, c] += 1
            met, gap, found = near, s - z, back
            if found != met:  # one secant step towards the point of the ray that lies on the other's surface
                z = found * mz + t[2]
                gap_found = _sample(other, (found * mx + t[0]) / z, (found * my + t[1]) / z, relative) - z
                step = gap_found * (found - met) / (gap_found - gap)
                if abs(found - step - near) <= relative * near:
                    found -= step
            meeting[r, c] += weight / found


@_jit
def surface_sizes(depth, relative):
    """Number of pixels of each pixel's connected surface (4 neighbours, depth step below ``relative``).

    Args:
        depth: (H, W) float32, NaN = none.

    Returns:
        (H, W) int32, 0 where there is no depth.
    """
    rows, cols = depth.shape
    size = np.zeros((rows, cols), np.int32)
    stack = np.empty(rows * cols, np.int32)
    for first in range(rows * cols):
        if size[first // cols, first % cols] or not depth[first // cols, first % cols] > 0:
            continue
        stack[0] = first
        size[first // cols, first % cols] = -1
        done, end = 0, 1
        while done < end:
            r, c = stack[done] // cols, stack[done] % cols
            done += 1
            for k in range(4):
                i = r + (k == 0) - (k == 1)
                j = c + (k == 2) - (k == 3)
                if 0 <= i < rows and 0 <= j < cols and size[i, j] == 0:
                    a, b = depth[r, c], depth[i, j]
                    if abs(a - b) < relative * min(a, b):
                        size[i, j] = -1
                        stack[end] = i * cols + j
                        end += 1
        for k in range(end):
            size[stack[k] // cols, stack[k] % cols] = end
    return size
