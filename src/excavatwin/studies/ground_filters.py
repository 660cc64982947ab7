"""Ground filtering on its own: our terrain stage on plain clouds against CSF, PMF and SMRF.

Each peer runs with its published parameters and with all of a grid, of which the set with the least mean total error
counts as its best: chosen *on the clouds that are scored*, which favours the peers. Ours runs with one set.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from excavatwin.errors import InputError
from excavatwin.geometry.terrain import plain_cloud
from excavatwin.scene.progress import Progress, silent
from excavatwin.studies.clouds import Cloud, isprs_clouds, simulated_clouds
from excavatwin.studies.point_filters import Csf, Envelope, Filter, PdalSmrf
from excavatwin.studies.raster_filters import Pmf, Smrf
from excavatwin.studies.table import Cell, Table, write_tables

COLUMNS = ("filter", "parameters", "type I %", "type II %", "total %", "kappa %")
NOTES = (
    "type I: ground taken for objects; type II: objects taken for ground; means over the clouds (Sithole and Vosselman"
    ", 2004).",
    "best: the set of the grid with the least mean total error on these very clouds, which favours the peers; "
    "ExcavaTwin has one set.",
)


@dataclass(frozen=True)
class GroundErrors:
    """How a filter did on a cloud."""

    type_1: float
    """Share of the ground that was taken for objects [%]."""
    type_2: float
    """Share of the objects that was taken for ground [%]."""
    total: float
    """Share of all points that was mistaken [%]."""
    kappa: float
    """Cohen's kappa: agreement beyond chance [%]."""


def ground_errors(found: Bool[np.ndarray, "N"], ground: Bool[np.ndarray, "N"]) -> GroundErrors:
    """Errors of a filter that found ``found`` where ``ground`` is true; an error that cannot occur is 0."""
    n, hits = len(ground), int((found & ground).sum())
    missed, taken = int((ground & ~found).sum()), int((found & ~ground).sum())
    earth, objects = hits + missed, n - hits - missed
    right = 1 - (missed + taken) / n
    chance = (earth * (hits + taken) + objects * (n - hits - taken)) / n**2
    kappa = (right - chance) / (1 - chance) if chance < 1 else 1.0
    return GroundErrors(
        100 * missed / max(earth, 1), 100 * taken / max(objects, 1), 100 * (missed + taken) / n, 100 * kappa
    )


def mean_errors(errors: Iterable[GroundErrors]) -> GroundErrors:
    """Means over the clouds."""
    rows = np.array([(e.type_1, e.type_2, e.total, e.kappa) for e in errors])
    return GroundErrors(*(float(value) for value in rows.mean(axis=0)))


@dataclass(frozen=True)
class Contest:
    """The filters for one kind of cloud; the first set of every peer is the published one."""

    ours: Filter
    peers: tuple[tuple[Filter, ...], ...]


def airborne() -> Contest:
    """For airborne scans of towns and hills, points 1 to 3 m apart.

    Published sets: PMF as PDAL and PCL bring it (slope 1, dh_0 0.15 m, dh_max 2.5 m, window 33 cells); SMRF's single
    set of Pingel et al. (slope 0.15, window 18 m, 0.5 m, 1.25); CSF's defaults (cloth 0.5 m, threshold 0.5 m).
    """
    pmf = [Pmf(slope=s, initial=i, window=w, highest=h) for s, i, w, h in
           product((0.3, 0.6, 1.0), (0.15, 0.5), (33, 65), (2.5, 5.0))]  # fmt: skip
    csf = [Csf(c, r, t) for c, r, t in product((0.5, 1.0), (1, 2, 3), (0.5,))]
    smrf = [Smrf(slope=s, window=w, threshold=t) for s, w, t in product((0.15, 0.2, 0.3), (18.0,), (0.3, 0.5))]
    return Contest(Envelope(), (published(Pmf(), pmf), published(Csf(), csf), *smrf_peers(Smrf(), smrf)))


def excavation() -> Contest:
    """For dense clouds of dig sites, points about 0.1 m apart, seen by photogrammetry or a scanner; the published
    sets are those of ``airborne``, in metres."""
    pmf = [Pmf(cell=c, slope=s, initial=i, window=w) for c, s, i, w in
           product((0.1, 0.2), (0.3, 0.6, 1.0), (0.05, 0.1, 0.15), (33, 65))]  # fmt: skip
    csf = [Csf(c, r, t) for c, r, t in product((0.2, 0.5), (1, 2, 3), (0.05, 0.1, 0.2))]
    smrf = [Smrf(c, s, 3.0, t, b) for c, s, t, b in
            product((0.15, 0.2), (0.15, 0.3, 0.6), (0.05, 0.1), (0.1, 0.2, 0.4))]  # fmt: skip
    return Contest(
        Envelope(size=0.1, window=12.0), (published(Pmf(), pmf), published(Csf(), csf), *smrf_peers(Smrf(), smrf))
    )


