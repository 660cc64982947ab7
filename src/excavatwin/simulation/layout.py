"""A site drawn from a seed: ground, work area, excavations, heaps, machines, people, goods and plants."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from excavatwin.errors import InputError
from excavatwin.scene.taxonomy import TaskClass
from excavatwin.simulation import models
from excavatwin.simulation.bodies import Body, Material
from excavatwin.simulation.machines import Dumper, Excavator, Truck
from excavatwin.simulation.people import Block, Person, Pipes
from excavatwin.simulation.posing import aimed
from excavatwin.simulation.site import DigSite, Placement, Plant
from excavatwin.simulation.worksite import Cut, GravelPad, Heap, Track, Worksite
from excavatwin.simulation.yard import EDGE, Yard, sweep

HELMETS = (Material.WHITE_PAINT, Material.YELLOW_PAINT, Material.BLUE_PAINT, Material.RED_PAINT)
TRIES = 60
"""Layouts that are drawn before giving up."""


class NoRoom(Exception):
    """The layout that was drawn does not fit; another one is drawn."""


@dataclass
class Draft:
    """A site in the making."""

    rng: np.random.Generator
    yard: Yard
    works: Worksite
    site: DigSite
    placements: list[Placement] = field(default_factory=list)

    def put(
        self, name: str, model: Callable[[], list[Body]], x: float, y: float, yaw: float, pad: float, category: str
    ) -> None:
        """Set something down."""
        task_class = TaskClass.EXCAVATOR if category == "excavator" else TaskClass.OBSTACLE
        self.placements.append(Placement(name, task_class, model, x, y, yaw, pad, category))


def random_site(seed: int) -> DigSite:
    """A site of 30 m x 30 m of which everything is drawn from ``seed``; equal seeds give equal sites.

    Everything but plants keeps 1 m from the border, stands on levelled ground and touches nothing else.

    Raises:
        InputError: no layout of this seed fits (none is known).
    """
    for attempt in range(TRIES):
        try:
            return _draw(seed, np.random.default_rng((seed, attempt)))
        except NoRoom:
            continue
    raise InputError(f"No site could be laid out from seed {seed} in {TRIES} attempts; use another seed.")


def _draw(seed: int, rng: np.random.Generator) -> DigSite:
    sun = (float(rng.uniform(100, 260)), float(rng.uniform(30, 60)))
    site = DigSite(seed=seed, sun=sun)
    yard = Yard(site.half)
    inside = site.extent / 2 - EDGE
    outside = np.maximum(np.abs(yard.x), np.abs(yard.y)) > inside
    yard.take(outside)
    draft = Draft(rng, yard, _gravel(rng, _area(rng)), site)
    soil = draft.works.soil_depth(yard.x, yard.y)
    gravel = draft.works.gravel_depth(yard.x, yard.y) > -0.3
    _dig(draft, (soil > 0.3) & ~gravel)
    _heaps(draft, (soil > -0.3) & ~gravel)
    _stand(draft, soil, gravel)
    plants = _plants(draft, soil, gravel, outside)
    return DigSite(seed=seed, sun=sun, earthworks=draft.works, placements=tuple(draft.placements), plants=plants)


def _area(rng: np.random.Generator) -> Worksite:
    """Relief and work area."""
    steepness, direction = rng.uniform(0, 0.05), rng.uniform(0, 2 * np.pi)
    return Worksite(
        slope=(float(steepness * np.cos(direction)), float(steepness * np.sin(direction))),
        relief=float(rng.uniform(0.15, 0.5)),
        swell=float(rng.uniform(9, 16)),
        roughness=float(rng.uniform(0.7, 1.3)),
        area_at=(float(rng.uniform(-1, 1)), float(rng.uniform(-1, 1))),
        area_yaw=float(rng.uniform(0, 180)),
        area=(float(rng.uniform(10, 12.5)), float(rng.uniform(9, 11))),
        area_power=float(rng.uniform(2.2, 4.5)),
    )


def _gravel(rng: np.random.Generator, works: Worksite) -> Worksite:
    """Draw a track along the side of the work area, or a pad in it."""
    if rng.random() < 0.6:
        offset = float(rng.uniform(7.5, 9.5) * rng.choice((-1, 1)))
        yaw = float(90 * rng.integers(4) + rng.uniform(-8, 8))  # it leaves the modelled square at about a right angle
        return replace(works, track=Track(offset, yaw, float(rng.uniform(3.0, 3.8)), 1.2, float(rng.uniform(0, 6))))
    angle, away = rng.uniform(0, 2 * np.pi), rng.uniform(8, 9.5)
    at = (float(away * np.cos(angle)), float(away * np.sin(angle)))
    pad = GravelPad(at, float(rng.uniform(-180, 180)), (float(rng.uniform(6, 8)), float(rng.uniform(4.5, 6))))
    return replace(works, gravel_pads=(pad,))


def _pit(rng: np.random.Generator, at: tuple[float, float]) -> Cut:
    depth, wall = rng.uniform(0.9, 2.0), rng.uniform(45, 85)
    slack = 2 * depth / np.tan(np.deg2rad(wall))  # what sloping walls take of the floor
    size = (float(max(rng.uniform(4.5, 6.5), slack + 1.5)), float(max(rng.uniform(3.2, 4.6), slack + 1.0)))
    return Cut(at, float(rng.uniform(-180, 180)), size, float(depth), float(wall), 0.6)


def _trench(rng: np.random.Generator, at: tuple[float, float]) -> Cut:
    depth, wall = rng.uniform(0.6, 1.3), rng.uniform(60, 85)
    slack = 2 * depth / np.tan(np.deg2rad(wall))
    size = (float(rng.uniform(5, 8)), float(max(rng.uniform(0.9, 1.5), slack + 0.4)))
    return Cut(at, float(rng.uniform(-180, 180)), size, float(depth), float(wall), 0.25)


def _dig(draft: Draft, allowed: np.ndarray) -> None:
    """Draw the excavations and put the machine beside the first."""
    rng, yard = draft.rng, draft.yard
    kinds = [(_pit,), (_trench,), (_pit, _trench)][int(rng.choice(3, p=[0.4, 0.25, 0.35]))]
    for number, kind in enumerate(kinds):
        good = allowed & yard.free
        spread, growth = (2.0, 2.8) if number == 0 else (7.0, 0.0)
        for _ in range(200):
            at = np.array(draft.works.area_at) + rng.uniform(-spread, spread, 2)
            cut = kind(rng, (float(at[0]), float(at[1])))
            longer = replace(cut, size=(cut.size[0] + growth, cut.size[1]))  # as it may become, at either end
            if not yard.fits(longer, 0.6, good):
                continue
            if number == 0:
                spot = _beside(rng, cut)
                stand = yard.disc(*spot[:2], 2.0)
                if (stand & (~good | (cut.inside(yard.x, yard.y) > -0.3))).any():
                    continue
                draft.put("excavator", Excavator(), *spot, 1.6, "excavator")
                yard.take(stand)
            yard.take(longer.inside(yard.x, yard.y) > -0.6)
            draft.works = replace(draft.works, cuts=(*draft.works.cuts, cut))
            break
        else:
            raise NoRoom


def _beside(rng: np.random.Generator, cut: Cut) -> tuple[float, float, float]:
    """Where the machine stands: behind the end of a trench, at any side of a pit, facing it: x, y, yaw."""
    pit = cut.size[1] > 2.2
    side = int(rng.integers(4)) if pit else int(rng.integers(2)) * 2
    length, width = cut.size if side % 2 == 0 else cut.size[::-1]
    shift = float(rng.uniform(-0.25, 0.25) * width) if pit else 0.0
    away = np.deg2rad(cut.yaw + 90 * side)
    out, across = np.array([np.cos(away), np.sin(away)]), np.array([-np.sin(away), np.cos(away)])
    x, y = np.array(cut.at) + (length / 2 + float(rng.uniform(2.3, 2.7))) * out + shift * across
    return float(x), float(y), float((np.rad2deg(away) + 180 + rng.uniform(-12, 12)) % 360)


def _heaps(draft: Draft, allowed: np.ndarray) -> None:
    """Tip the first heap within the machine's swing, sometimes another elsewhere; aim the boom."""
    rng, yard = draft.rng, draft.yard
    machine, cut = draft.placements[0], draft.works.cuts[0]
    soil = 1.25 * sum(_soil_in(c) for c in draft.works.cuts)  # loose, as if all of it had stayed here
    to_cut = np.rad2deg(np.arctan2(cut.at[1] - machine.y, cut.at[0] - machine.x))
    good = allowed & yard.free
    for _ in range(200):
        heap = _heap(rng, 0.7 * soil)
        away = 2.1 + 1.35 * heap.reach + rng.uniform(0.0, 0.6)
        a = np.deg2rad(to_cut + rng.choice((-1, 1)) * rng.uniform(65, 140))
        at = (machine.x + away * float(np.cos(a)), machine.y + away * float(np.sin(a)))
        heap = replace(heap, at=at, yaw=float(np.rad2deg(a) + 90 + rng.uniform(-25, 25)))
        if yard.fits(heap, 0.35 * heap.reach + 0.2, good):
            break
    else:
        raise NoRoom
    yard.take(heap.inside(yard.x, yard.y) > -0.35 * heap.reach - 0.2)
    works = replace(draft.works, heaps=(heap,))
    yard.take(sweep(replace(draft.site, earthworks=works, placements=tuple(draft.placements)), yard))
    heaps = [heap]
    if rng.random() < 0.4:
        other = _heap(rng, 0.3 * soil)
        spot = yard.find(rng, 1.2 * other.reach + other.ridge / 2, allowed=allowed)
        if spot is not None:
            heaps.append(replace(other, at=spot, yaw=float(rng.uniform(0, 180))))
    draft.works = replace(draft.works, heaps=tuple(heaps))
    state = replace(draft.site, earthworks=draft.works, placements=tuple(draft.placements))
    pose = aimed(state, machine, cut.at, float(rng.uniform(3.0, 4.0)), float(rng.uniform(-8, 8)), tipping=False)
    draft.placements[0] = replace(machine, model=pose)


