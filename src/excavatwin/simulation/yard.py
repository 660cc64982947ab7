"""A plan of what is taken on a site, to find room for the next thing."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float64

from excavatwin.simulation.machines import Excavator
from excavatwin.simulation.site import DigSite
from excavatwin.simulation.worksite import Cut, Heap, Worksite

STEP = 0.12
"""Edge of the plan's cells [m]."""
EDGE = 1.0
"""Least distance of everything but plants from the border of the extent [m]."""
REACH = 5.3
"""Radius that the machine's boom sweeps, with a margin [m]."""


@dataclass
class Yard:
    """A raster of the modelled square in which places are taken one after the other."""

    half: float
    """Half edge of the square [m]."""
    axis: Float64[np.ndarray, "n"] = field(init=False)
    x: Float64[np.ndarray, "n n"] = field(init=False)
    y: Float64[np.ndarray, "n n"] = field(init=False)
    free: Bool[np.ndarray, "n n"] = field(init=False)

    def __post_init__(self) -> None:
        count = int(2 * self.half / STEP)
        self.axis = (np.arange(count) - (count - 1) / 2) * STEP
        self.x, self.y = np.meshgrid(self.axis, self.axis)
        self.free = np.ones((count, count), bool)

    def take(self, mask: Bool[np.ndarray, "n n"]) -> None:
        """Nothing more may stand where ``mask`` is true."""
        self.free &= ~mask

    def disc(self, x: float, y: float, radius: float) -> Bool[np.ndarray, "n n"]:
        """Cells within ``radius`` of a place."""
        return (self.x - x) ** 2 + (self.y - y) ** 2 < radius**2

    def sector(self, x: float, y: float, radius: float, first: float, last: float) -> Bool[np.ndarray, "n n"]:
        """Cells within ``radius`` of a place, in the directions from ``first`` counter-clockwise to ``last`` [deg]."""
        turn = np.rad2deg(np.arctan2(self.y - y, self.x - x))
        return self.disc(x, y, radius) & ((turn - first) % 360 <= (last - first) % 360)

    def room(self, allowed: Bool[np.ndarray, "n n"] | None = None) -> Float64[np.ndarray, "n n"]:
        """Distance of each cell to the nearest one that is taken or not allowed [m]."""
        from scipy.ndimage import distance_transform_edt

        free = self.free if allowed is None else self.free & allowed
        return np.asarray(distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1] * STEP)

    def fits(self, thing: Cut | Heap, around: float, good: Bool[np.ndarray, "n n"]) -> bool:
        """Whether a cut or heap, and what lies within ``around`` of it, is all on good cells."""
        for stride in (6, 1):  # most misfits show on few cells
            part = (slice(None, None, stride),) * 2
            if ((thing.inside(self.x[part], self.y[part]) > -around) & ~good[part]).any():
                return False
        return True

    def scatter(
        self, rng: np.random.Generator, count: int, radius: float, allowed: Bool[np.ndarray, "n n"]
    ) -> list[tuple[float, float]]:
        """Up to ``count`` random places in ``allowed`` with ``radius`` of free room each, and take them."""
        fit = allowed & (self.room() > radius)
        places = []
        for _ in range(count):
            cells = np.flatnonzero(fit)
            if len(cells) == 0:
                break
            row, col = np.unravel_index(cells[int(rng.integers(len(cells)))], fit.shape)
            x, y = float(self.axis[col]), float(self.axis[row])
            fit &= ~self.disc(x, y, 2 * radius)
            self.take(self.disc(x, y, radius))
            places.append((x, y))
        return places

    def find(
        self,
        rng: np.random.Generator,
        radius: float,
        wish: Float64[np.ndarray, "n n"] | None = None,
        allowed: Bool[np.ndarray, "n n"] | None = None,
    ) -> tuple[float, float] | None:
        """A random place with ``radius`` of free room, and take it; None when there is none.

        Args:
            wish: how much a cell is wanted; the choice is among those wanted most.
            allowed: cells where the thing, up to its radius, may lie.
        """
        rows, cols = np.nonzero(self.room(allowed) > radius + STEP)
        if len(rows) == 0:
            return None
        if wish is not None:
            wanted = wish[rows, cols]
            best = wanted >= np.quantile(wanted, max(0.0, 1 - max(0.04, 60 / len(rows))))
            rows, cols = rows[best], cols[best]
        pick = int(rng.integers(len(rows)))
        x, y = (float(self.axis[k[pick]]) for k in (cols, rows))
        self.take(self.disc(x, y, radius))
        return x, y


def occupied(site: DigSite, skip_cut: bool = False, skip_heap: bool = False, ample: bool = False) -> Yard:
    """The plan of a finished site: border, objects, plants, cuts and heaps are taken.

    Args:
        skip_cut: leave out the first cut, which is to grow.
        skip_heap: leave out the first heap.
        ample: keep clear also of where these two may grow to, and of the sweep of the machine's boom between them.
    """
    works = site.earthworks
    assert isinstance(works, Worksite)
    yard = Yard(site.half)
    yard.take(np.maximum(np.abs(yard.x), np.abs(yard.y)) > site.extent / 2 - EDGE)
    for place in site.placements:
        yard.take(yard.disc(place.x, place.y, place.pad + 0.1))
    for plant in site.plants or ():
        yard.take(yard.disc(plant.x, plant.y, 0.45 * plant.height))
    for number, cut in enumerate(works.cuts):
        if not (skip_cut and number == 0):
            yard.take(cut.inside(yard.x, yard.y) > (-1.6 if ample and number == 0 else -0.25))
    for number, heap in enumerate(works.heaps):
        if not (skip_heap and number == 0):
            yard.take(heap.inside(yard.x, yard.y) > (-0.4 * heap.reach - 0.2 if ample and number == 0 else -0.25))
    if ample:
        yard.take(sweep(site, yard))
    return yard


def sweep(site: DigSite, yard: Yard) -> Bool[np.ndarray, "n n"]:
    """Cells that the boom passes over between the first cut and the first heap, the shorter way round."""
    works = site.earthworks
    assert isinstance(works, Worksite)
    machine = next(p for p in site.placements if isinstance(p.model, Excavator))
    first, last = (
        float(np.rad2deg(np.arctan2(thing.at[1] - machine.y, thing.at[0] - machine.x)))
        for thing in (works.cuts[0], works.heaps[0])
    )
    if (last - first) % 360 > 180:
        first, last = last, first
    return yard.sector(machine.x, machine.y, REACH, first - 20, last + 20)
