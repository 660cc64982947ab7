"""A laser scan of a site from the air, and the elevation reference that is made of its ground returns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int32, UInt8

from excavatwin.errors import require
from excavatwin.kernels.laser import returns
from excavatwin.kernels.ray_shading import GLASS
from excavatwin.scene.grid import Grid
from excavatwin.scene.taxonomy import TaskClass
from excavatwin.simulation.render import geometry
from excavatwin.simulation.site import DigSite, contents

FAR = 120.0
"""Beams longer than this return nothing [m]."""


@dataclass(frozen=True, eq=False)
class Scan:
    """Returns with what they truly met."""

    xyz: Float32[np.ndarray, "n 3"]
    """Frame M, range noise included [m]."""
    label: UInt8[np.ndarray, "n"]
    """Task class."""
    instance: Int32[np.ndarray, "n"]
    """Object id, 0 = none."""


@dataclass(frozen=True)
class Scanner:
    """A scanner under a drone that crosses the site twice, at right angles; beams sweep across the track."""

    height: float = 25.0
    """Above z = 0 [m]."""
    swath: float = 70.0
    """Angle of the sweep [deg]."""
    beam: float = 0.18
    """Between beams of a sweep [deg]."""
    advance: float = 0.10
    """Between sweeps [m]."""
    noise: float = 0.02
    """Standard deviation of a range [m]."""
    lost: float = 0.02
    """Share of beams that return nothing for no reason that can be seen; from glass nine in ten do."""

    def __post_init__(self) -> None:
        require(self, "height", 5, 100)
        require(self, "swath", 0, 160, open_low=True)
        for name in ("beam", "advance"):
            require(self, name, 0, open_low=True)
        require(self, "noise", 0)
        require(self, "lost", 0, 1)

    def __call__(self, site: DigSite, seed: int = 0) -> Scan:
        """Scan the site; what stands in the way leaves gaps behind it."""
        rng = np.random.default_rng((seed, 17))
        origin, direction = self.beams(site.extent, rng)
        ground, bodies = geometry(site)
        t, index, label = returns(ground, bodies, contents(site).ground.label, origin, direction, FAR)
        glass = np.append(bodies.finish == GLASS, False)[np.where(index >= 0, index, -1)]
        kept = np.isfinite(t) & (rng.random(t.size) >= np.where(glass, 0.9, self.lost))
        t = t + self.noise * rng.normal(size=t.size)
        xyz = (origin + np.where(kept, t, 0)[:, None] * direction)[kept]
        instance = np.append(bodies.instance, 0)[np.where(index >= 0, index, -1)][kept]
        inside = (np.abs(xyz[:, :2]) <= site.extent / 2).all(1)
        return Scan(xyz[inside].astype(np.float32), label[kept][inside], instance[inside].astype(np.int32))

    def beams(
        self, extent: float, rng: np.random.Generator
    ) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
        """Origins and unit directions of both passes, the drone's wobble included."""
        along = np.arange(-extent / 2, extent / 2, self.advance)
        angle = np.deg2rad(np.arange(-self.swath / 2, self.swath / 2, self.beam))
        origins, directions = [], []
        for turn in (0.0, np.pi / 2):
            c, s = np.cos(turn), np.sin(turn)
            place = np.stack([np.zeros_like(along), along, np.full_like(along, self.height)], -1)
            place += np.cumsum(rng.normal(0, 0.01, place.shape), axis=0)
            roll = angle[None, :] + np.deg2rad(0.3) * np.sin(np.cumsum(rng.normal(0, 0.2, along.size)))[:, None]
            ray = np.stack([np.sin(roll), np.zeros_like(roll), -np.cos(roll)], -1)
            R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
            origins.append(np.broadcast_to((place @ R.T)[:, None], ray.shape).reshape(-1, 3))
            directions.append((ray @ R.T).reshape(-1, 3))
        return np.concatenate(origins), np.concatenate(directions)


def elevation(scan: Scan, extent: float, cell: float = 0.1) -> tuple[Grid, Float32[np.ndarray, "Y X"]]:
    """Mean of the ground returns of each cell; NaN where there is none (behind and under things) [m]."""
    count = int(round(extent / cell))
    grid = Grid(-extent / 2, extent / 2, cell, count, count)
    index = grid.flat_index(scan.xyz[:, :2].astype(float))
    terrain = (scan.label == TaskClass.CONSTRUCTION_TERRAIN) | (scan.label == TaskClass.OTHER_TERRAIN)
    use = terrain & (index >= 0)
    number = np.bincount(index[use], minlength=count * count)
    total = np.bincount(index[use], weights=scan.xyz[use, 2].astype(float), minlength=count * count)
    height = np.where(number > 0, total / np.maximum(number, 1), np.nan)
    return grid, height.reshape(grid.shape).astype(np.float32)
