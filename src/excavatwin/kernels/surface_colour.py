"""Reflectance at given places: the materials of ``ray_shading`` for points that another ray tracer has found."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from excavatwin.kernels.noise import hash_unit
from excavatwin.kernels.ray_shading import body_albedo, ground_albedo
from excavatwin.kernels.ray_tracing import lattice_value

NO_OWNER = -2
"""Owner of a point in the sky."""


@njit(cache=True)
def colour_ground(p, footprint, materials, west, south, cell, seed, out):
    """Reflectance of the ground at p."""
    soil = lattice_value(materials[:, :, 0], p[0], p[1], west, south, cell)
    dug = lattice_value(materials[:, :, 1], p[0], p[1], west, south, cell)
    gravel = lattice_value(materials[:, :, 2], p[0], p[1], west, south, cell)
    ground_albedo(p[0], p[1], p[2], soil, dug, gravel, footprint, seed, out)


@njit(cache=True, parallel=True)
def ground_colours(points, footprint, materials, west, south, cell, seed):
    """Reflectance of the ground (n, 3) at points (n, 3) seen with footprints (n,) [m]."""
    out = np.zeros((points.shape[0], 3), np.float32)
    for k in prange(points.shape[0]):
        rgb = np.zeros(3)
        colour_ground(points[k], footprint[k], materials, west, south, cell, seed, rgb)
        out[k] = rgb
    return out


@njit(cache=True, parallel=True)
def surface_colours(points, owner, leaf, footprint, materials, west, south, cell, albedo, finish, seed):
    """Reflectance (n, 3) at points of frame M.

    Args:
        points: (n, 3) [m].
        owner: body of each point, -1 for the ground, ``NO_OWNER`` for the sky, which stays black (n,).
        leaf: number of the leaf that a point lies on, -1 for none (n,): no two leaves have quite the same colour.
        footprint: edge of the area that a point stands for (n,) [m].
        materials, west, south, cell: of the terrain's vertices, as in ``scene`` of the fast tracer.
        albedo, finish: of the bodies.
    """
    out = np.zeros((points.shape[0], 3), np.float32)
    for k in prange(points.shape[0]):
        if owner[k] == NO_OWNER:
            continue
        rgb, p, index = np.zeros(3), points[k], owner[k]
        if index < 0:
            colour_ground(p, footprint[k], materials, west, south, cell, seed, rgb)
        else:
            body_albedo(albedo[index], finish[index], p[0], p[1], p[2], index, footprint[k], rgb)
        if leaf[k] >= 0:
            shade = 0.9 + 0.9 * hash_unit(leaf[k], 1, 2, seed)
            yellow = hash_unit(leaf[k], 3, 4, seed) ** 2
            rgb[0] *= shade * (1 + 0.5 * yellow)
            rgb[1] *= shade * (1 + 0.25 * yellow)
            rgb[2] *= shade
        out[k] = rgb
    return out
