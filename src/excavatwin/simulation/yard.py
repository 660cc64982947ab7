"""A plan of what is taken on a site, to find room for the next thing."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float64

STEP = 0.12
"""Edge of the plan's cells [m]."""


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
