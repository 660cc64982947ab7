"""Cut, fill and net volume between two epochs: ours from two maps, the true ones from two truths.

Only cells whose height is known in both epochs are compared. The rest of the region is *skipped*, and its area and
share stand beside every volume: a hole under a machine is no volume of zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float64

from excavatwin.evaluation.alignment import Alignment
from excavatwin.evaluation.frame import bilinear
from excavatwin.evaluation.metric import Metric
from excavatwin.scene.elevation_map import ElevationMap
from excavatwin.scene.grid import Grid

DETECTION = 1.96
"""A change counts as detected beyond so many standard deviations of the difference (95 % of noise stays inside;
Lane et al., Earth Surf. Proc. Land. 2003)."""
ROUNDS = 20
"""Refits of the robust plane of ``levelled``."""


@dataclass(frozen=True)
class Volumes:
    """What happened between two epochs."""

    cut: float
    """Volume of earth that is gone, >= 0 [m3]."""
    fill: float
    """Volume of earth that came, >= 0 [m3]."""
    area: float
    """Where both heights are known [m2]."""
    skipped: float
    """Rest of the region: unknown in at least one epoch, so in no volume [m2]."""

    @property
    def net(self) -> float:
        """Fill minus cut [m3]."""
        return self.fill - self.cut

    @property
    def skipped_share(self) -> float:
        """Part of the region that was skipped, 0..1."""
        whole = self.area + self.skipped
        return self.skipped / whole if whole > 0 else float("nan")


@dataclass(frozen=True, eq=False)
class Survey:
    """A map with its place in the frame of the truth."""

    map: ElevationMap
    alignment: Alignment

    def heights(self, grid: Grid) -> tuple[Float64[np.ndarray, "Y X"], Float64[np.ndarray, "Y X"]]:
        """Elevation and its standard deviation at the cell centres of another grid, in that frame [m]; NaN: unknown."""
        x, y = self.alignment.to_map(*np.meshgrid(grid.x, grid.y))
        z = bilinear(self.map.grid, self.map.elevation, x, y) + self.alignment.shift[2]
        return z, bilinear(self.map.grid, self.map.elevation_std, x, y)


def survey_change(
    before: Survey, after: Survey, grid: Grid
) -> tuple[Float64[np.ndarray, "Y X"], Float64[np.ndarray, "Y X"]]:
    """After minus before on a common grid, and the standard deviation of that as both maps state it [m]."""
    (z0, s0), (z1, s1) = before.heights(grid), after.heights(grid)
    return z1 - z0, np.hypot(s0, s1)


def volumes(
    difference: Float[np.ndarray, "Y X"], cell: float, region: Bool[np.ndarray, "Y X"] | None = None
) -> Volumes:
    """Volumes of a height difference (after minus before) [m], NaN where it is not known.

    Args:
        cell: edge length of a cell [m].
        region: the cells that should have been compared; by default all.
    """
    wanted = np.ones(difference.shape, bool) if region is None else region
    known = wanted & np.isfinite(difference)
    dz, per_cell = difference[known].astype(float), cell**2
    return Volumes(
        cut=float(-dz[dz < 0].sum()) * per_cell + 0.0,
        fill=float(dz[dz > 0].sum()) * per_cell,
        area=int(known.sum()) * per_cell,
        skipped=int((wanted & ~known).sum()) * per_cell,
    )


def levelled(difference: Float[np.ndarray, "Y X"]) -> Float64[np.ndarray, "Y X"]:
    """The difference less its robust plane: two surveys, each with its own vertical shift and tilt, on one level.

    Uses the two maps alone, no truth. Rests on most of the compared ground being unchanged: the plane starts at the
    median and is refitted to the cells within 2.5 robust standard deviations (1.4826 MAD) of it.
    """
    known = np.isfinite(difference)
    row, col = np.nonzero(known)
    dz = difference[known].astype(float)
    if len(dz) < 10:
        return difference.astype(float)
    A = np.stack([col - col.mean(), row - row.mean(), np.ones(len(dz))], axis=-1)
    plane = np.array([0.0, 0.0, np.median(dz)])
    for _ in range(ROUNDS):
        rest = dz - A @ plane
        spread = max(1.4826 * float(np.median(np.abs(rest - np.median(rest)))), 1e-6)
        calm = np.abs(rest - np.median(rest)) < 2.5 * spread
        if calm.sum() < 10:
            break
        plane = np.linalg.lstsq(A[calm], dz[calm], rcond=None)[0]
    level = np.full(difference.shape, np.nan)
    level[known] = dz - A @ plane
    return level


def detected(difference: Float[np.ndarray, "Y X"], sigma: Float[np.ndarray, "Y X"]) -> Float64[np.ndarray, "Y X"]:
    """The difference with changes below ``DETECTION`` standard deviations set to none; unknown stays unknown.

    Noise has no mean but its cut and fill have: without this step every survey finds both everywhere.
    """
    small = np.abs(difference) < DETECTION * np.nan_to_num(sigma.astype(float))
    return np.where(np.isfinite(difference) & small, 0.0, difference.astype(float))


def volume_metrics(
    name: str, ours: Volumes, true: Volumes, true_compared: Volumes, how: str = ""
) -> tuple[Metric, ...]:
    """Our volumes, their errors against the whole truth and against the truth of the compared cells, what is skipped.

    Args:
        true: over the whole region.
        true_compared: over the cells that ours are over; what is missing to ``true`` was skipped, not mismeasured.
        how: said in each meaning, such as "after levelling the two maps".
    """
    said = f"; {how}" if how else ""
    figures = []
    for kind, meaning in (("cut", "earth gone"), ("fill", "earth that came"), ("net", "fill minus cut")):
        found, expected, compared = (float(getattr(v, kind)) for v in (ours, true, true_compared))
        figures += [
            Metric(f"{name}_{kind}", found, "m3", f"{meaning}, true {expected:.1f} m3{said}"),
            Metric(f"{name}_{kind}_error", found - expected, "m3", f"the same minus the true one{said}"),
            Metric(
                f"{name}_{kind}_error_compared", found - compared, "m3", f"the same on the compared cells only{said}"
            ),
        ]
        if kind != "net":
            relative = 100 * abs(found - expected) / expected if expected > 0 else float("nan")
            hidden = 100 * (1 - compared / expected) if expected > 0 else float("nan")
            figures += [
                Metric(f"{name}_{kind}_relative_error", relative, "%", f"its absolute error, of the true one{said}"),
                Metric(f"{name}_{kind}_hidden", hidden, "%", "share of the true one that lies on skipped ground"),
            ]
    share = 100 * ours.skipped_share
    return (
        *figures,
        Metric(f"{name}_area", ours.area, "m2", "ground whose height is known in both epochs"),
        Metric(f"{name}_skipped_area", ours.skipped, "m2", "ground without a height in one epoch, in no volume"),
        Metric(f"{name}_skipped_share", share, "%", "share of the region that is skipped"),
    )
