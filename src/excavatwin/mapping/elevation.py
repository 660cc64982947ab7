"""Terrain elevation of every cell and its standard deviation (eq:semantic_elevation)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32

from excavatwin.mapping.raster import Cells
from excavatwin.paper import equation
from excavatwin.scene.labels import Labels
from excavatwin.scene.support import Terrain
from excavatwin.scene.taxonomy import TERRAIN_CLASSES
from excavatwin.scene.voxels import Voxels


@dataclass(frozen=True)
class Elevation:
    """Median height of the terrain points of a cell, and how sure it is (docs/decisions/elevation-std.md)."""

    prior: float = 0.1
    """Spread that one more, unseen point is taken to have, so that few points never look exact [voxels]."""
    independent: float = 0.15
    """Share of a cell's points that count as independent: neighbouring pixels and photos share their matches."""
    floor: float = 0.03
    """Error common to all points of a cell (poses, calibration), which no number of points removes [voxels]."""

    def __call__(
        self, cells: Cells, voxels: Voxels, labels: Labels, terrain: Terrain, weight: Float32[np.ndarray, "M"]
    ) -> tuple[Float32[np.ndarray, "Y X"], Float32[np.ndarray, "Y X"]]:
        """(H_c, standard deviation of H_c), NaN where a cell has no terrain support [m]."""
        from excavatwin.kernels.cells import cell_spread, group_rows

        n_cells = cells.grid.rows * cells.grid.cols
        is_terrain = terrain_points(labels, terrain)[voxels.voxel]
        cell = np.where(is_terrain, cells.of_sample, -1).astype(np.int32)
        h = voxels.xyz[:, 2]
        H = terrain_elevation(h, cell, n_cells)
        start, member = group_rows(cell, n_cells)
        spread, effective = cell_spread(h, weight, H, start, member)
        prior = self.prior * voxels.size
        with np.errstate(invalid="ignore", divide="ignore"):
            variance = (effective * spread**2 + prior**2) / (effective + 1)
            # The median of n normal samples has variance pi/2 sigma^2 / n (asymptotically).
            independent = np.maximum(self.independent * effective, np.minimum(effective, 1.0))
            sigma = np.sqrt(np.pi / 2 * variance / independent + (self.floor * voxels.size) ** 2)
        return H.reshape(cells.grid.shape), sigma.astype(np.float32).reshape(cells.grid.shape)


def terrain_points(labels: Labels, terrain: Terrain) -> Bool[np.ndarray, "J"]:
    """T: voxels classified as construction or other terrain that satisfy the geometric terrain support."""
    return np.isin(labels.label, TERRAIN_CLASSES) & terrain.member


@equation("eq:semantic_elevation")
def terrain_elevation(
    h: Float[np.ndarray, "n"], cell: Int32[np.ndarray, "n"], n_cells: int
) -> Float32[np.ndarray, "cells"]:
    """H_c = median of the heights of the terrain points of cell c; NaN where T_c is empty.

    Args:
        h: gravity-aligned heights [m].
        cell: cell of every point; -1 for points outside T.
        n_cells: number of cells.
    """
    from excavatwin.kernels.cells import cell_quantile, group_rows

    start, member = group_rows(cell, n_cells)
    return cell_quantile(h, start, member, 0.5)
