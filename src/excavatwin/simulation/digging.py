"""A dig in progress: epochs in which the excavation grows, the heap takes the soil, machine and people move."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from excavatwin.errors import InputError, require
from excavatwin.simulation.machines import Excavator
from excavatwin.simulation.people import Person
from excavatwin.simulation.posing import aimed
from excavatwin.simulation.site import DigSite, Placement
from excavatwin.simulation.terrain import Pad
from excavatwin.simulation.worksite import Cut, Heap, Worksite
from excavatwin.simulation.yard import occupied

FINE = 0.05
"""Spacing of the raster on which volumes are balanced [m]."""


@dataclass(frozen=True)
class Digging:
    """How much is dug from the first epoch to the last, where there is room for it."""

    bulking: float = 1.25
    """Volume of loose soil over that of the soil in the ground."""
    deeper: float = 0.7
    """Growth of the excavation's depth [m]."""
    longer: float = 1.4
    """Growth of its length, away from the machine [m]."""

    def __post_init__(self) -> None:
        require(self, "bulking", 1.0, 2.0)
        require(self, "deeper", 0.0)
        require(self, "longer", 0.0)


def digging_series(site: DigSite, epochs: int, digging: Digging = Digging()) -> tuple[DigSite, ...]:
    """Epochs of a dig on ``site``, the first of which has its excavation and heap as they are.

    In each epoch the first cut of the site is deeper and longer, its first heap has grown by ``bulking`` times the
    volume that was taken, the machine swings between the two, and people stand elsewhere. Nothing else changes:
    places where anybody ever stands are levelled in all epochs.

    Raises:
        InputError: fewer than two epochs; no ``Worksite`` with a cut, a heap and an articulated excavator; plants that
            would move with the cut; no room to dig or to tip.
    """
    _check(site, epochs)
    works = site.earthworks
    assert isinstance(works, Worksite)
    rng = np.random.default_rng((site.seed, 31))
    share = np.concatenate([[0.0], np.cumsum(rng.uniform(0.7, 1.3, epochs - 1))])
    share /= share[-1]
    where = _people(site, epochs, rng)
    pads = tuple(Pad(p.x, p.y, p.pad) for people in where for p in people)
    works = replace(works, levelled=(*works.levelled, *pads))
    base = replace(site, earthworks=works)
    balance = _Balance(base, digging)
    most = balance.most()
    states = []
    for number, part in enumerate(share):
        state = replace(base, earthworks=balance.works(most * part), placements=_cast(site, where[number]))
        states.append(_swung(state, number, rng))
    return tuple(states)


def _check(site: DigSite, epochs: int) -> None:
    """Refuse what cannot be dug."""
    if epochs < 2:
        raise InputError(f"A digging series has {epochs} epochs; it takes at least 2.")
    works = site.earthworks
    machines = [p for p in site.placements if isinstance(p.model, Excavator)]
    if not isinstance(works, Worksite) or not works.cuts or not works.heaps or not machines:
        raise InputError(
            "The site has no Worksite with a cut and a heap and no articulated Excavator beside it; "
            "start from random_site(seed)."
        )
    if site.plants is None and site.vegetation > 0:
        raise InputError("The plants of the site are drawn from its seed and would move; give them in DigSite.plants.")


