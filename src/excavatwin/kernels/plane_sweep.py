"""Plane sweep: how well every pixel of a reference image matches its sources under each plane of a family.

A pixel p = (x, y, 1) has inverse depth ``w * slope(p)`` under plane w, so its place in source s is
``M_s p + w slope(p) t_s`` up to scale. Each pixel has its own *band* of consecutive planes, stored one after the other
(``start``, ``first``): a full sweep and a narrow coarse-to-fine search are the same loop.

Windows of 5 x 5 pixels are compared by zero-mean normalised cross-correlation with bilateral weights of the reference
window, which keeps them from reaching over depth edges (Yoon & Kweon, TPAMI 2006; as in the PatchMatch of COLMAP,
Schönberger et al., ECCV 2016). Loops run over tiles that stay in cache and over rows that the compiler vectorises.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

RADIUS = 2
SIDE = 2 * RADIUS + 1
TILE_ROWS = 16
TILE_COLS = 32
WORST = 250
"""Cost of a window without positive correlation; costs are round(WORST * (1 - ZNCC)), clipped."""
_NONE = np.float32(1e9)
_FAST = {"contract", "nsz", "arcp", "reassoc"}  # not nnan: NaN marks pixels that do not exist
_jit = njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")


@_jit
def _weigh_tile(padded, r0, c0, tone, space, weight, weighted, scale, noise):
    """Weights of the windows of a tile (sum 1), weights times value less weighted mean, and 1 / sqrt(variance)."""
    for y in range(TILE_ROWS):
        for x in range(TILE_COLS):
            centre = padded[r0 + y + RADIUS, c0 + x + RADIUS]
            total, mean = np.float32(0), np.float32(0)
            for i in range(SIDE):
                for j in range(SIDE):
                    value = padded[r0 + y + i, c0 + x + j]
                    g = tone[int(abs(value - centre))] * space[i, j]
                    weight[y, i, j, x] = g
                    total += g
                    mean += g * value
            mean /= total
            variance = np.float32(0)
            for i in range(SIDE):
                for j in range(SIDE):
                    g = weight[y, i, j, x] / total
                    value = padded[r0 + y + i, c0 + x + j] - mean
                    weight[y, i, j, x] = g
                    weighted[y, i, j, x] = g * value
                    variance += g * value * value
            scale[y, x] = 1 / math.sqrt(variance + noise)


@_jit
def _warp_tile(source, stride, rows, cols, M, t, w, slope, r0, c0, py, px, u, v, z, out):
    """The source as the tile (with its margin) would see it under plane w; NaN outside the source."""
    t0, t1, t2 = t[0] * w, t[1] * w, t[2] * w
    m0, m1, m2 = M[0, 0], M[1, 0], M[2, 0]
    right, bottom = np.float32(cols - 1), np.float32(rows - 1)
    half = np.float32(0.5)
    for y in range(TILE_ROWS + 2 * RADIUS):
        a0, a1, a2 = M[0, 1] * py[y] + M[0, 2], M[1, 1] * py[y] + M[1, 2], M[2, 1] * py[y] + M[2, 2]
        for x in range(TILE_COLS + 2 * RADIUS):
            g = slope[r0 + y, c0 + x]
            inverse = np.float32(1) / (m2 * px[x] + a2 + g * t2)
            z[x] = inverse
            u[x] = (m0 * px[x] + a0 + g * t0) * inverse - half
            v[x] = (m1 * px[x] + a1 + g * t1) * inverse - half
        for x in range(TILE_COLS + 2 * RADIUS):
            if z[x] > 0 and u[x] >= 0 and v[x] >= 0 and u[x] < right and v[x] < bottom:
                j, i = np.int32(u[x]), np.int32(v[x])
                fu, fv = u[x] - np.float32(j), v[x] - np.float32(i)
                at = np.uint64(i) * np.uint64(stride) + np.uint64(j)  # unsigned: no test for negative indices
                below = at + np.uint64(stride)
                upper = source[at] + fu * (source[at + np.uint64(1)] - source[at])
                lower = source[below] + fu * (source[below + np.uint64(1)] - source[below])
                out[y, x] = upper + fv * (lower - upper)
            else:
                out[y, x] = np.nan


@_jit
def _correlate_row(a, y, weight, weighted, s1, s2, rs):
    """Weighted sums over the windows of row y of a tile: of s, s^2 and (reference - mean) s."""
    for x in range(TILE_COLS):
        s1[x] = 0
        s2[x] = 0
        rs[x] = 0
    for i in range(SIDE):
        for x in range(TILE_COLS):
            p, q, r, s, t = a[y + i, x], a[y + i, x + 1], a[y + i, x + 2], a[y + i, x + 3], a[y + i, x + 4]
            wp, wq, wr = weight[y, i, 0, x] * p, weight[y, i, 1, x] * q, weight[y, i, 2, x] * r
            ws, wt = weight[y, i, 3, x] * s, weight[y, i, 4, x] * t
            s1[x] += wp + wq + wr + ws + wt
            s2[x] += wp * p + wq * q + wr * r + ws * s + wt * t
            rs[x] += (
                weighted[y, i, 0, x] * p
                + weighted[y, i, 1, x] * q
                + weighted[y, i, 2, x] * r
                + weighted[y, i, 3, x] * s
                + weighted[y, i, 4, x] * t
            )


@_jit
def _insert_row(y, s1, s2, rs, scale, noise, best):
    """Put each window's cost 1 - ZNCC among the best of its sources so far (ascending)."""
    for x in range(TILE_COLS):
        variance = s2[x] - s1[x] * s1[x]
        variance = variance if variance > 0 else np.float32(0)
        cost = np.float32(1) - rs[x] * scale[y, x] / np.sqrt(variance + noise)
        rs[x] = cost if s1[x] == s1[x] else _NONE
    for i in range(best.shape[0]):
        for x in range(TILE_COLS):
            old, new = best[i, x], rs[x]
            best[i, x] = new if new < old else old
            rs[x] = old if new < old else new


