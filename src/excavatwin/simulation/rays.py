"""Exact ray casting: bodies analytically, the terrain as bilinear patches whose crossing is a quadratic's root."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64
from numba import njit

from excavatwin.simulation.bodies import TUBE_BORE, Kind
from excavatwin.simulation.noise import noise3

BOX, CYLINDER, TUBE, CONE, ELLIPSOID = (int(kind) for kind in Kind)
LEAF = 0.09
"""Wavelength of the holes of foliage [m]."""
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
def hit_ground(ground, o, d, far):
    """Ray parameter of the first crossing of the terrain from above, inf when there is none before ``far``."""
    plane = ground.plane
    drop = d[2] - plane[0] * d[0] - plane[1] * d[1]
    gap = o[2] - plane[0] * o[0] - plane[1] * o[1] - plane[2]
    t_plane = -gap / drop if drop < 0 and gap > 0 else np.inf
    height, cell = ground.height, ground.cell
    rows, cols = height.shape[0] - 1, height.shape[1] - 1
    enter, leave = 0.0, far
    for axis in range(2):
        low = ground.west if axis == 0 else ground.south
        high = low + cell * (cols if axis == 0 else rows)
        if d[axis] == 0:
            if o[axis] <= low or o[axis] >= high:
                leave = -1.0
        else:
            a, b = (low - o[axis]) / d[axis], (high - o[axis]) / d[axis]
            enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
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


@njit(cache=True)
def hit_unit(kind, q, e, near):
    """First crossing after ``near`` of the unit shape by the local ray q + t e, inf when there is none."""
    if kind == BOX:
        enter, leave = -np.inf, np.inf
        for axis in range(3):
            if e[axis] == 0:
                if abs(q[axis]) > 1:
                    return np.inf
            else:
                a, b = (-1 - q[axis]) / e[axis], (1 - q[axis]) / e[axis]
                enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
        if leave < enter:
            return np.inf
        return enter if enter > near else (leave if leave > near else np.inf)
    if kind == ELLIPSOID:
        a = e[0] * e[0] + e[1] * e[1] + e[2] * e[2]
        b = q[0] * e[0] + q[1] * e[1] + q[2] * e[2]
        disc = b * b - a * (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] - 1)
        if disc < 0:
            return np.inf
        root = np.sqrt(disc)
        t = (-b - root) / a
        if t <= near:
            t = (-b + root) / a
        return t if t > near else np.inf
    return hit_round(kind, q, e, near)


@njit(cache=True)
def hit_round(kind, q, e, near):
    """The same for cylinder, tube and cone: mantles between the caps, then the caps."""
    best = np.inf
    for mantle in range(2 if kind == TUBE else 1):
        radius = 1.0 if mantle == 0 else TUBE_BORE
        # radius along z: r = p - s z, with s = 0 for cylinders and r = (1 - z) / 2 for the cone
        s = 0.5 if kind == CONE else 0.0
        p = 0.5 if kind == CONE else radius
        r0 = p - s * q[2]
        a = e[0] * e[0] + e[1] * e[1] - s * s * e[2] * e[2]
        b = q[0] * e[0] + q[1] * e[1] + s * e[2] * r0
        c = q[0] * q[0] + q[1] * q[1] - r0 * r0
        disc = b * b - a * c
        if disc >= 0 and a != 0:
            root = np.sqrt(disc)
            for sign in (-1.0, 1.0):
                t = (-b + sign * root) / a
                if near < t < best and abs(q[2] + t * e[2]) <= 1:
                    best = t
    if e[2] != 0:
        for cap in (-1.0, 1.0):
            t = (cap - q[2]) / e[2]
            x, y = q[0] + t * e[0], q[1] + t * e[1]
            r2 = x * x + y * y
            outer = 0.0 if (kind == CONE and cap > 0) else 1.0
            inner = TUBE_BORE * TUBE_BORE if kind == TUBE else -1.0
            if near < t < best and inner <= r2 <= outer:
                best = t
    return best


@njit(cache=True)
def missed(low, high, o, d, far):
    """Whether the ray passes the box by, or reaches it only after ``far``."""
    enter, leave = 0.0, far
    for axis in range(3):
        if d[axis] == 0:
            if o[axis] < low[axis] or o[axis] > high[axis]:
                return True
        else:
            a, b = (low[axis] - o[axis]) / d[axis], (high[axis] - o[axis]) / d[axis]
            enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
    return leave < enter


@njit(cache=True)
def hit_bodies(bodies, o, d, far):
    """(ray parameter, body index) of the nearest body before ``far``; (inf, -1) when there is none."""
    best, which = far, -1
    q, e = np.empty(3), np.empty(3)
    node = 0
    while node < bodies.skip.size:
        if missed(bodies.low[node], bodies.high[node], o, d, best):
            node = bodies.skip[node]
            continue
        index = bodies.leaf[node]
        node += 1
        if index < 0:
            continue
        axes, centre, half = bodies.axes[index], bodies.centre[index], bodies.half[index]
        for k in range(3):
            q[k] = (
                axes[0, k] * (o[0] - centre[0]) + axes[1, k] * (o[1] - centre[1]) + axes[2, k] * (o[2] - centre[2])
            ) / half[k]
            e[k] = (axes[0, k] * d[0] + axes[1, k] * d[1] + axes[2, k] * d[2]) / half[k]
        t = hit_unit(bodies.kind[index], q, e, 1e-9)
        while t < best:
            if solid(bodies.porosity[index], o, d, t, index):
                best, which = t, index
                break
            t = hit_unit(bodies.kind[index], q, e, t + 1e-7)
    return (best, which) if which >= 0 else (np.inf, -1)


@njit(cache=True)
def solid(porosity, o, d, t, seed):
    """Whether the shell has matter at the hit: foliage is a shell with holes."""
    if porosity <= 0:
        return True
    x, y, z = (o[0] + t * d[0]) / LEAF, (o[1] + t * d[1]) / LEAF, (o[2] + t * d[2]) / LEAF
    return noise3(x, y, z, seed) > 1.1 * porosity - 0.6


@njit(cache=True)
def body_normal(bodies, index, p, d):
    """Unit normal of a body's surface at p, turned against the ray."""
    axes, half, kind = bodies.axes[index], bodies.half[index], bodies.kind[index]
    v = np.empty(3)
    for k in range(3):
        v[k] = (
            axes[0, k] * (p[0] - bodies.centre[index, 0])
            + axes[1, k] * (p[1] - bodies.centre[index, 1])
            + axes[2, k] * (p[2] - bodies.centre[index, 2])
        ) / half[k]
    if kind == BOX:
        k = int(np.argmax(np.abs(v)))
        sign = 1.0 if v[k] > 0 else -1.0
        v[:] = 0.0
        v[k] = sign
    elif kind == CONE:
        if v[2] < -1 + 1e-6:
            v[:2] = 0.0
        else:
            v[2] = 0.5 * np.hypot(v[0], v[1])
    elif kind != ELLIPSOID:
        if abs(v[2]) > 1 - 1e-6:
            v[:2] = 0.0
        else:
            v[2] = 0.0
    v /= half
    n = axes @ v
    n /= np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    return -n if n[0] * d[0] + n[1] * d[1] + n[2] * d[2] > 0 else n


@njit(cache=True)
def blocked(ground, bodies, o, d, far):
    """Whether anything stands in the ray's way before ``far``."""
    if hit_bodies(bodies, o, d, far)[1] >= 0:
        return True
    return hit_ground(ground, o, d, far) < far
