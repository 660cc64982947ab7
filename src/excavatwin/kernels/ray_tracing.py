"""Pictures and truth by ray tracing: what each ray meets, and the light that comes back along it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, UInt8
from numba import njit, prange

from excavatwin.kernels.noise import noise3
from excavatwin.kernels.ray_casting import blocked, body_normal, hit_bodies
from excavatwin.kernels.ray_ground import height_at, hit_ground
from excavatwin.kernels.ray_shading import FOLIAGE, GLASS, SKY, SUN, body_albedo, ground_albedo, step

FAR = 2000.0
"""Rays end here: sky [m]."""
ABOVE = 50.0
"""Height that the site is looked at from, for its truth from above [m]."""
NOTHING = 255
"""Class of the sky."""


class Light(NamedTuple):
    """What the ground is made of and how much light reaches it, on the terrain's vertices."""

    materials: Float32[np.ndarray, "Y X 3"]
    label: UInt8[np.ndarray, "Y X"]
    """Class of the ground."""
    sunlit: Float32[np.ndarray, "Y X"]
    skylit: Float32[np.ndarray, "y x"]
    to_sun: Float64[np.ndarray, "3"]
    seed: int


@njit(cache=True)
def meet(ground, bodies, o, d, far):
    """(ray parameter, body index) of the first thing met: index -1 is the ground, -2 the sky."""
    t, index = hit_bodies(bodies, o, d, far)
    t_ground = hit_ground(ground, o, d, min(t, far))
    if t_ground < t:
        return t_ground, -1
    return (t, index) if index >= 0 else (np.inf, -2)


@njit(cache=True)
def lattice_value(values, x, y, west, south, cell):
    """Bilinear value of a vertex raster, clamped at its border."""
    u = min(max((x - west) / cell, 0.0), values.shape[1] - 1.001)
    v = min(max((y - south) / cell, 0.0), values.shape[0] - 1.001)
    i, j = int(u), int(v)
    u, v = u - i, v - j
    low = values[j, i] * (1 - u) + values[j, i + 1] * u
    return low * (1 - v) + (values[j + 1, i] * (1 - u) + values[j + 1, i + 1] * u) * v


@njit(cache=True)
def ground_class(g, label, x, y):
    """Class of the ground at a place: that of its nearest vertex."""
    i = min(max(int(np.floor((x - g.west) / g.cell + 0.5)), 0), label.shape[1] - 1)
    j = min(max(int(np.floor((y - g.south) / g.cell + 0.5)), 0), label.shape[0] - 1)
    return label[j, i]


@njit(cache=True)
def light_ground(g, bodies, light, p, footprint, out):
    """Radiance of the ground at p."""
    soil = lattice_value(light.materials[:, :, 0], p[0], p[1], g.west, g.south, g.cell)
    dug = lattice_value(light.materials[:, :, 1], p[0], p[1], g.west, g.south, g.cell)
    gravel = lattice_value(light.materials[:, :, 2], p[0], p[1], g.west, g.south, g.cell)
    edge = g.cell * (g.height.shape[1] - 1)
    if abs(p[0]) < 0.5 * edge and abs(p[1]) < 0.5 * edge:
        lit = lattice_value(light.sunlit, p[0], p[1], g.west, g.south, g.cell)
        sky = lattice_value(light.skylit, p[0], p[1], g.west, g.south, edge / max(light.skylit.shape[1] - 1, 1))
    else:
        lit, sky = 0.0 if hit_bodies(bodies, p, light.to_sun, 60.0)[1] >= 0 else 1.0, 1.0
    ground_albedo(p[0], p[1], p[2], soil, dug, gravel, footprint, light.seed, out)
    r = max(g.cell, 0.5 * footprint)
    gx = (height_at(g, p[0] + r, p[1]) - height_at(g, p[0] - r, p[1])) / (2 * r)
    gy = (height_at(g, p[0], p[1] + r) - height_at(g, p[0], p[1] - r)) / (2 * r)
    length = np.sqrt(1 + gx * gx + gy * gy)
    cosine = max(0.0, (light.to_sun[2] - gx * light.to_sun[0] - gy * light.to_sun[1]) / length)
    for k in range(3):
        out[k] *= SUN[k] * lit * cosine + SKY[k] * sky * (0.5 + 0.5 / length) + 0.04 * (1 - sky)


