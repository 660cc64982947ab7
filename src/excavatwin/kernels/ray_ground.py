"""Exact ray casting of terrain: bilinear patches between vertices, whose crossing is a quadratic's root."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64
from numba import njit

BLOCK = 16
"""Terrain cells along the edge of a block of which the highest point is known."""


class GroundArrays(NamedTuple):
    """The terrain for the ray caster: vertices on a square, a plane beyond it."""

    height: Float32[np.ndarray, "Y X"]
    """Row 0 south, vertex (row, col) at (west + col * cell, south + row * cell) [m]."""
    highest: Float32[np.ndarray, "b b"]
    """Highest vertex of each block of cells [m]."""
    west: float
    south: float
    cell: float
    top: float
    """Highest vertex of all [m]."""
    plane: Float64[np.ndarray, "3"]
    """z = plane[0] x + plane[1] y + plane[2] outside the square, and on its border [m]."""


@njit(cache=True)
def height_at(ground, x, y):
    """Bilinear terrain height [m]; the plane outside the square."""
    height = ground.height
    u, v = (x - ground.west) / ground.cell, (y - ground.south) / ground.cell
    i, j = int(np.floor(u)), int(np.floor(v))
    if i < 0 or j < 0 or i >= height.shape[1] - 1 or j >= height.shape[0] - 1:
        return ground.plane[0] * x + ground.plane[1] * y + ground.plane[2]
    u, v = u - i, v - j
    south = float(height[j, i]) * (1 - u) + float(height[j, i + 1]) * u
    north = float(height[j + 1, i]) * (1 - u) + float(height[j + 1, i + 1]) * u
    return south * (1 - v) + north * v


@njit(cache=True)
def to_line(position, step, low, cell, index):
    """Ray parameter at which a coordinate leaves the index-th interval of a row of cells.

    A step below 1e-9 never does: rounding would otherwise leave a ray along a grid line on the wrong side of it.
    """
    if step > 1e-9:
        return (low + (index + 1) * cell - position) / step
    if step < -1e-9:
        return (low + index * cell - position) / step
    return np.inf


@njit(cache=True)
def over_square(ground, o, d, far):
    """Ray parameters between which the ray is over the square of vertices; the first is larger when it never is."""
    enter, leave = 0.0, far
    for axis in range(2):
        low = ground.west if axis == 0 else ground.south
        high = low + ground.cell * (ground.height.shape[1 - axis] - 1)
        if d[axis] == 0:
            if o[axis] <= low or o[axis] >= high:
                leave = -1.0
        else:
            a, b = (low - o[axis]) / d[axis], (high - o[axis]) / d[axis]
            enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
    return enter, leave


@njit(cache=True)
def hit_ground(ground, o, d, far):
    """Ray parameter of the first crossing of the terrain from above, inf when there is none before ``far``."""
    plane = ground.plane
    drop = d[2] - plane[0] * d[0] - plane[1] * d[1]
    gap = o[2] - plane[0] * o[0] - plane[1] * o[1] - plane[2]
    t_plane = -gap / drop if drop < 0 and gap > 0 else np.inf
    height, cell = ground.height, ground.cell
    rows, cols = height.shape[0] - 1, height.shape[1] - 1
    enter, leave = over_square(ground, o, d, far)
    if leave <= enter:
        return t_plane if t_plane < far else np.inf
    if t_plane < enter:
        return t_plane
    if d[2] < 0:
        enter = max(enter, (ground.top - o[2]) / d[2])
    t, nudge = enter, 1e-6 * cell
    while t < leave:
        x, y = o[0] + (t + nudge) * d[0], o[1] + (t + nudge) * d[1]
        i = min(max(int(np.floor((x - ground.west) / cell)), 0), cols - 1)
        j = min(max(int(np.floor((y - ground.south) / cell)), 0), rows - 1)
        bi, bj = i // BLOCK, j // BLOCK
        end = min(
            leave,
            min(
                to_line(o[0], d[0], ground.west, cell * BLOCK, bi), to_line(o[1], d[1], ground.south, cell * BLOCK, bj)
            ),
        )
        if min(o[2] + t * d[2], o[2] + end * d[2]) > ground.highest[bj, bi]:
            t = max(end, t) + nudge
            continue
        end = min(leave, min(to_line(o[0], d[0], ground.west, cell, i), to_line(o[1], d[1], ground.south, cell, j)))
        end = max(end, t)
        a, b = float(height[j, i]), float(height[j, i + 1])
        c, e = float(height[j + 1, i]), float(height[j + 1, i + 1])
        # Along the ray the clearance over a bilinear patch is a quadratic: three samples determine it.
        f0 = clearance(o, d, t, ground, i, j, a, b, c, e)
        if f0 <= 0:
            return t
        fm = clearance(o, d, 0.5 * (t + end), ground, i, j, a, b, c, e)
        f1 = clearance(o, d, end, ground, i, j, a, b, c, e)
        s = first_root(2 * f0 - 4 * fm + 2 * f1, -3 * f0 + 4 * fm - f1, f0)
        if s <= 1:
            return t + s * (end - t)
        t = end + nudge
    return t_plane if leave < t_plane < far else np.inf


@njit(cache=True)
def clearance(o, d, t, ground, i, j, a, b, c, e):
    """Height of the ray over the patch of cell (j, i) with corner heights a, b (south), c, e (north)."""
    u = (o[0] + t * d[0] - ground.west) / ground.cell - i
    v = (o[1] + t * d[1] - ground.south) / ground.cell - j
    return o[2] + t * d[2] - ((a * (1 - u) + b * u) * (1 - v) + (c * (1 - u) + e * u) * v)


@njit(cache=True)
def first_root(a, b, c):
    """Smallest s in [0, 1] with a s^2 + b s + c = 0, given c > 0; 2 when there is none."""
    disc = b * b - 4 * a * c
    if disc < 0:
        return 2.0
    q = -0.5 * (b + np.sqrt(disc)) if b >= 0 else -0.5 * (b - np.sqrt(disc))
    r0 = q / a if a != 0 else 2.0
    r1 = c / q if q != 0 else 2.0
    low, high = min(r0, r1), max(r0, r1)
    if 0 <= low <= 1:
        return low
    return high if 0 <= high <= 1 else 2.0
