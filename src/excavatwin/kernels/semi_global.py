"""Semi-global aggregation of matching costs (Hirschmüller, TPAMI 2008) in a band of planes per pixel.

The bands follow a coarser result, as in the tSGM of SURE (Rothermel et al., LC3D 2012).
"""

from __future__ import annotations

import numpy as np
from numba import njit

_BIG = np.float32(1e6)


@njit(cache=True, nogil=True)
def _step(costs, total, p0, n, lo, path_q, n_q, lo_q, low_q, P1, P2, path):
    """Extend one path from pixel q (``path_q``, padded by two) to a pixel; returns the least cost of the new path."""
    path[0] = path[1] = _BIG
    least = _BIG
    jump = low_q + P2
    begin = min(max(lo_q - 1 - lo, 0), n)
    end = max(min(lo_q + n_q + 1 - lo, n), begin)
    shift = lo - lo_q + 2
    for d in range(n):
        path[d + 2] = jump
    for d in range(begin, end):
        j = d + shift
        near = min(path_q[j - 1], path_q[j + 1]) + P1
        path[d + 2] = min(min(path_q[j], near), jump)
    for d in range(n):
        value = path[d + 2] - low_q + np.float32(costs[p0 + d])
        path[d + 2] = value
        total[p0 + d] += value
        least = min(least, value)
    path[n + 2] = path[n + 3] = _BIG
    return least


@njit(cache=True, nogil=True)
def aggregate(costs, start, first, image, P1, P2, P2_least, contrast):
    """Sum of the costs over eight paths.

    Args:
        costs: (start[-1],) uint8, band after band; start: (H W + 1,) int64; first: (H W,) int32.
        image: (H, W) float32; across a step in it P2 falls to ``max(P2 / (1 + |step| / contrast), P2_least)``.
        P1: price of a change by one plane between neighbours; P2: of any larger change.

    Returns:
        (start[-1],) float32. A pixel with an empty band starts every path anew.
    """
    rows, cols = image.shape
    widest = 0
    for p in range(rows * cols):
        widest = max(widest, start[p + 1] - start[p])
    total = np.zeros(start[-1], np.float32)
    for sense in range(2):
        sign = 1 if sense == 0 else -1
        path = np.full((2, 4, cols, widest + 4), _BIG, np.float32)
        low = np.zeros((2, 4, cols), np.float32)
        for i in range(rows):
            r = i if sense == 0 else rows - 1 - i
            now = i % 2
            for k in range(cols):
                c = k if sense == 0 else cols - 1 - k
                p = r * cols + c
                n = start[p + 1] - start[p]
                if n == 0:
                    continue
                for way in range(4):  # along the row, then the three neighbours of the row before
                    rq = r if way == 0 else r - sign
                    cq = c - sign if way == 0 else c + way - 2
                    row = now if way == 0 else 1 - now
                    n_q = 0
                    if 0 <= rq < rows and 0 <= cq < cols:
                        q = rq * cols + cq
                        n_q = start[q + 1] - start[q]
                    if n_q == 0:
                        low[now, way, c] = _step(
                            costs, total, start[p], n, first[p], path[row, way, c], 0, first[p] - n - 9,
                            np.float32(0), np.float32(0), np.float32(0), path[now, way, c],
                        )  # fmt: skip
                    else:
                        edge = abs(image[r, c] - image[rq, cq])
                        price = max(P2 / (1 + edge / contrast), P2_least)
                        low[now, way, c] = _step(
                            costs, total, start[p], n, first[p], path[row, way, cq], n_q, first[q],
                            low[row, way, cq], np.float32(P1), np.float32(price), path[now, way, c],
                        )  # fmt: skip
    return total


@njit(cache=True, nogil=True)
def winners(total, costs, start, first):
    """The plane of least aggregated cost of every pixel, to a fraction of a plane by a parabola.

    Returns:
        plane: (H W,) float32 index, NaN for an empty band.
        cost: (H W,) float32 raw matching cost of the winner, in the unit of ``costs``.
    """
    n = start.shape[0] - 1
    plane = np.full(n, np.nan, np.float32)
    cost = np.full(n, np.nan, np.float32)
    for p in range(n):
        begin, count = start[p], start[p + 1] - start[p]
        if count == 0:
            continue
        best = 0
        for d in range(1, count):
            if total[begin + d] < total[begin + best]:
                best = d
        offset = np.float32(0)
        if 0 < best < count - 1:
            left, mid, right = total[begin + best - 1], total[begin + best], total[begin + best + 1]
            curvature = left - 2 * mid + right
            if curvature > 0:
                offset = np.float32(0.5) * (left - right) / curvature
        plane[p] = first[p] + best + offset
        cost[p] = costs[begin + best]
    return plane, cost


@njit(cache=True, nogil=True)
def narrow_bands(plane, ratio, rows, cols, margin, widest, planes, allowed):
    """Bands around a coarser result, for the next level.

    Args:
        plane: (h, w) float32 plane indices of the coarser level, NaN = none; ``ratio`` planes here for one there.
        margin: planes added below and above the range of the 3 x 3 coarse neighbours.
        widest: a wider band is cut around the pixel's own coarse plane; planes: number of planes of this level.
        allowed: (rows, cols) bool, pixels that get a band at all.

    Returns:
        start (rows cols + 1,) int64 and first (rows cols,) int32.
    """
    h, w = plane.shape
    start = np.zeros(rows * cols + 1, np.int64)
    first = np.zeros(rows * cols, np.int32)
    for r in range(rows):
        rc = min(r * h // rows, h - 1)
        for c in range(cols):
            p = r * cols + c
            cc = min(c * w // cols, w - 1)
            low, high = np.float32(1e9), np.float32(-1e9)
            if allowed[r, c]:
                for i in range(max(rc - 1, 0), min(rc + 2, h)):
                    for j in range(max(cc - 1, 0), min(cc + 2, w)):
                        if plane[i, j] == plane[i, j]:
                            low = min(low, plane[i, j])
                            high = max(high, plane[i, j])
            if high < low:
                start[p + 1] = start[p]
                continue
            begin = max(int(np.floor(low * ratio)) - margin, 0)
            end = min(int(np.ceil(high * ratio)) + margin + 1, planes)
            if end - begin > widest:
                own = plane[rc, cc] if plane[rc, cc] == plane[rc, cc] else np.float32(0.5) * (low + high)
                begin = min(max(int(own * ratio) - widest // 2, begin), end - widest)
                end = begin + widest
            first[p] = begin
            start[p + 1] = start[p] + max(end - begin, 0)
    return start, first
