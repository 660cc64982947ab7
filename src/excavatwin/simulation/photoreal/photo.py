"""A photo by Mitsuba, and its truth of the very triangles that were rendered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float32, Float64, Int32, UInt8

from excavatwin.kernels.irradiance import smoothed
from excavatwin.kernels.ray_tracing import ABOVE
from excavatwin.kernels.surface_colour import NO_OWNER, surface_colours
from excavatwin.scene.grid import Grid
from excavatwin.simulation.camera import Camera
from excavatwin.simulation.conditions import Conditions
from excavatwin.simulation.photoreal.lighting import AROUND_EVERY, NOTHING, Hits, Sample, first_hits, sample_light
from excavatwin.simulation.photoreal.sky import Daylight, daylight
from excavatwin.simulation.photoreal.stage import Stage, stage
from excavatwin.simulation.render import RenderedView, pixel_rays
from excavatwin.simulation.sensor import bucket_place, develop, dusty
from excavatwin.simulation.site import DigSite
from excavatwin.simulation.terrain import Ground

COLOUR_RAYS = 4
"""Rays a pixel at which colour is looked up; the others find light only."""
WHITE = 0.68
"""Reflectance that the exposure brings to full scale in sun and sky."""


def render(site: DigSite, camera: Camera, samples: int = 16, conditions: Conditions | None = None) -> RenderedView:
    """Take a photo with Mitsuba.

    Args:
        samples: light rays per pixel; 0 leaves the image black and gives the truth only. The truth is that of the
            pixel's centre, of the very geometry that is in the picture.

    Raises:
        MissingExtraError: Mitsuba or LLVM's library is missing; the message tells the line to type.
    """
    conditions = conditions or Conditions()
    site = conditions.at(site)
    built = stage(_unlit(site))
    rays = pixel_rays(camera) @ camera.T_M_cam[:3, :3].T
    hits = first_hits(built, camera.T_M_cam[:3, 3], rays.reshape(-1, 3))
    view = _truth(built, camera, rays, hits)
    if samples == 0:
        return view
    light = daylight(*site.sun, conditions.turbidity)
    seed = int.from_bytes(np.ascontiguousarray(camera.T_M_cam).tobytes()[:4], "little") % 65521
    radiance = _radiance(built, light, camera, samples, hits, view, seed)
    at = bucket_place(built.contents) if conditions.dust else None
    if at is not None:
        radiance = dusty(radiance, camera, rays, view.depth.astype(float), at, conditions.dust, light.on_the_ground)
    exposure = np.pi / (WHITE * float(light.on_the_ground.mean()))
    image = develop(radiance, conditions, exposure, (site.seed, seed))
    return RenderedView(image, view.depth, view.points, view.label, view.instance)


def _truth(built: Stage, camera: Camera, rays: Float64[np.ndarray, "H W 3"], hits: Hits) -> RenderedView:
    shape = (camera.height, camera.width)
    met = hits.triangle != NOTHING
    depth = np.where(met, hits.t, np.nan).reshape(shape)
    points = camera.T_M_cam[:3, 3] + depth[..., None] * rays
    owner = owners(built, hits.triangle)
    label = classes(built, owner, points.reshape(-1, 3)).reshape(shape)
    instance = np.array([0, *built.contents.instances], np.int32)[np.maximum(owner, -1) + 1].reshape(shape)
    black = np.zeros((*shape, 3), np.uint8)
    return RenderedView(black, depth.astype(np.float32), points.astype(np.float32), label, instance)


def owners(built: Stage, triangle: np.ndarray) -> Int32[np.ndarray, "n"]:
    """Body of each hit, -1 for the ground, ``NO_OWNER`` for the sky."""
    met = triangle != NOTHING
    return np.where(met, built.owner[np.where(met, triangle, 0)], NO_OWNER).astype(np.int32)


def classes(built: Stage, owner: Int32[np.ndarray, "n"], points: Float64[np.ndarray, "n 3"]) -> UInt8[np.ndarray, "n"]:
    """Task class of each hit, 255 for the sky; on the ground that of the nearest vertex."""
    ground: Ground = built.contents.ground
    label = np.array([0, *built.contents.labels], np.uint8)[np.maximum(owner, -1) + 1]
    there = owner == -1
    last = ground.label.shape[0] - 1
    col = np.clip(np.floor((points[there, 0] - ground.west) / ground.cell + 0.5), 0, last).astype(int)
    row = np.clip(np.floor((points[there, 1] - ground.south) / ground.cell + 0.5), 0, last).astype(int)
    label[there] = ground.label[row, col]
    label[owner == NO_OWNER] = 255
    return label


def seen_from_above(
    site: DigSite, grid: Grid
) -> tuple[Float32[np.ndarray, "Y X"], UInt8[np.ndarray, "Y X"], UInt8[np.ndarray, "Y X"]]:
    """Height [m], task class and object id of what vertical rays through the cell centres meet first."""
    built = stage(_unlit(site))
    x, y = np.meshgrid(grid.x, grid.y)
    origin = np.stack([x, y, np.full(x.shape, ABOVE)], -1).reshape(-1, 3)
    hits = first_hits(built, origin, np.broadcast_to([0.0, 0.0, -1.0], origin.shape))
    owner = owners(built, hits.triangle)
    points = origin - hits.t[:, None] * np.array([0, 0, 1.0])
    instance = np.array([0, *built.contents.instances], np.uint8)[np.maximum(owner, -1) + 1]
    surface = points[:, 2].astype(np.float32)
    return tuple(v.reshape(grid.shape) for v in (surface, classes(built, owner, points), instance))  # type: ignore[return-value]


def _radiance(
    built: Stage, light: Daylight, camera: Camera, samples: int, hits: Hits, view: RenderedView, seed: int
) -> Float32[np.ndarray, "H W 3"]:
    """Colour times irradiance, plus what is mirrored."""
    shape = (camera.height, camera.width)
    count = shape[0] * shape[1]
    met, seen, sun = (np.zeros(count, np.float32) for _ in range(3))
    around, gloss = np.zeros((count, 3), np.float32), np.zeros((count, 3), np.float32)
    colour = np.zeros((count, 3), np.float32)
    coloured = min(samples, COLOUR_RAYS)
    for number in range(samples):
        sample = sample_light(built, light, camera, number, seed)
        here = sample.triangle != NOTHING
        met += here
        seen += here if number % AROUND_EVERY == 0 else 0
        sun += sample.sun
        around += sample.around
        gloss += sample.gloss
        if number < coloured:
            colour += _colours(built, sample, camera, view) / coloured
    around /= np.maximum(seen, 1)[:, None]
    steady = _filtered(around.reshape(*shape, 3), camera, hits, view).reshape(-1, 3)
    irradiance = (sun / np.maximum(met, 1))[:, None] * light.sun + steady
    return (colour * irradiance / np.pi + gloss / samples).reshape(*shape, 3).astype(np.float32)


def _colours(built: Stage, sample: Sample, camera: Camera, view: RenderedView) -> Float32[np.ndarray, "n 3"]:
    """Reflectance at the places of a sample, as fine as half a pixel shows it."""
    ground: Ground = built.contents.ground
    owner = owners(built, sample.triangle)
    met = sample.triangle != NOTHING
    distance = np.linalg.norm(sample.place - camera.T_M_cam[:3, 3], axis=1)
    footprint = np.where(met, 0.5 * distance / camera.focal, 1.0).astype(np.float32)
    leaf = np.where(met, built.leaf[np.where(met, sample.triangle, 0)], -1).astype(np.int32)
    return surface_colours(
        sample.place.astype(float), owner, leaf, footprint, ground.materials, ground.west, ground.south, ground.cell,
        built.albedo, built.finish, built.seed,
    )  # fmt: skip


def _filtered(
    around: Float32[np.ndarray, "H W 3"], camera: Camera, hits: Hits, view: RenderedView
) -> Float32[np.ndarray, "H W 3"]:
    """The light of sky and surroundings without its noise."""
    normal = hits.normal.reshape(*around.shape)
    for step in (1, 2, 4):
        around = smoothed(around, view.depth, normal, view.depth / camera.focal, step, 0.08, 2.0)
    return around


def _unlit(site: DigSite) -> DigSite:
    """The site as its geometry sees it: the same at every hour."""
    return replace(site, sun=(0.0, 90.0))