def _heap(rng: np.random.Generator, most: float) -> Heap:
    """A heap somewhere, of at most about ``most`` cubic metres, but not below 0.7 m."""
    ridge, height, repose = rng.uniform((0.0, 0.9, 31.0), (2.2, 1.7, 38.0)).tolist()
    reach = 1 / np.tan(np.deg2rad(repose))
    while height > 0.7 and reach * height**2 * (np.pi / 3 * reach * height + ridge) > most:
        height -= 0.02
    return Heap((0.0, 0.0), 0.0, ridge, height, repose)


def _soil_in(cut: Cut) -> float:
    """About the volume of a cut: its section halfway down times its depth [m3]."""
    lost = cut.depth / np.tan(np.deg2rad(cut.wall))
    return float(cut.depth * max(cut.size[0] - lost, 0) * max(cut.size[1] - lost, 0))


def _stand(draft: Draft, soil: np.ndarray, gravel: np.ndarray) -> None:
    """Truck, people, goods and cones."""
    rng, yard, works = draft.rng, draft.yard, draft.works
    ground = (soil > -0.5) | gravel
    heap = works.heaps[0]
    to_heap = np.hypot(yard.x - heap.at[0], yard.y - heap.at[1])
    edge = -np.max([c.inside(yard.x, yard.y) for c in works.cuts], axis=0)
    paints = (Material.WHITE_PAINT, Material.BLUE_PAINT, Material.GREEN_PAINT, Material.RED_PAINT)
    load = float(rng.choice((0.0, 0.5, 0.9)))
    vehicle: Truck | Dumper
    if rng.random() < 0.6:
        size = (float(rng.uniform(5.0, 6.0)), float(rng.uniform(1.9, 2.2)), float(rng.uniform(2.2, 2.5)))
        vehicle = Truck(*size, load, paints[int(rng.integers(len(paints)))])
    else:
        vehicle = Dumper(float(rng.uniform(3.8, 4.4)), float(rng.uniform(1.75, 1.95)), 2.65, load)
    radius = float(np.hypot(vehicle.length, vehicle.width)) / 2
    name = "truck" if isinstance(vehicle, Truck) else "dumper"
    _place(draft, name, vehicle, radius, "truck", 2.0 * gravel - 0.15 * to_heap, ground)
    for _ in range(int(rng.integers(1, 4))):
        helmet = HELMETS[int(rng.integers(len(HELMETS)))]
        vest = Material.HI_VIS if rng.random() < 0.6 else Material.ORANGE_PLASTIC
        stature, stride, arm = rng.uniform((1.65, 0.0, 0.0), (1.88, 0.2, 0.8)).tolist()
        person = Person(stature, stride, arm, helmet, vest)
        far = rng.uniform(0.8, 6.0)
        _place(draft, "person", person, 0.5, "person", -np.abs(edge - far), ground)
    pipes = Pipes(int(rng.integers(2, 5)), float(rng.choice((0.4, 0.6, 0.9))), float(rng.choice((2.0, 2.4, 3.0))))
    radius = float(np.hypot(pipes.length, pipes.count * pipes.diameter)) / 2
    _place(draft, "pipes", pipes, radius, "material", None, ground)
    for _ in range(int(rng.integers(1, 4))):
        block = Block(*(float(np.round(rng.uniform(*r), 1)) for r in ((1.0, 1.9), (0.6, 1.0), (0.5, 1.0))))
        _place(draft, "block", block, float(np.hypot(block.length, block.width)) / 2, "material", None, ground)
    if rng.random() < 0.4:
        _place(draft, "skip", models.skip, 1.85, "material", None, ground)
    for _ in range(int(rng.integers(2, 6))):
        _place(draft, "cone", models.cone, 0.3, "cone", -np.abs(edge - rng.uniform(0.6, 1.4)), ground)


