"""Photos of a site with their exact truth: image, depth, world point, task class and object of every pixel."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, Int32, UInt8

from excavatwin.kernels.ray_casting import BodyArrays
from excavatwin.kernels.ray_ground import BLOCK, GroundArrays
from excavatwin.kernels.ray_shading import sky_directions, skylit, sunlit
from excavatwin.kernels.ray_tracing import Light, trace
from excavatwin.simulation.bodies import body_arrays
from excavatwin.simulation.camera import Camera
from excavatwin.simulation.site import DigSite, contents

EXPOSURE = 1.15


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
    inside = contents(site).ground
    lit = sunlit(ground, bodies, to_sun)
    sky = skylit(ground, bodies, sky_directions(), stride, 4.0)
    return Scene(ground, bodies, Light(inside.materials, inside.label, lit, sky, to_sun, site.seed))


@lru_cache(maxsize=2)
def unlit(site: DigSite) -> Scene:
    """The site in the dark: enough for depth, class and object, at a small part of the cost."""
    ground, bodies = geometry(site)
    inside = contents(site).ground
    dark = np.zeros((2, 2), np.float32)
    return Scene(ground, bodies, Light(inside.materials, inside.label, dark, dark, site.to_sun, site.seed))


def render_view(site: DigSite, camera: Camera, samples: int = 2, grain: float = 0.8) -> RenderedView:
    """Take a photo.

    Args:
        samples: rays per pixel along each axis, for colour (0 leaves the image black); the truth is that of the
            pixel's centre.
        grain: standard deviation of the sensor's noise [grey levels of 255].
    """
    colour, view = traced(site, camera, samples)
    rng = np.random.default_rng(np.frombuffer(np.ascontiguousarray(camera.T_M_cam).tobytes(), np.uint32))
    noise = rng.normal(0, grain, colour.shape).astype(np.float32)
    image = np.clip(255 * np.clip(EXPOSURE * colour, 0, None) ** (1 / 2.2) + noise, 0, 255).round().astype(np.uint8)
    return replace(view, image=image)


def traced(site: DigSite, camera: Camera, samples: int) -> tuple[Float32[np.ndarray, "H W 3"], RenderedView]:
    """Linear colour of a photo, and its truth with a black image."""
    pose = np.ascontiguousarray(camera.T_M_cam)
    colour, t, label, instance = trace(
        *(scene if samples else unlit)(site), pose, camera.focal, camera.width, camera.height, samples
    )
    points = camera.T_M_cam[:3, 3] + t[..., None] * (pixel_rays(camera) @ camera.T_M_cam[:3, :3].T)
    black = np.zeros(colour.shape, np.uint8)
    return colour, RenderedView(black, t.astype(np.float32), points.astype(np.float32), label, instance)


def pixel_rays(camera: Camera) -> Float64[np.ndarray, "H W 3"]:
    """Rays through the pixel centres in camera axes, with unit depth: a ray's parameter is its depth."""
    u = (np.arange(camera.width) + 0.5 - camera.width / 2) / camera.focal
    v = (np.arange(camera.height) + 0.5 - camera.height / 2) / camera.focal
    return np.stack(np.broadcast_arrays(u[None, :], v[:, None], 1.0), -1)