@_jit
def _store_row(y, k, p0, width, best, start, first, costs):
    """Write the mean of the best costs of plane k where it lies in the band of its pixel."""
    for x in range(width):
        d = k - first[p0 + x]
        if 0 <= d < start[p0 + x + 1] - start[p0 + x]:
            total, count = np.float32(0), 0
            for i in range(best.shape[0]):
                if best[i, x] < _NONE:
                    total += best[i, x]
                    count += 1
            if count > 0:
                cost = total / np.float32(count) * np.float32(WORST) + np.float32(0.5)
                if cost < WORST:
                    costs[start[p0 + x] + d] = np.uint8(max(cost, np.float32(0)))


@_jit
def _mark_wanted(start, first, r0, rows, cols, c0, width, wanted):
    """For each row of a tile, the planes that lie in the band of any of its pixels; the last row marks those of all."""
    wanted[:] = False
    for y in range(min(TILE_ROWS, rows - r0)):
        for p in range((r0 + y) * cols + c0, (r0 + y) * cols + c0 + width):
            for k in range(first[p], first[p] + start[p + 1] - start[p]):
                wanted[y, k] = True
                wanted[TILE_ROWS, k] = True


@_jit
def band_costs(padded, sources, sizes, M, t, slope, w0, dw, start, first, tone, space, noise, keep):
    """Costs of every plane in every pixel's band: the mean of the ``keep`` best of its sources.

    Args:
        padded: float32 grey values of the reference, see ``pad_to_tiles``; slope: inverse depth per w, padded alike.
        sources: (S, Hs Ws) float32 stack of flat images, NaN where there is no pixel.
        sizes: (S, 3) int64, rows and columns that each fills, and the stride of its rows.
        M, t: (S, 3, 3) and (S, 3) float32: a reference pixel (centre at +0.5) goes to ``M p + w slope t``.
        w0, dw: plane k lies at w0 + k dw.
        start: (H W + 1,) int64, where each pixel's band begins in the result; first: (H, W) int32, its first plane.
        tone, space: (256,) and (5, 5) float32 bilateral weights by grey difference and by place.
        noise: variance of the image noise, keeps flat windows from correlating [grey^2].

    Returns:
        (start[-1],) uint8: ``WORST`` times 1 - ZNCC, at most ``WORST``; also where no source sees the plane.
    """
    rows, cols = first.shape
    n = sources.shape[0]
    costs = np.full(start[-1], WORST, np.uint8)
    weight = np.empty((TILE_ROWS, SIDE, SIDE, TILE_COLS), np.float32)
    weighted = np.empty_like(weight)
    scale = np.empty((TILE_ROWS, TILE_COLS), np.float32)
    warped = np.empty((n, TILE_ROWS + 2 * RADIUS, TILE_COLS + 2 * RADIUS), np.float32)
    py, px = np.empty(warped.shape[1], np.float32), np.empty(warped.shape[2], np.float32)
    u, v, z = np.empty_like(px), np.empty_like(px), np.empty_like(px)
    s1, s2, rs = np.empty(TILE_COLS, np.float32), np.empty(TILE_COLS, np.float32), np.empty(TILE_COLS, np.float32)
    best = np.empty((keep, TILE_COLS), np.float32)
    planes = 0
    for p in range(rows * cols):
        planes = max(planes, first[p // cols, p % cols] + start[p + 1] - start[p])
    wanted = np.empty((TILE_ROWS + 1, planes), np.bool_)
    flat_first = first.ravel()
    for r0 in range(0, rows, TILE_ROWS):
        for c0 in range(0, cols, TILE_COLS):
            width = min(TILE_COLS, cols - c0)
            _mark_wanted(start, flat_first, r0, rows, cols, c0, width, wanted)
            if not wanted[TILE_ROWS].any():
                continue
            for y in range(py.size):
                py[y] = min(max(r0 + y - RADIUS, 0), rows - 1) + 0.5
            for x in range(px.size):
                px[x] = min(max(c0 + x - RADIUS, 0), cols - 1) + 0.5
            _weigh_tile(padded, r0, c0, tone, space, weight, weighted, scale, noise)
            for k in range(planes):
                if not wanted[TILE_ROWS, k]:
                    continue
                w = np.float32(w0 + k * dw)
                for s in range(n):
                    _warp_tile(
                        sources[s], sizes[s, 2], sizes[s, 0], sizes[s, 1], M[s], t[s], w, slope, r0, c0,
                        py, px, u, v, z, warped[s],
                    )  # fmt: skip
                for y in range(TILE_ROWS):
                    if wanted[y, k]:
                        best[:] = _NONE
                        for s in range(n):
                            _correlate_row(warped[s], y, weight, weighted, s1, s2, rs)
                            _insert_row(y, s1, s2, rs, scale, noise, best)
                        _store_row(y, k, (r0 + y) * cols + c0, width, best, start, flat_first, costs)
    return costs


def pad_to_tiles(image: np.ndarray) -> np.ndarray:
    """The image with its border repeated: ``RADIUS`` around it and up to whole tiles below and to the right."""
    rows, cols = image.shape
    below, right = -rows % TILE_ROWS + RADIUS, -cols % TILE_COLS + RADIUS
    return np.ascontiguousarray(np.pad(image, ((RADIUS, below), (RADIUS, right)), mode="edge"))
