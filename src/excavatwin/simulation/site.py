"""A procedural dig site: a seed and a few lengths decide everything that a ray can meet, exactly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from jaxtyping import Float64

from excavatwin.errors import InputError
from excavatwin.scene.elevation_map import MapObject
from excavatwin.scene.taxonomy import TaskClass
from excavatwin.simulation import models
from excavatwin.simulation.bodies import Body
from excavatwin.simulation.terrain import Earthworks, Ground, Pad
from excavatwin.simulation.worksite import Worksite


@dataclass(frozen=True)
class Placement:
    """A model, where it stands and which way it faces."""

    name: str
    task_class: TaskClass
    model: Callable[[], list[Body]]
    x: float
    y: float
    yaw: float
    """[deg]"""
    pad: float
    """Radius of the levelled ground under it [m]."""
    category: str = "material"
    """One of ``CATEGORIES``: what an annotator would call it."""


@dataclass(frozen=True)
class Plant:
    """A plant at a place, grown from its own seed."""

    model: Callable[[np.random.Generator, float], list[Body]]
    x: float
    y: float
    height: float
    """[m]"""
    seed: int


CATEGORIES = ("excavator", "truck", "person", "cone", "material")
"""The five categories of objects; the first is the machine, the others are obstacles."""
PLACEMENTS = (
    Placement("excavator", TaskClass.EXCAVATOR, models.excavator, 2.7, -4.6, 88.0, 1.5, "excavator"),
    Placement("pickup", TaskClass.OBSTACLE, models.pickup, 10.1, 4.5, 98.0, 2.8, "truck"),
    Placement("pipes", TaskClass.OBSTACLE, models.pipe_row, -8.0, -7.6, 65.0, 2.2),
    Placement("skip", TaskClass.OBSTACLE, models.skip, 3.4, 7.4, 8.0, 1.9),
    Placement("block", TaskClass.OBSTACLE, models.block, -1.2, -8.2, 30.0, 1.1),
    Placement("toolbox", TaskClass.OBSTACLE, models.toolbox, 7.2, -7.6, -25.0, 1.0),
    Placement("cone", TaskClass.OBSTACLE, models.cone, 7.3, -1.4, 0.0, 0.4, "cone"),
    Placement("cone", TaskClass.OBSTACLE, models.cone, -0.6, -1.7, 20.0, 0.4, "cone"),
)
"""Where the objects of the default site stand."""


@dataclass(frozen=True)
class DigSite:
    """Parameters of a site; equal parameters give equal sites."""

    seed: int = 7
    extent: float = 30.0
    """Edge of the square of which truth is kept, about the origin of frame M [m]."""
    margin: float = 7.0
    """Width of the modelled terrain around it; beyond lies a tilted plane of meadow [m]."""
    cell: float = 0.025
    """Spacing of the terrain's vertices [m]."""
    earthworks: Earthworks | Worksite = field(default_factory=Earthworks)
    placements: tuple[Placement, ...] = PLACEMENTS
    vegetation: float = 1.0
    """Scale of the number of trees, bushes and tufts; 0 leaves the short turf only."""
    plants: tuple[Plant, ...] | None = None
    """The plants, where they are not to be drawn from the seed; ``vegetation`` is then without effect."""
    sun: tuple[float, float] = (215.0, 48.0)
    """Azimuth clockwise from north and elevation of the sun [deg]."""

    @property
    def half(self) -> float:
        """Half the edge of the modelled terrain [m]."""
        return self.extent / 2 + self.margin

    @property
    def pads(self) -> tuple[Pad, ...]:
        """The levelled places under the objects."""
        return tuple(Pad(p.x, p.y, p.pad) for p in self.placements)

    @property
    def to_sun(self) -> Float64[np.ndarray, "3"]:
        """Unit vector towards the sun, frame M."""
        azimuth, elevation = np.deg2rad(self.sun)
        return np.array([np.sin(azimuth) * np.cos(elevation), np.cos(azimuth) * np.cos(elevation), np.sin(elevation)])


@dataclass(frozen=True, eq=False)
class Contents:
    """What a site is made of."""

    ground: Ground
    bodies: list[Body]
    labels: list[int]
    """Task class of each body."""
    instances: list[int]
    """Object id of each body, 0 for cover."""
    objects: tuple[MapObject, ...]


@lru_cache(maxsize=2)
def contents(site: DigSite) -> Contents:
    """Build the terrain and put everything on it.

    Raises:
        InputError: something is to stand outside the modelled terrain.
    """
    for place in site.placements:
        if max(abs(place.x), abs(place.y)) > site.extent / 2:
            raise InputError(
                f"The {place.name} is to stand at ({place.x:g}, {place.y:g}) m, outside the site of {site.extent:g} m; "
                "move it, or make the site larger."
            )
    ground = terrain(site.earthworks, site.half, site.cell, site.pads, site.seed)
    bodies: list[Body] = []
    labels: list[int] = []
    instances: list[int] = []
    objects = []
    for number, place in enumerate(site.placements, 1):
        base = np.array([place.x, place.y, ground_height(ground, place.x, place.y)])
        parts = [body.moved(models.turn_z(np.deg2rad(place.yaw)), base) for body in place.model()]
        objects.append(describe(number, place.task_class, parts))
        bodies += parts
        labels += [int(place.task_class)] * len(parts)
        instances += [number] * len(parts)
    cover = vegetation(site, ground) if site.plants is None else planted(site.plants, ground)
    bodies += cover
    labels += [int(TaskClass.REMOVABLE_COVER)] * len(cover)
    instances += [0] * len(cover)
    return Contents(ground, bodies, labels, instances, tuple(objects))


