"""A site on Mitsuba's stage: one mesh whose triangles know what they belong to, and how that answers light."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64, Int32, Int64

from excavatwin.kernels import ray_shading
from excavatwin.kernels.surface_colour import ground_colours
from excavatwin.simulation.bodies import ALBEDO, FINISH, Material
from excavatwin.simulation.photoreal.backend import backend
from excavatwin.simulation.photoreal.foliage import leafage
from excavatwin.simulation.photoreal.meshes import Triangles, join, solid, terrain
from excavatwin.simulation.site import Contents, DigSite, contents

GLOSS = {Material.YELLOW_PAINT: 0.7, Material.WHITE_PAINT: 0.8, Material.BLUE_PAINT: 0.7, Material.RED_PAINT: 0.7,
         Material.GLASS: 1.0, Material.DARK_STEEL: 0.35, Material.ORANGE_PLASTIC: 0.4}  # fmt: skip
"""Share of the clear coat's reflection that a material shows, 0..1; others are matt."""
BROAD = 0.25
"""Footprint of the colours that light bounces off, and that irradiance is told apart from [m]."""


@dataclass(frozen=True, eq=False)
class Stage:
    """What Mitsuba's rays can meet, and what they need to know there."""

    scene: Any
    """``mi.Scene`` of one mesh."""
    contents: Contents
    owner: Int32[np.ndarray, "f"]
    """Body of each triangle, -1 for the ground."""
    leaf: Int32[np.ndarray, "f"]
    """Leaf of each triangle, -1 for what is no leaf."""
    albedo: Float64[np.ndarray, "n 3"]
    """Reflectance of each body."""
    seed: int
    """Of the textures."""
    finish: Int64[np.ndarray, "n"]
    """``ray_shading.PAINT``, ``FOLIAGE`` or ``GLASS`` of each body."""
    owner_of: Any
    """``owner + 1`` as ``mi.UInt32``."""
    body_albedo: Any
    """Reflectance by ``owner + 1``, three ``mi.Float``."""
    ground_albedo: Any
    """Broad reflectance of the ground as ``mi.Texture2f`` over the modelled square."""
    gloss: Any
    """By ``owner + 1``, ``mi.Float``."""
    leafy: Any
    """1 where light comes through, by ``owner + 1``, ``mi.Float``."""


def triangles(site: DigSite) -> Triangles:
    """The site as one mesh; foliage is grown from the site's seed."""
    inside = contents(site)
    parts = [terrain(inside.ground, site.extent)]
    grown = 0
    for index, body in enumerate(inside.bodies):
        if body.porosity <= 0:
            parts.append(solid(body, index))
            continue
        mesh, count = leafage(body, index, grown, np.random.default_rng((site.seed, index)))
        grown += count
        parts.append(mesh)
    return join(parts)


@lru_cache(maxsize=1)
def stage(site: DigSite) -> Stage:
    """Build the mesh and its ray-tracing tree: seconds, hence kept for the next view of the same site.

    Raises:
        MissingExtraError: Mitsuba or LLVM is missing.
    """
    mi, _ = backend()
    mesh = triangles(site)
    inside = contents(site)
    materials = [body.material for body in inside.bodies]
    albedo = ALBEDO[[int(m) for m in materials]].reshape(-1, 3)
    finish = np.array([FINISH.get(m, ray_shading.PAINT) for m in materials], np.int64)
    by_owner = np.concatenate([np.zeros((1, 3)), albedo])
    gloss = np.array([0.0] + [GLOSS.get(m, 0.0) for m in materials])
    leafy = np.concatenate([[0.0], finish == ray_shading.FOLIAGE])
    return Stage(
        scene=_scene(mesh),
        contents=inside,
        owner=mesh.owner,
        leaf=mesh.leaf,
        albedo=albedo,
        seed=site.seed,
        finish=finish,
        owner_of=mi.UInt32((mesh.owner + 1).astype(np.uint32)),
        body_albedo=[_floats(column) for column in by_owner.T],
        ground_albedo=mi.Texture2f(mi.TensorXf(broad_ground(site)), wrap_mode=_clamp()),
        gloss=_floats(gloss),
        leafy=_floats(leafy),
    )


def broad_ground(site: DigSite) -> Float32[np.ndarray, "n n 3"]:
    """The ground's reflectance over the modelled square without its detail, row 0 south."""
    ground = contents(site).ground
    count = max(2, int(round(2 * site.half / BROAD)))
    along = ground.west + (np.arange(count) + 0.5) * 2 * site.half / count
    x, y = np.meshgrid(along, along)
    points = np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3)
    footprint = np.full(len(points), BROAD, np.float32)
    colours = ground_colours(points, footprint, ground.materials, ground.west, ground.south, ground.cell, site.seed)
    return colours.reshape(count, count, 3)


def _scene(mesh: Triangles) -> Any:
    mi, _ = backend()
    shape = mi.Mesh("site", len(mesh.vertex), len(mesh.face), has_vertex_normals=True)
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = mi.Float(mesh.vertex.ravel())
    parameters["vertex_normals"] = mi.Float(mesh.normal.ravel())
    parameters["faces"] = mi.UInt32(mesh.face.ravel())
    parameters.update()
    return mi.load_dict({"type": "scene", "site": shape})


def _floats(values: np.ndarray) -> Any:
    return backend().mi.Float(np.ascontiguousarray(values, np.float32))


def _clamp() -> Any:
    return backend().dr.WrapMode.Clamp
