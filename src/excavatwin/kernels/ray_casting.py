"""Exact ray casting of bodies: boxes, cylinders, tubes, cones and ellipsoids as affine images of unit shapes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int32, Int64, UInt8
from numba import njit

from excavatwin.kernels.noise import noise3
from excavatwin.kernels.ray_ground import hit_ground

BOX, CYLINDER, TUBE, CONE, ELLIPSOID = 0, 1, 2, 3, 4
"""Unit shapes: all fill [-1, 1]^3; round ones have their axis along local z, the cone's tip is at z = +1."""
TUBE_BORE = 0.82
"""Inner over outer radius of a tube."""
LEAF = 0.09
"""Wavelength of the holes of foliage [m]."""


class BodyArrays(NamedTuple):
    """Bodies with a bounding-volume hierarchy, as arrays for the ray caster."""

    centre: Float64[np.ndarray, "n 3"]
    axes: Float64[np.ndarray, "n 3 3"]
    half: Float64[np.ndarray, "n 3"]
    kind: Int64[np.ndarray, "n"]
    albedo: Float64[np.ndarray, "n 3"]
    """Linear reflectance, red green blue."""
    finish: Int64[np.ndarray, "n"]
    """``ray_shading.PAINT``, ``FOLIAGE`` or ``GLASS``."""
    porosity: Float64[np.ndarray, "n"]
    label: UInt8[np.ndarray, "n"]
    instance: Int32[np.ndarray, "n"]
    low: Float64[np.ndarray, "m 3"]
    """Boxes of the tree's nodes, in depth-first order."""
    high: Float64[np.ndarray, "m 3"]
    skip: Int64[np.ndarray, "m"]
    """The node to go on with when the box is missed: no stack needed."""
    leaf: Int64[np.ndarray, "m"]
    """Index of the node's body, -1 for inner nodes."""


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
