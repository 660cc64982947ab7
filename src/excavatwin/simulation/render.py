"""Photos of a site with their exact truth: image, depth, world point, task class and object of every pixel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, Int32, UInt8
from numba import njit, prange

from excavatwin.scene.taxonomy import NOT_OBSERVED, TaskClass
from excavatwin.simulation.bodies import BodyArrays, body_arrays
from excavatwin.simulation.camera import Camera
from excavatwin.simulation.noise import noise3
from excavatwin.simulation.rays import BLOCK, GroundArrays, body_normal, height_at, hit_bodies, hit_ground
from excavatwin.simulation.shading import (
    GLASS,
    GRASS,
    LEAVES,
    SKY,
    SUN,
    blocked,
    body_albedo,
    ground_albedo,
    sky_directions,
    skylit,
    step,
    sunlit,
)  # fmt: skip
from excavatwin.simulation.site import DigSite, contents

FAR = 2000.0
"""Rays end here: sky [m]."""
CONSTRUCTION, OTHER = int(TaskClass.CONSTRUCTION_TERRAIN), int(TaskClass.OTHER_TERRAIN)
EXPOSURE = 1.15


class Light(NamedTuple):
    """What the ground is made of and how much light reaches it, on the terrain's vertices."""

    materials: Float32[np.ndarray, "Y X 3"]
    sunlit: Float32[np.ndarray, "Y X"]
    skylit: Float32[np.ndarray, "y x"]
    to_sun: Float64[np.ndarray, "3"]
    seed: int


class Scene(NamedTuple):
    """A site as arrays for the renderer."""

    ground: GroundArrays
    bodies: BodyArrays
    light: Light


@dataclass(frozen=True, eq=False)
class RenderedView:
    """One photo and its truth, all (H, W)."""

    image: UInt8[np.ndarray, "H W 3"]
    """RGB."""
    depth: Float32[np.ndarray, "H W"]
    """Along the optical axis, at the pixel's centre; NaN in the sky [m]."""
    points: Float32[np.ndarray, "H W 3"]
    """Frame M; NaN in the sky [m]."""
    label: UInt8[np.ndarray, "H W"]
    """Task class; 255 in the sky."""
    instance: Int32[np.ndarray, "H W"]
    """Object id, 0 = none."""


def geometry(site: DigSite) -> tuple[GroundArrays, BodyArrays]:
    """What rays can meet."""
    inside = contents(site)
    ground = inside.ground
    rows, cols = (n - 1 for n in ground.height.shape)
    blocks = np.full((-(-rows // BLOCK), -(-cols // BLOCK)), -np.inf, np.float32)
    for dj in range(BLOCK + 1):  # a block's cells share their last vertices with the next block
        for di in range(BLOCK + 1):
            part = ground.height[dj::BLOCK, di::BLOCK][: blocks.shape[0], : blocks.shape[1]]
            view = blocks[: part.shape[0], : part.shape[1]]
            np.maximum(view, part, out=view)
    top = float(ground.height.max())
    arrays = GroundArrays(ground.height, blocks, ground.west, ground.south, ground.cell, top, ground.plane)
    return arrays, body_arrays(inside.bodies, inside.labels, inside.instances)


@lru_cache(maxsize=2)
def scene(site: DigSite) -> Scene:
    """The site with its light worked out: which terrain vertices see the sun, and how much of the sky."""
    ground, bodies = geometry(site)
    stride = max(1, round(0.1 / site.cell))
    to_sun = site.to_sun
    lit = sunlit(ground, bodies, to_sun)
    sky = skylit(ground, bodies, sky_directions(), stride, 4.0)
    return Scene(ground, bodies, Light(contents(site).ground.materials, lit, sky, to_sun, site.seed))


def render_view(site: DigSite, camera: Camera, samples: int = 2, grain: float = 0.8) -> RenderedView:
    """Take a photo.

    Args:
        samples: rays per pixel along each axis, for colour (0 leaves the image black); the truth is that of the
            pixel's centre.
        grain: standard deviation of the sensor's noise [grey levels of 255].
    """
    pose = np.ascontiguousarray(camera.T_M_cam)
    colour, t, label, instance = trace(*scene(site), pose, camera.focal, camera.width, camera.height, samples)
    rng = np.random.default_rng(np.frombuffer(pose.tobytes(), np.uint32))
    noise = rng.normal(0, grain, colour.shape).astype(np.float32)
    image = np.clip(255 * np.clip(EXPOSURE * colour, 0, None) ** (1 / 2.2) + noise, 0, 255).round().astype(np.uint8)
    rays = pixel_rays(camera)
    points = camera.T_M_cam[:3, 3] + t[..., None] * (rays @ camera.T_M_cam[:3, :3].T)
    return RenderedView(image, t.astype(np.float32), points.astype(np.float32), label, instance)


def pixel_rays(camera: Camera) -> Float64[np.ndarray, "H W 3"]:
    """Rays through the pixel centres in camera axes, with unit depth: a ray's parameter is its depth."""
    u = (np.arange(camera.width) + 0.5 - camera.width / 2) / camera.focal
    v = (np.arange(camera.height) + 0.5 - camera.height / 2) / camera.focal
    return np.stack(np.broadcast_arrays(u[None, :], v[:, None], 1.0), -1)


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
def ground_class(g, m, x, y):
    """Task class of the ground at a place: that of its nearest vertex."""
    i = min(max(int(np.floor((x - g.west) / g.cell + 0.5)), 0), m.shape[1] - 1)
    j = min(max(int(np.floor((y - g.south) / g.cell + 0.5)), 0), m.shape[0] - 1)
    return CONSTRUCTION if m[j, i, 0] > 0 or m[j, i, 1] > 0 or m[j, i, 2] > 0 else OTHER


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
    material = bodies.material[index]
    body_albedo(material, p[0], p[1], p[2], index, footprint, out)
    n = body_normal(bodies, index, p, d)
    leafy = material in (LEAVES, GRASS)
    if leafy:  # leaves face everywhere
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
    if material == GLASS:  # mirrors a little sky
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
                    on_ground = ground_class(ground, light.materials, p[0], p[1])
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
    label = np.full((height, width), np.uint8(NOT_OBSERVED), np.uint8)
    instance = np.zeros((height, width), np.int32)
    for row in prange(height):
        trace_row(ground, bodies, light, pose, focal, row, samples, colour, depth, label, instance)
    return colour, depth, label, instance