@njit(cache=True)
def light_body(ground, bodies, light, index, p, d, footprint, out):
    """Radiance of a body at p."""
    finish = bodies.finish[index]
    body_albedo(bodies.albedo[index], finish, p[0], p[1], p[2], index, footprint, out)
    n = body_normal(bodies, index, p, d)
    if finish == FOLIAGE:  # leaves face everywhere
        for k in range(3):
            n[k] += 0.7 * noise3(p[0] / 0.08 + 17 * k, p[1] / 0.08, p[2] / 0.08, 5)
        n /= np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    cosine = n[0] * light.to_sun[0] + n[1] * light.to_sun[1] + n[2] * light.to_sun[2]
    lit = 0.0
    if cosine > 0:
        lit = 0.0 if blocked(ground, bodies, p + 2e-3 * n, light.to_sun, 60.0) else 1.0
    over = step(-0.3, 1.2, p[2] - height_at(ground, p[0], p[1]))  # darker close to the ground
    sky = (0.5 + 0.5 * n[2]) * (0.55 + 0.45 * over)
    for k in range(3):
        out[k] *= SUN[k] * lit * max(0.0, cosine) + SKY[k] * sky + 0.05
    if finish == GLASS:  # mirrors a little sky
        for k in range(3):
            out[k] += 0.10 * SKY[k] * (0.6 + 0.4 * n[2])


@njit(cache=True)
def trace_row(ground, bodies, light, pose, focal, row, samples, colour, depth, label, instance):
    """Fill one row of the four images."""
    height, width = depth.shape
    o = pose[:3, 3].copy()
    ray, d, rgb = np.empty(3), np.empty(3), np.empty(3)
    for col in range(width):
        for sample in range(-1, samples * samples):
            su = 0.5 if sample < 0 else (sample % samples + 0.5) / samples
            sv = 0.5 if sample < 0 else (sample // samples + 0.5) / samples
            ray[0], ray[1] = (col + su - 0.5 * width) / focal, (row + sv - 0.5 * height) / focal
            for k in range(3):
                d[k] = pose[k, 0] * ray[0] + pose[k, 1] * ray[1] + pose[k, 2]
            t, index = meet(ground, bodies, o, d, FAR)
            p = o + t * d
            if sample < 0:  # the truth: through the pixel's centre
                if index > -2:
                    depth[row, col] = t
                    on_ground = ground_class(ground, light.label, p[0], p[1])
                    label[row, col] = on_ground if index < 0 else bodies.label[index]
                    instance[row, col] = 0 if index < 0 else bodies.instance[index]
                continue
            if index == -2:
                up = d[2] / np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
                rgb[0], rgb[1], rgb[2] = 0.75 - 0.5 * up, 0.82 - 0.4 * up, 0.95 - 0.2 * up
            elif index == -1:
                light_ground(ground, bodies, light, p, t / (focal * samples), rgb)
            else:
                light_body(ground, bodies, light, index, p, d, t / (focal * samples), rgb)
            for k in range(3):
                colour[row, col, k] += rgb[k] / (samples * samples)


@njit(cache=True, parallel=True)
def trace(ground, bodies, light, pose, focal, width, height, samples):
    """Linear colour (H, W, 3), depth with NaN for sky, class and object (H, W) of every pixel."""
    colour = np.zeros((height, width, 3), np.float32)
    depth = np.full((height, width), np.nan)
    label = np.full((height, width), np.uint8(NOTHING), np.uint8)
    instance = np.zeros((height, width), np.int32)
    for row in prange(height):
        trace_row(ground, bodies, light, pose, focal, row, samples, colour, depth, label, instance)
    return colour, depth, label, instance


@njit(cache=True)
def look_down(ground, bodies, ground_label, x, y, row, height, surface, label, instance):
    """Fill one row of the four rasters with what vertical rays meet."""
    o, d = np.empty(3), np.array([0.0, 0.0, -1.0])
    for col in range(x.size):
        o[0], o[1], o[2] = x[col], y[row], ABOVE
        height[row, col] = height_at(ground, x[col], y[row])
        t, index = meet(ground, bodies, o, d, 4 * ABOVE)
        surface[row, col] = ABOVE - t
        label[row, col] = ground_class(ground, ground_label, x[col], y[row]) if index < 0 else bodies.label[index]
        instance[row, col] = 0 if index < 0 else bodies.instance[index]


@njit(cache=True, parallel=True)
def rasters(ground, bodies, ground_label, x, y):
    """Bare terrain, surface [m], class and object id at the places (y, x)."""
    shape = (y.size, x.size)
    height, surface = np.empty(shape, np.float32), np.empty(shape, np.float32)
    label, instance = np.empty(shape, np.uint8), np.empty(shape, np.uint8)
    for row in prange(y.size):
        look_down(ground, bodies, ground_label, x, y, row, height, surface, label, instance)
    return height, surface, label, instance
