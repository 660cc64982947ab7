"""A point cloud seen by a camera as small discs that hide what lies behind them; and depth maps between rasters.

Surfels after Pfister et al. (SIGGRAPH 2000), blended as in Zwicker et al. (EWA splatting, SIGGRAPH 2001) but without
their filter: discs are cut by the rays of the pixel centres.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

_jit = njit(cache=True, nogil=True, error_model="numpy")


@_jit
def _meet(x, y, z, nx, ny, nz, a, b):
    """Depth at which the ray (a, b, 1) meets the disc's plane, and squared distance of that place from its centre."""
    against = nx * a + ny * b + nz
    t = (nx * x + ny * y + nz * z) / against if abs(against) > 1e-9 else z
    return t, (t * a - x) ** 2 + (t * b - y) ** 2 + (t - z) ** 2


@_jit
def _seen(xyz, normal, radius, R, t, K, least, rows, cols):
    """A disc in the camera: radius, centre, normal, and the pixels that it may cover (none when it is not in sight)."""
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    px, py, pz = float(xyz[0]), float(xyz[1]), float(xyz[2])
    z = R[2, 0] * px + R[2, 1] * py + R[2, 2] * pz + t[2]
    r = max(float(radius), least * z / fx)
    if z <= 2 * r:
        return r, 0.0, 0.0, z, 0.0, 0.0, 0.0, 0, 0, 0, 0
    x = R[0, 0] * px + R[0, 1] * py + R[0, 2] * pz + t[0]
    y = R[1, 0] * px + R[1, 1] * py + R[1, 2] * pz + t[1]
    u, v, w, h = fx * x / z + cx, fy * y / z + cy, fx * r / (z - r), fy * r / (z - r)
    if u + w < 0 or v + h < 0 or u - w > cols or v - h > rows:
        return r, x, y, z, 0.0, 0.0, 0.0, 0, 0, 0, 0
    mx, my, mz = float(normal[0]), float(normal[1]), float(normal[2])
    nx = R[0, 0] * mx + R[0, 1] * my + R[0, 2] * mz
    ny = R[1, 0] * mx + R[1, 1] * my + R[1, 2] * mz
    nz = R[2, 0] * mx + R[2, 1] * my + R[2, 2] * mz
    top, bottom = max(0, math.ceil(v - h - 0.5)), min(rows - 1, math.floor(v + h - 0.5)) + 1
    left, right = max(0, math.ceil(u - w - 0.5)), min(cols - 1, math.floor(u + w - 0.5)) + 1
    return r, x, y, z, nx, ny, nz, top, bottom, left, right


@_jit
def nearest_discs(xyz, normal, radius, R, t, K, least, nearest):
    """The first disc on every pixel's ray.

    Args:
        xyz, normal: (n, 3) float32 centres and unit normals (either sign), world; radius: (n,) float32.
        R, t: (3, 3), (3,) float64: world to camera, ``R p + t``; K: (3, 3) float64 without skew.
        least: discs are at least so large that they cover a pixel facing them at this radius [px].
        nearest: (H, W) float32, infinite where nothing was met so far; lowered.
    """
    rows, cols = nearest.shape
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    for i in range(len(xyz)):
        r, x, y, z, nx, ny, nz, top, bottom, left, right = _seen(
            xyz[i], normal[i], radius[i], R, t, K, least, rows, cols
        )
        for row in range(top, bottom):
            b = (row + 0.5 - cy) / fy
            for col in range(left, right):
                depth, d2 = _meet(x, y, z, nx, ny, nz, (col + 0.5 - cx) / fx, b)
                if d2 <= r * r and depth < nearest[row, col]:
                    nearest[row, col] = depth


@_jit
def blend_discs(xyz, normal, radius, R, t, K, least, share, nearest, total, weight, covered):
    """The mean of the discs that belong to the first surface on every pixel's ray.

    A disc belongs to it when it lies no more than its own radius behind the first one; it counts the more, the nearer
    to its centre the ray goes by.

    Args:
        xyz ... least, nearest: as in ``nearest_discs``, which comes first.
        share: a pixel is covered when its ray goes by a centre within this share of the radius.
        total, weight: (H, W) float64, grow by weight times depth, and by weight.
        covered: (H, W) bool, set.
    """
    rows, cols = nearest.shape
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    for i in range(len(xyz)):
        r, x, y, z, nx, ny, nz, top, bottom, left, right = _seen(
            xyz[i], normal[i], radius[i], R, t, K, least, rows, cols
        )
        for row in range(top, bottom):
            b = (row + 0.5 - cy) / fy
            for col in range(left, right):
                depth, d2 = _meet(x, y, z, nx, ny, nz, (col + 0.5 - cx) / fx, b)
                if d2 <= r * r and depth <= nearest[row, col] + r:
                    near = 1 - d2 / (r * r)
                    total[row, col] += (near * near + 1e-6) * depth
                    weight[row, col] += near * near + 1e-6
                    if d2 <= share * share * r * r:
                        covered[row, col] = True


@_jit
def sample_depth(depth, uv, relative):
    """Depth of a raster at any place: on a surface inverse depth is interpolated (exact on planes), else nearest.

    Args:
        depth: (h, w) float32, NaN = none; uv: (n, 2) float64, pixel centres at +0.5.
        relative: four neighbours belong to one surface when their depths differ by less than this share.

    Returns:
        (n,) float32, NaN outside and where the nearest pixel has none.
    """
    rows, cols = depth.shape
    out = np.full(len(uv), np.nan, np.float32)
    for n in range(len(uv)):
        u, v = uv[n, 0], uv[n, 1]
        if not (0 <= u < cols and 0 <= v < rows):
            continue
        nearest = depth[int(v), int(u)]
        out[n] = nearest
        x, y = u - 0.5, v - 0.5
        i, j = max(0, min(int(y), rows - 2)), max(0, min(int(x), cols - 2))
        if rows < 2 or cols < 2:
            continue
        a, b, c, d = depth[i, j], depth[i, j + 1], depth[i + 1, j], depth[i + 1, j + 1]
        total = a + b + c + d
        spread = max(max(a, b), max(c, d)) - min(min(a, b), min(c, d))
        if total == total and spread < relative * nearest:  # none is NaN, one surface
            fx, fy = x - j, y - i
            out[n] = 1 / ((1 / a * (1 - fx) + 1 / b * fx) * (1 - fy) + (1 / c * (1 - fx) + 1 / d * fx) * fy)
    return out