class _Balance:
    """The earthworks when a share of the digging is done, with the soil of the cut on the heap."""

    def __init__(self, site: DigSite, digging: Digging) -> None:
        assert isinstance(site.earthworks, Worksite)
        self.site, self.start, self.digging = site, site.earthworks, digging
        cut, machine = self.start.cuts[0], next(p for p in site.placements if isinstance(p.model, Excavator))
        yaw = np.deg2rad(cut.yaw)
        along = np.array([np.cos(yaw), np.sin(yaw)])
        away = float((np.array(cut.at) - (machine.x, machine.y)) @ along)
        self.forward = along * (1.0 if away >= 0 else -1.0)
        self.soil_window = self._window(cut.at, np.hypot(*cut.size) / 2 + digging.longer + 1)
        self.heap_window = self._window(self.start.heaps[0].at, self.start.heaps[0].ridge / 2 + self._widest() + 1)
        self.wobble = self.start.roughness * self.start.wobble(*self.heap_window, site.seed)

    def _window(self, at: tuple[float, float], reach: float) -> tuple[np.ndarray, np.ndarray]:
        """Axes of a square about a place."""
        span = FINE * np.arange(-int(reach / FINE), int(reach / FINE) + 1)
        return at[0] + span, at[1] + span

    def _widest(self) -> float:
        """Largest reach of the heap that touches nothing [m]."""
        heap, yard = self.start.heaps[0], occupied(self.site, skip_heap=True)
        distance = heap.reach - replace(heap, height=heap.height).inside(yard.x, yard.y)
        return float(distance[~yard.free].min()) - 0.25

    def works(self, share: float) -> Worksite:
        """Earthworks after ``share`` (0..1) of the digging."""
        cut = self._dug(share)
        if share == 0:
            return self.start
        return replace(
            self.start,
            cuts=(cut, *self.start.cuts[1:]),
            heaps=(self._heaped(self.digging.bulking * self.volume(cut)), *self.start.heaps[1:]),
        )

    def _dug(self, share: float) -> Cut:
        """The first cut, deeper and longer."""
        cut = self.start.cuts[0]
        longer = share * self.digging.longer
        at = np.array(cut.at) + 0.5 * longer * self.forward
        return replace(
            cut,
            at=(float(at[0]), float(at[1])),
            size=(cut.size[0] + longer, cut.size[1]),
            depth=cut.depth + share * self.digging.deeper,
            datum=cut.datum or cut.at,
        )

    def volume(self, cut: Cut) -> float:
        """Soil that the first cut, when it is ``cut``, has lost since the start [m3]."""
        taken = [
            works.layers(*self.soil_window, self.site.half, self.site.pads, self.site.seed).taken.sum()
            for works in (replace(self.start, cuts=(cut, *self.start.cuts[1:])), self.start)
        ]
        return float(taken[0] - taken[1]) * FINE**2

    def _tipped(self, heap: Heap) -> float:
        """Volume of all heaps within the window of the first, when that is ``heap`` [m3]."""
        x, y = self.heap_window[0][None, :], self.heap_window[1][:, None]
        added = [h.added(h.inside(x, y, self.wobble), self.wobble) for h in (heap, *self.start.heaps[1:])]
        return float(np.max(added, axis=0).sum()) * FINE**2

    def _heaped(self, volume: float) -> Heap:
        """The first heap after ``volume`` [m3] more has been tipped on it."""
        from scipy.optimize import brentq

        heap = self.start.heaps[0]
        goal = self._tipped(heap) + volume
        most = self._widest() * np.tan(np.deg2rad(heap.repose))
        height = brentq(lambda h: self._tipped(replace(heap, height=float(h))) - goal, heap.height, most, xtol=1e-6)
        return replace(heap, height=float(height))

    def most(self) -> float:
        """The largest share of the digging for which there is room, to dig and to tip."""
        yard = occupied(self.site, skip_cut=True)
        heap = self.start.heaps[0]
        most = self._widest() * np.tan(np.deg2rad(heap.repose))
        room = self._tipped(replace(heap, height=most)) - self._tipped(heap) if most > heap.height else 0.0
        for share in np.arange(20, 0, -1) / 20:
            cut = self._dug(float(share))
            hits = (cut.inside(yard.x, yard.y) > -0.25) & ~yard.free
            if not hits.any() and self.digging.bulking * self.volume(cut) < room:
                return float(share)
        raise InputError("There is no room to dig further or to tip the soil on this site; use another seed.")


def _people(site: DigSite, epochs: int, rng: np.random.Generator) -> list[list[Placement]]:
    """Where each person stands in each epoch; nobody stands where anybody stood before."""
    people = [p for p in site.placements if isinstance(p.model, Person)]
    yard = occupied(site, ample=True)
    works = site.earthworks
    assert isinstance(works, Worksite)
    ground = (works.soil_depth(yard.x, yard.y) > -0.5) | (works.gravel_depth(yard.x, yard.y) > 0)
    epochs_of = [people]
    for _ in range(epochs - 1):
        moved = []
        for person in epochs_of[-1]:
            stride = float(rng.uniform(1.5, 5.0))
            wish: Float64[np.ndarray, "n n"] = -np.abs(np.hypot(yard.x - person.x, yard.y - person.y) - stride)
            at = yard.find(rng, person.pad + 0.15, wish, ground)
            if at is None:
                raise InputError("There is no room for people to move on this site; use fewer epochs or another seed.")
            moved.append(replace(person, x=at[0], y=at[1], yaw=float(rng.uniform(-180, 180))))
        epochs_of.append(moved)
    return epochs_of


def _cast(site: DigSite, people: list[Placement]) -> tuple[Placement, ...]:
    """The placements of a site with its people where they are now, in the same order."""
    here = iter(people)
    return tuple(next(here) if isinstance(p.model, Person) else p for p in site.placements)


def _swung(site: DigSite, number: int, rng: np.random.Generator) -> DigSite:
    """The site with its machine digging in even epochs and tipping in odd ones."""
    works = site.earthworks
    assert isinstance(works, Worksite)
    if number == 0:
        return site
    index = next(k for k, p in enumerate(site.placements) if isinstance(p.model, Excavator))
    machine = site.placements[index]
    target = works.heaps[0].at if number % 2 else works.cuts[0].at
    reach, aside = rng.uniform((2.9, -8), (3.7, 8)).tolist()
    pose = aimed(site, machine, target, reach, aside, tipping=bool(number % 2))
    placements = list(site.placements)
    placements[index] = replace(machine, model=pose)
    return replace(site, placements=tuple(placements))
