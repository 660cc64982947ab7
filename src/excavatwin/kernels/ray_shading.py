"""Colours: procedural materials under one sun and a blue sky."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64
from numba import njit, prange

from excavatwin.kernels.noise import hash_unit, noise3, octaves
from excavatwin.kernels.ray_casting import blocked

PAINT, FOLIAGE, GLASS = 0, 1, 2
"""How a body's surface answers light."""
SUN = np.array([1.0, 0.95, 0.86])
SKY = np.array([0.30, 0.34, 0.41])
"""Irradiance of the sun and of the whole sky, relative."""


@njit(cache=True)
def step(low, high, value):
    """Smoothstep of one number."""
    t = min(max((value - low) / (high - low), 0.0), 1.0)
    return t * t * (3 - 2 * t)


@njit(cache=True)
def ground_albedo(x, y, z, soil, dug, gravel, footprint, seed, out):
    """Reflectance of the ground: turf, dry soil, moist dug soil and gravel, rich down to centimetres."""
    broad = octaves(x, y, z, 3.7, 2.3, 0.6, 3, footprint, seed)
    fine = octaves(x, y, z, 0.42, 1.9, 0.86, 6, footprint, seed + 7)
    ragged = 0.25 * fine
    dry = step(-0.7, 0.9, broad + 0.25 * fine)
    w_soil, w_dug, w_gravel = step(-0.2, 0.2, soil + ragged), step(-0.1, 0.1, dug + 0.5 * ragged), 0.0
    w_gravel = step(-0.15, 0.15, gravel + ragged) * (1 - w_dug)
    tyre = 1 - 0.18 * step(0.0, 1.6, gravel)
    for k in range(3):
        turf = ((0.062, 0.105, 0.030)[k] * (1 - dry) + (0.150, 0.150, 0.058)[k] * dry) * max(0.25, 1 + 0.42 * fine)
        earth = ((0.215, 0.150, 0.095)[k] * (1 - dry) + (0.330, 0.255, 0.175)[k] * dry) * max(0.3, 1 + 0.24 * fine)
        moist = ((0.130, 0.080, 0.045)[k] * (1 - dry) + (0.235, 0.145, 0.080)[k] * dry) * max(0.3, 1 + 0.30 * fine)
        stone = (0.300, 0.285, 0.262)[k] * tyre * (1 + 0.12 * broad) * max(0.3, 1 + 0.32 * fine)
        value = turf + w_soil * (earth - turf)
        value += w_gravel * (stone - value)
        out[k] = value + w_dug * (moist - value)
    pebble = noise3(x / 0.075, y / 0.075, z / 0.075, seed + 31)
    if pebble > 0.62 and max(w_soil, w_dug) > 0.5:  # pale stones
        for k in range(3):
            out[k] += (0.42 - out[k]) * 0.6 * step(0.62, 0.75, pebble) * min(1.0, 0.1 / max(footprint, 1e-6))


@njit(cache=True)
def body_albedo(albedo, finish, x, y, z, index, footprint, out):
    """Reflectance of a body: paint with dirt on it, mottled leaves, stained concrete."""
    fine = octaves(x, y, z, 0.35, 2.0, 0.8, 5, footprint, 1000 + index)
    shade = 1 + (0.42 if finish == FOLIAGE else 0.15) * fine
    shade *= 0.85 + 0.3 * hash_unit(index, 3, 5, 11)
    for k in range(3):
        out[k] = albedo[k] * max(shade, 0.2)
    mud = 0.5 * fine + octaves(x, y, z, 0.5, 2.1, 0.8, 5, footprint, 77)
    dirt = step(0.1 if finish == GLASS else 0.25, 1.0, mud)
    if finish != FOLIAGE:
        for k in range(3):
            out[k] += 0.45 * dirt * ((0.20, 0.15, 0.10)[k] - out[k])


@njit(cache=True, parallel=True)
def sunlit(ground, bodies, to_sun):
    """1 where a terrain vertex sees the sun, else 0 (Y, X)."""
    rows, cols = ground.height.shape
    out = np.zeros((rows, cols), np.float32)
    for row in prange(rows):
        o = np.empty(3)
        for col in range(cols):
            o[0], o[1] = ground.west + col * ground.cell, ground.south + row * ground.cell
            o[2] = ground.height[row, col] + 0.004
            out[row, col] = 0.0 if blocked(ground, bodies, o, to_sun, 60.0) else 1.0
    return out


def sky_directions(rings: int = 3, sectors: int = 8) -> Float64[np.ndarray, "n 3"]:
    """Directions that sample the sky with the cosine of the zenith angle."""
    directions = []
    for ring in range(rings):
        up = np.sqrt((ring + 0.5) / rings)
        for sector in range(sectors):
            turn = 2 * np.pi * (sector + ring / rings) / sectors
            directions.append((np.sqrt(1 - up * up) * np.cos(turn), np.sqrt(1 - up * up) * np.sin(turn), up))
    return np.array(directions)


@njit(cache=True, parallel=True)
def skylit(ground, bodies, directions, stride, reach):
    """Share of the sky that every ``stride``-th terrain vertex sees within ``reach`` metres."""
    rows, cols = (ground.height.shape[0] - 1) // stride + 1, (ground.height.shape[1] - 1) // stride + 1
    out = np.zeros((rows, cols), np.float32)
    for row in prange(rows):
        o = np.empty(3)
        for col in range(cols):
            o[0], o[1] = ground.west + col * stride * ground.cell, ground.south + row * stride * ground.cell
            o[2] = ground.height[row * stride, col * stride] + 0.02
            free = 0
            for k in range(directions.shape[0]):
                free += 0 if blocked(ground, bodies, o, directions[k], reach) else 1
            out[row, col] = free / directions.shape[0]
    return out