@lru_cache(maxsize=3)
def terrain(earthworks: Earthworks | Worksite, half: float, cell: float, pads: tuple[Pad, ...], seed: int) -> Ground:
    """The ground of a site."""
    return earthworks.ground(half, cell, pads, seed)


def ground_height(ground: Ground, x: float, y: float) -> float:
    """Height of the nearest vertex, or of the plane outside the modelled terrain [m]."""
    col, row = int(round((x - ground.west) / ground.cell)), int(round((y - ground.south) / ground.cell))
    if 0 <= row < ground.height.shape[0] and 0 <= col < ground.height.shape[1]:
        return float(ground.height[row, col])
    return float(ground.plane @ [x, y, 1])


def planted(plants: tuple[Plant, ...], ground: Ground) -> list[Body]:
    """Bodies of plants that stand where they are told to."""
    bodies: list[Body] = []
    for plant in plants:
        base = np.array([plant.x, plant.y, ground_height(ground, plant.x, plant.y)])
        grown = plant.model(np.random.default_rng(plant.seed), plant.height)
        bodies += [body.moved(np.eye(3), base) for body in grown]
    return bodies


def vegetation(site: DigSite, ground: Ground) -> list[Body]:
    """Trees at the edge, bushes and tufts on the meadow, kept off the work area, the track and the objects."""
    rng = np.random.default_rng(site.seed)
    edge = site.extent / 2
    kinds = (
        (models.tree, 3, (3.6, 4.8), 0.62, 0.9, 2.2),
        (models.tree, 9, (4.0, 6.0), 1.4, 2.2, 2.5),
        (models.bush, 14, (0.8, 1.6), 0.6, 1.3, 1.2),
        (models.tuft, 110, (0.3, 0.65), 0.5, 1.25, 0.5),
    )
    bodies: list[Body] = []
    taken: list[tuple[float, float, float]] = [(p.x, p.y, p.pad + 0.6) for p in site.placements]
    for model, count, (low, high), inner, outer, room in kinds:
        wanted = round(count * site.vegetation)
        for _ in range(40 * wanted):
            if wanted == 0:
                break
            x, y = rng.uniform(-outer * edge, outer * edge, 2)
            height = rng.uniform(low, high)
            if max(abs(x), abs(y)) < inner * edge or diggable(ground, x, y, room):
                continue
            if any(np.hypot(x - a, y - b) < r + 0.5 * room for a, b, r in taken):
                continue
            base = np.array([x, y, ground_height(ground, x, y)])
            bodies += [body.moved(np.eye(3), base) for body in model(rng, height)]
            taken.append((x, y, 0.5 * room))
            wanted -= 1
    return bodies


def diggable(ground: Ground, x: float, y: float, room: float) -> bool:
    """Whether soil, dug soil or gravel lies within about ``room`` of the place [m]."""
    col, row = int(round((x - ground.west) / ground.cell)), int(round((y - ground.south) / ground.cell))
    if not (0 <= row < ground.height.shape[0] and 0 <= col < ground.height.shape[1]):
        return False
    return bool((ground.materials[row, col] > -room).any())


def describe(object_id: int, task_class: TaskClass, parts: list[Body]) -> MapObject:
    """The exact box of an object: the smallest upright box about its bodies.

    The direction is that of an edge of the hull of points on the bodies; the extents are exact for that direction.
    """
    from scipy.spatial import ConvexHull

    points = np.concatenate([body.outline(96) for body in parts])
    hull = points[ConvexHull(points[:, :2]).vertices, :2]
    edges = np.roll(hull, -1, axis=0) - hull
    best, angle = np.inf, 0.0
    for candidate in np.arctan2(edges[:, 1], edges[:, 0]):
        turned = hull @ models.turn_z(-candidate)[:2, :2].T
        area = float(np.prod(np.ptp(turned, axis=0)))
        if area < best:
            best, angle = area, float(candidate)
    turn = models.turn_z(angle)
    directions = np.concatenate([turn.T, -turn.T])
    reach = np.max([body.farthest(directions) for body in parts], axis=0)
    high, low = reach[:3], -reach[3:]
    middle, size = turn[:2, :2] @ ((low + high) / 2)[:2], (high - low)[:2]
    if size[1] > size[0]:
        angle, size = angle + np.pi / 2, size[::-1]
    z_base, z_top = float(low[2]), float(high[2])
    corners = 0.5 * size * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    return MapObject(
        object_id=object_id,
        task_class=task_class,
        centre=(float(middle[0]), float(middle[1]), (z_base + z_top) / 2),
        size=(float(size[0]), float(size[1]), z_top - z_base),
        yaw=float((np.rad2deg(angle) + 90) % 180 - 90),
        z_base=z_base,
        z_top=z_top,
        confidence=1.0,
        footprint=middle + corners @ models.turn_z(angle)[:2, :2].T,
    )