def published(first: Filter, grid: Sequence[Filter]) -> tuple[Filter, ...]:
    """The published set before those of the grid."""
    return first, *(other for other in grid if other != first)


def smrf_peers(first: Smrf, grid: Sequence[Smrf]) -> tuple[tuple[Filter, ...], ...]:
    """Our SMRF, and PDAL's with the same sets where it is installed."""
    sets = published(first, grid)
    if not PdalSmrf.installed():
        return (sets,)
    return sets, tuple(PdalSmrf(s.cell, s.slope, s.window, s.threshold, s.scaling) for s in (first, *grid))


def parameters(which: Filter, default: Filter) -> str:
    """The fields of a filter that differ from another's."""
    changed = {key: value for key, value in vars(which).items() if value != getattr(default, key)}
    return ", ".join(f"{key} {value:g}" for key, value in changed.items() if isinstance(value, (int, float)))


def contest_tables(
    title: str, clouds: Sequence[Cloud], contest: Contest, progress: Progress = silent
) -> tuple[Table, Table]:
    """Every filter on every cloud: (means, total error cloud by cloud)."""
    steps = len(clouds) * (1 + sum(map(len, contest.peers)))
    done, rows, each = 0, [], []

    def scored(which: Filter) -> list[GroundErrors]:
        nonlocal done
        errors = []
        for cloud in clouds:
            progress(f"{title}: {which.name}", done, steps)
            errors.append(ground_errors(which(cloud.xyz), cloud.ground))
            done += 1
        return errors

    def enter(which: Filter, what: str, errors: list[GroundErrors]) -> None:
        mean = mean_errors(errors)
        rows.append((which.name, what, mean.type_1, mean.type_2, mean.total, mean.kappa))
        totals: tuple[Cell, ...] = tuple(e.total for e in errors)
        each.append((which.name, what, *totals, mean.total))

    enter(contest.ours, "one set", scored(contest.ours))
    for sets in contest.peers:
        errors = [scored(which) for which in sets]
        enter(sets[0], "published", errors[0])
        best = min(range(len(sets)), key=lambda i: mean_errors(errors[i]).total)
        enter(sets[best], f"best of {len(sets)}: {parameters(sets[best], sets[0]) or 'published'}", errors[best])
    progress(title, steps, steps)
    names = ("filter", "parameters", *(cloud.name for cloud in clouds), "mean")
    return Table(title, COLUMNS, tuple(rows), NOTES), Table(f"{title}: total error %", names, tuple(each))


def left_one_out(clouds: Sequence[Cloud], sets: Sequence[Filter]) -> float:
    """Mean total error [%] when every cloud is filtered by the set that is best on all the *others*."""
    if len(clouds) < 2:
        raise InputError(f"Leaving one out takes two clouds or more, not {len(clouds)}.")
    total = np.array([[ground_errors(which(c.xyz), c.ground).total for c in clouds] for which in sets])
    rest = total.sum(axis=1, keepdims=True) - total
    return float(np.mean([total[rest[:, j].argmin(), j] for j in range(len(clouds))]))


def envelope_sets() -> tuple[Envelope, ...]:
    """Neighbours of our airborne set, for ``left_one_out``: what a user might have tuned."""
    sets = []
    for aspect, step, window in product((0.2, 0.3, 0.4), (0.4, 0.5, 0.6), (24.0, 36.0)):
        sets.append(Envelope(window=window, terrain=replace(plain_cloud(window), aspect=aspect, step=step)))
    return tuple(sets)


def compare_filters(
    isprs: Path | None, seeds: Sequence[int], output: Path, progress: Progress = silent
) -> tuple[list[Table], list[Path]]:
    """Run the study and write its tables ``ground_filters.*`` into a folder.

    Args:
        isprs: folder of the ISPRS samples; None = without.
        seeds: of the simulated sites; none = without.

    Raises:
        InputError: nothing to compare on, or no sample in the folder.
        MissingExtraError: CSF is not installed.
        OutputError: the folder cannot be written.
    """
    tables: list[Table] = []
    if isprs is None and not seeds:
        raise InputError("There is nothing to compare on; give the ISPRS samples, simulated sites, or both.")
    if isprs is not None:
        clouds = tuple(isprs_clouds(isprs))
        means, each = contest_tables("ISPRS filter test", clouds, airborne(), progress)
        if len(clouds) > 1:
            progress("ISPRS filter test: leave one out", 0, 1)
            sets = envelope_sets()
            note = f"ExcavaTwin with each sample filtered by the set, of {len(sets)} about ours, that is best on all"
            note += f" the others: mean total error {left_one_out(clouds, sets):.2f} %."
            means = replace(means, notes=(*means.notes, note))
        tables += [means, each]
    if seeds:
        title = f"Simulated dig sites, seeds {seeds[0]} to {seeds[-1]}"
        tables += contest_tables(title, tuple(simulated_clouds(seeds)), excavation(), progress)
    return tables, write_tables(tables, output, "ground_filters")
