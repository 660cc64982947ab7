"""What was dug away and what was heaped up between two states of a site, from their exact terrain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64

from excavatwin.errors import InputError
from excavatwin.scene.grid import Grid
from excavatwin.simulation.site import DigSite, terrain
from excavatwin.simulation.terrain import Ground


@dataclass(frozen=True, eq=False)
class Change:
    """Difference of two terrains, without objects and cover."""

    grid: Grid
    difference: Float32[np.ndarray, "Y X"]
    """Height afterwards minus height before, at the cell centres [m]."""
    cut: float
    """Volume of soil that is gone [m3]."""
    fill: float
    """Volume of soil that was laid down [m3]."""

    @property
    def net(self) -> float:
        """Fill minus cut; positive where more was laid down, as loose soil is [m3]."""
        return self.fill - self.cut


def change_truth(before: DigSite, after: DigSite, cell: float = 0.05) -> Change:
    """Cut, fill and their raster between two states of one site.

    Args:
        cell: edge of the raster's cells [m].

    Raises:
        InputError: the two are not the same piece of land.
    """
    for name in ("extent", "margin", "cell"):
        if getattr(before, name) != getattr(after, name):
            raise InputError(
                f"The {name} of the site is {getattr(before, name):g} m before and {getattr(after, name):g} m after; "
                "compare two states of one site, such as epochs of digging_series."
            )
    count = int(round(before.extent / cell))
    grid = Grid(-before.extent / 2, before.extent / 2, cell, count, count)
    now, then = (heights(terrain(s.earthworks, s.half, s.cell, s.pads, s.seed), grid) for s in (after, before))
    difference = now - then
    cut, fill = (float(np.maximum(sign * difference, 0).sum()) * cell**2 for sign in (-1, 1))
    return Change(grid, difference.astype(np.float32), cut, fill)


def heights(ground: Ground, grid: Grid) -> Float64[np.ndarray, "Y X"]:
    """Bilinear terrain height at the cell centres, which must lie on the modelled square [m]."""
    rows, cols = (grid.y - ground.south) / ground.cell, (grid.x - ground.west) / ground.cell
    j = np.clip(np.floor(rows).astype(int), 0, ground.height.shape[0] - 2)
    i = np.clip(np.floor(cols).astype(int), 0, ground.height.shape[1] - 2)
    v, u = (rows - j)[:, None], (cols - i)[None, :]
    z = ground.height.astype(float)
    south = z[np.ix_(j, i)] * (1 - u) + z[np.ix_(j, i + 1)] * u
    north = z[np.ix_(j + 1, i)] * (1 - u) + z[np.ix_(j + 1, i + 1)] * u
    return south * (1 - v) + north * v