def _place(
    draft: Draft,
    name: str,
    model: Callable[[], list[Body]],
    radius: float,
    category: str,
    wish: np.ndarray | None,
    ground: np.ndarray,
) -> None:
    """Find room for something and set it down."""
    at = draft.yard.find(draft.rng, radius + 0.15, wish, ground)
    if at is None:
        raise NoRoom
    draft.put(name, model, *at, float(draft.rng.uniform(-180, 180)), radius, category)


def _plants(draft: Draft, soil: np.ndarray, gravel: np.ndarray, outside: np.ndarray) -> tuple[Plant, ...]:
    """Trees at the border and beyond, bushes and tufts on the meadow, a few weeds on bare soil."""
    rng, yard, half = draft.rng, draft.yard, draft.site.extent / 2
    taken = ~yard.free & ~outside
    far = np.maximum(np.abs(yard.x), np.abs(yard.y))
    much = rng.uniform(0.6, 1.3)
    kinds = (
        (models.tree, 3, (3.0, 4.8), (0.75 * half, 0.97 * half), 1.7),
        (models.tree, 9, (4.0, 6.0), (1.12 * half, half + 5.5), 2.0),
        (models.bush, 14, (0.8, 1.6), (0.55 * half, 1.3 * half), 1.0),
        (models.tuft, 130, (0.3, 0.65), (0.3 * half, 1.3 * half), 0.35),
    )
    yard.free = ~taken & (far < half + 6.5)
    plants: list[Plant] = []
    for model, count, (low, high), (inner, outer), room in kinds:
        band = (far > inner) & (far < outer) & ~gravel & (soil < (0.6 if model is models.tuft else -room))
        for x, y in yard.scatter(rng, round(count * much), room, band):
            plants.append(Plant(model, x, y, float(rng.uniform(low, high)), int(rng.integers(2**31))))
    return tuple(plants)
