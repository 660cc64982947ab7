"""The terrain envelope: a continuous surface that keeps pits, walls and heaps and leaves out what stands on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Int32

from excavatwin.geometry.envelope import (
    boundary_steps,
    bridge_gaps,
    continuity_regions,
    fill_ground,
    progressive_filter,
)
from excavatwin.scene.grid import Grid
from excavatwin.scene.support import LocalGeometry, Terrain
from excavatwin.scene.voxels import Voxels


@dataclass(frozen=True)
class TerrainEnvelope:
    """Sec. "Terrain Envelope Estimation" (docs/decisions/terrain-envelope.md)."""

    percentile: float = 0.10
    """Height quantile of a cell's view samples that is its reference elevation: low, but never the minimum."""
    window: float = 8.0
    """Widest body that must not be taken for ground [m]; with unknown scale, ``window_share`` of the scene."""
    window_share: float = 0.12
    """The same as a share of the scene's extent, used while the scale is unknown."""
    step: float = 1.0
    """Height that is noise [voxels]."""
    slope: float = 0.9
    """Steepest inclination of terrain that stands up, as a tangent (42 degrees: above any angle of repose)."""
    delta_h: float = 0.6
    """delta_h of eq:gc_continuity, in units of L = one voxel."""
    delta_s: float = 1.0
    """delta_s of eq:gc_continuity (tangent)."""
    gentle: float = 0.4
    """A raised region that meets its surroundings continuously on this share of its boundary is terrain: the crest of
    a heap, or ground between a pit and the edge of the map."""
    island: float = 0.6
    """A terrain region that stands above its surroundings on this share of its boundary is an object."""
    gap: float = 2.0
    """Gaps between observed cells up to twice this wide are bridged [cells]."""
    min_region: float = 3.0
    """Smallest terrain region, as the edge of a square [voxels]; smaller ones are discarded."""

    def __call__(self, voxels: Voxels, local: LocalGeometry, metric: bool) -> Terrain:
        """Terrain and non-terrain support of every voxel."""
        grid, cell = reference_grid(voxels)
        reference = reference_surface(voxels, local, grid, cell, self.percentile)
        extent = np.sqrt(np.isfinite(reference).sum()) * voxels.size
        window = self.window if metric else self.window_share * extent
        bridged = bridge_gaps(reference, self.gap)
        candidate = np.isfinite(bridged) & ~self.raised(bridged, voxels.size, window)
        region = self.regions(bridged, candidate, voxels.size, window) * np.isfinite(reference)
        return self.support(voxels, local, grid, cell, reference, region)

    def raised(self, reference: Float32[np.ndarray, "Y X"], size: float, window: float) -> Bool[np.ndarray, "Y X"]:
        """Cells that stand off the ground and are set off from it by steps, not the crests of heaps."""
        from scipy.ndimage import label

        raised = progressive_filter(reference, size, window, self.step * size, self.slope)
        blobs = label(raised, structure=np.ones((3, 3)))[0].astype(np.int32) - 1
        _, level = boundary_steps(reference, blobs, self.delta_h * size, self.delta_s, size)
        return raised & ~np.append(level >= self.gentle, False)[blobs]

    def regions(
        self, reference: Float32[np.ndarray, "Y X"], candidate: Bool[np.ndarray, "Y X"], size: float, window: float
    ) -> Int32[np.ndarray, "Y X"]:
        """Continuous terrain regions, 1 = largest; small ones and islands above their surroundings discarded."""
        region = continuity_regions(reference, candidate, self.delta_h, size, self.delta_s, size)
        n = int(region.max(initial=-1)) + 1
        if n == 0:
            return np.zeros(region.shape, np.int32)
        cells = np.bincount(region[region >= 0], minlength=n)
        up, _ = boundary_steps(reference, region, self.delta_h * size, self.delta_s, size)
        body = cells <= (2 * window / size) ** 2  # a larger island is a plateau
        keep = (cells >= self.min_region**2) & ~(body & (up >= self.island))
        keep[np.argmax(cells)] = True
        order = np.argsort(-cells, kind="stable")
        number = np.zeros(n + 1, np.int32)  # the last entry serves region -1
        number[order[keep[order]]] = np.arange(1, keep.sum() + 1)
        return number[region]

    def support(
        self,
        voxels: Voxels,
        local: LocalGeometry,
        grid: Grid,
        cell: Int32[np.ndarray, "J"],
        reference: Float32[np.ndarray, "Y X"],
        region: Int32[np.ndarray, "Y X"],
    ) -> Terrain:
        """Voxels that are compatible with the terrain of their cell by height and local slope."""
        from excavatwin.kernels.morphology import windowed_extreme

        terrain = region > 0
        ground = fill_ground(reference, terrain)
        # On a wall a cell holds everything from foot to rim: the rim is the highest terrain among the neighbours.
        rim = windowed_extreme(np.where(terrain, reference, np.nan).astype(np.float32), 1, True).ravel()[cell]
        steepness = np.tan(np.minimum(local.slope, np.arctan(2.0)))
        tolerance = voxels.size * (self.step + steepness / 2)
        z = voxels.centre[:, 2]
        with np.errstate(invalid="ignore"):
            member = local.inlier & terrain.ravel()[cell] & (z <= rim + tolerance)
        height = (z - ground.ravel()[cell]).astype(np.float32)
        return Terrain(grid, reference, region, ground, member, height)


@dataclass(frozen=True)
class PointwiseTerrain(TerrainEnvelope):
    """Identity twin ("w/o Terrain continuity"): height and slope decide alone, no region is ever discarded."""

    def regions(
        self, reference: Float32[np.ndarray, "Y X"], candidate: Bool[np.ndarray, "Y X"], size: float, window: float
    ) -> Int32[np.ndarray, "Y X"]:
        """All candidates as one region."""
        return candidate.astype(np.int32)


def reference_grid(voxels: Voxels) -> tuple[Grid, Int32[np.ndarray, "J"]]:
    """Cells of one voxel's size that cover all voxels, and the cell of every voxel."""
    low = np.floor(voxels.centre[:, :2].min(axis=0).astype(np.float64) / voxels.size)
    high = np.floor(voxels.centre[:, :2].max(axis=0).astype(np.float64) / voxels.size) + 1
    cols, rows = (high - low).astype(int)
    grid = Grid(west=float(low[0] * voxels.size), north=float(high[1] * voxels.size), cell=voxels.size,
                rows=int(rows), cols=int(cols))  # fmt: skip
    return grid, np.maximum(grid.flat_index(voxels.centre[:, :2]), 0)


def reference_surface(
    voxels: Voxels, local: LocalGeometry, grid: Grid, cell: Int32[np.ndarray, "J"], percentile: float
) -> Float32[np.ndarray, "Y X"]:
    """H_hat: a low height quantile of the inlying view samples of every cell; NaN where there are none [m]."""
    from excavatwin.kernels.cells import cell_quantile, group_rows

    of_sample = np.where(local.inlier, cell, -1).astype(np.int32)[voxels.voxel]
    start, member = group_rows(of_sample, grid.rows * grid.cols)
    return cell_quantile(voxels.xyz[:, 2], start, member, percentile).reshape(grid.shape)
