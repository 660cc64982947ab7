"""Which cell each view sample falls into."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int32, Int64

from excavatwin.errors import InputError, require
from excavatwin.scene.grid import Grid
from excavatwin.scene.support import LocalGeometry
from excavatwin.scene.voxels import Voxels


@dataclass(frozen=True)
class Cells:
    """The samples P_c of every cell of the map."""

    grid: Grid
    of_sample: Int32[np.ndarray, "M"]
    """Cell of every view sample; -1 for those that are no part of the map."""
    start: Int64[np.ndarray, "cells1"]
    """First entry of every cell in ``member``."""
    member: Int64[np.ndarray, "m"]
    """View samples ordered by cell."""


@dataclass(frozen=True)
class Raster:
    """The grid of the map, aligned to multiples of its cell so that maps of one place lie on one another."""

    cell: float | None = None
    """Edge of a cell [m]; one voxel when not given."""
    max_extent: float = 2.0
    """Voxels are left out where even the best pixel stretches on level ground over more than this many of them: ground
    seen from afar or flatly would be a dotted fringe around the map."""
    max_cells: int = 60_000_000
    """Largest map that is made."""

    def __post_init__(self) -> None:
        require(self, "cell", 0.0, open_low=True)
        require(self, "max_extent", 0.0, open_low=True)
        require(self, "max_cells", 1)

    def __call__(self, voxels: Voxels, local: LocalGeometry) -> Cells:
        """Grid over all inliers that are seen closely enough, with their cells.

        Raises:
            InputError: nothing is seen closely enough, or the map would be too large.
        """
        from excavatwin.kernels.cells import group_rows

        edge = voxels.size if self.cell is None else self.cell
        mapped = (local.inlier & (ground_extent(voxels) <= self.max_extent * voxels.size))[voxels.voxel]
        if not mapped.any():
            raise InputError("no voxel is seen closely enough to be mapped; raise mapper.raster.max_extent.")
        xy = voxels.xyz[:, :2].astype(np.float64)
        low = np.floor(xy[mapped].min(axis=0) / edge)
        high = np.floor(xy[mapped].max(axis=0) / edge) + 1
        cols, rows = (int(n) for n in high - low)
        if rows * cols > self.max_cells:
            raise InputError(f"a cell of {edge:g} would make a map of {rows} x {cols} cells; give a larger cell.")
        grid = Grid(west=float(low[0] * edge), north=float(high[1] * edge), cell=float(edge), rows=rows, cols=cols)
        of_sample = np.where(mapped, grid.flat_index(xy), -1).astype(np.int32)
        start, member = group_rows(of_sample, rows * cols)
        return Cells(grid, of_sample, start, member)


def ground_extent(voxels: Voxels) -> Float64[np.ndarray, "J"]:
    """What the finest pixel stretches over on level ground: its footprint over the sine of the steepest ray [m]."""
    ray = voxels.centres[voxels.view] - voxels.xyz
    sine = np.abs(ray[:, 2]) / np.maximum(np.linalg.norm(ray, axis=1), 1e-12)
    steepest = np.zeros(len(voxels))
    np.maximum.at(steepest, voxels.voxel, sine)
    return voxels.footprint / np.maximum(steepest, 1e-3)
