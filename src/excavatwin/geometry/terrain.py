"""The terrain envelope: a continuous surface that keeps pits, walls and heaps and leaves out what stands on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32

from excavatwin.errors import require
from excavatwin.geometry.envelope import (
    bridge_gaps,
    continuity_regions,
    fill_ground,
    ground_range,
    progressive_filter,
    raised_rims,
    steep_rims,
)
from excavatwin.scene.grid import Grid
from excavatwin.scene.support import LocalGeometry, Terrain
from excavatwin.scene.voxels import Voxels


@dataclass(frozen=True)
class TerrainEnvelope:
    """Sec. "Terrain Envelope Estimation" (docs/decisions/terrain-envelope.md)."""

    percentile: float = 0.10
    """Height quantile of a cell's view samples that is its reference elevation: low, but never the minimum."""
    window: float = 12.0
    """Widest body that must not be taken for ground [m]; with unknown scale, ``window_share`` of the scene."""
    window_share: float = 0.2
    """The same as a share of the scene's extent, used while the scale is unknown."""
    step: float = 0.4
    """Height that is noise [voxels]."""
    aspect: float = 0.3
    """Lowest height of a body that stands on the ground, over its half-width; flatter ones are part of it."""
    slope: float = 0.8
    """Steepest inclination of terrain that stands up, as a tangent (39 degrees: above the angle of repose of soil)."""
    delta_h: float = 0.6
    """delta_h of eq:gc_continuity, in units of L = one voxel."""
    delta_s: float = 1.0
    """delta_s of eq:gc_continuity (tangent)."""
    smear: int = 3
    """Width over which stereo may smear a sharp step [cells]."""
    body: float = 0.55
    """A lowered patch whose rim drops steeply on at least this share of its length is a body standing on the ground;
    otherwise it is ground: the crest of a heap, a berm, ground between a pit and the edge of the map."""
    island: float = 0.6
    """A region behind steep faces is the top of a body when at least this share of its steps leads down."""
    gap: float = 2.0
    """Gaps between observed cells up to twice this wide are bridged [cells]."""
    rise: float = 0.5
    """A steep face belongs to the terrain from which it can be reached without rising more than this a cell [voxels]:
    the rim of a pit does, the side of a body does not."""
    min_region: float = 3.0
    """Smallest terrain region, as the edge of a square [voxels]; smaller ones are discarded."""

    def __post_init__(self) -> None:
        require(self, "percentile", 0.0, 1.0)
        require(self, "window", 0.0, open_low=True)
        require(self, "window_share", 0.0, 1.0)
        require(self, "smear", 1)

    def __call__(self, voxels: Voxels, local: LocalGeometry, metric: bool) -> Terrain:
        """Terrain and non-terrain support of every voxel."""
        grid, cell = reference_grid(voxels)
        reference = reference_surface(voxels, local, grid, cell, self.percentile)
        extent = np.sqrt(np.isfinite(reference).sum()) * voxels.size
        window = self.window if metric else self.window_share * extent
        bridged = bridge_gaps(reference, self.gap)
        region = self.regions(bridged, ~self.raised(bridged, voxels.size, window), voxels.size, window)
        return self.support(voxels, local, grid, cell, reference, region * np.isfinite(reference))

    def allowed_drop(self, size: float, reach: int) -> float:
        """Height by which terrain that stands up may fall within ``reach`` cells [m]."""
        return size * (self.step + self.slope * reach)

    def faces(self, H: Float32[np.ndarray, "Y X"], size: float) -> Bool[np.ndarray, "Y X"]:
        """Cells at the upper side of a drop that is too steep for terrain that stands up, sharp or smeared; breaks of
        up to four cells in a line of them are sealed."""
        from scipy.ndimage import binary_closing

        from excavatwin.kernels.morphology import disc_drop

        seen = np.isfinite(H)
        steep = np.zeros(H.shape, bool)
        for reach in range(1, self.smear + 1):
            steep |= disc_drop(H, seen, reach) > self.allowed_drop(size, reach)
        sealed = binary_closing(np.pad(steep, 4), np.ones((3, 3)), iterations=2)[4:-4, 4:-4]
        return sealed & seen

    def raised(self, H: Float32[np.ndarray, "Y X"], size: float, window: float) -> Bool[np.ndarray, "Y X"]:
        """Cells of bodies that stand on the ground: what the progressive filter lowers, patch by patch."""
        from scipy.ndimage import label

        lowered = progressive_filter(H, size, window, self.step * size, self.aspect)
        patch = label(lowered, structure=np.ones((3, 3)))[0].astype(np.int32) - 1
        steep = steep_rims(H, patch, self.smear, self.allowed_drop(size, self.smear))
        return np.append(steep >= self.body, False)[patch]

    def regions(
        self, H: Float32[np.ndarray, "Y X"], candidate: Bool[np.ndarray, "Y X"], size: float, window: float
    ) -> Int32[np.ndarray, "Y X"]:
        """Continuous terrain regions, 1 = largest. Steep faces part them; tops of bodies and small ones are discarded;
        the faces then go to the terrain that they do not rise from."""
        from excavatwin.kernels.morphology import grow_without_rising

        candidate = candidate & np.isfinite(H)
        face = self.faces(H, size)
        region = continuity_regions(H, candidate & ~face, self.delta_h, size, self.delta_s, size)
        n = int(region.max(initial=-1)) + 1
        if n == 0:
            return np.zeros(region.shape, np.int32)
        cells = np.bincount(region[region >= 0], minlength=n)
        up = raised_rims(H, region, 3 * self.smear, self.allowed_drop(size, self.smear) / 2)
        compact = cells <= (2 * window / size) ** 2  # a larger region behind faces is a plateau
        keep = (cells >= self.min_region**2) & ~(compact & (up >= self.island))
        keep[np.argmax(cells)] = True
        order = np.argsort(-cells, kind="stable")
        number = np.zeros(n + 1, np.int32)  # the last entry serves region -1
        number[order[keep[order]]] = np.arange(1, keep.sum() + 1)
        return grow_without_rising(H, number[region], candidate & face, self.rise * size)

    def support(
        self,
        voxels: Voxels,
        local: LocalGeometry,
        grid: Grid,
        cell: Int32[np.ndarray, "J"],
        reference: Float32[np.ndarray, "Y X"],
        region: Int32[np.ndarray, "Y X"],
    ) -> Terrain:
        """Voxels that are compatible with the terrain around them by height, in cells that are terrain."""
        ground = fill_ground(reference, region > 0, self.smear - 1)
        noise = max(self.step * voxels.size, disagreement(local, (region > 0).ravel()[cell]))
        member = local.inlier & self.on_ground(grid, ground, voxels.centre, noise)
        height = (voxels.centre[:, 2] - ground.ravel()[cell]).astype(np.float32)
        return Terrain(grid, reference, region, ground, member, height)

    def on_ground(
        self, grid: Grid, ground: Float32[np.ndarray, "Y X"], xyz: Float[np.ndarray, "N 3"], noise: float | None = None
    ) -> Bool[np.ndarray, "N"]:
        """Points that lie, but for noise, between the lowest and the highest ground within one cell (within a smear,
        where that is wider): on a wall that is everything from foot to rim, on a slope as much as it is steep.

        Args:
            noise: height that is noise [m]; ``step`` when not given.
        """
        low, high = ground_range(grid, ground, xyz, max(1, self.smear - 1))
        noise = self.step * grid.cell if noise is None else noise
        return (xyz[:, 2] >= low - noise) & (xyz[:, 2] <= high + noise)


@dataclass(frozen=True)
class PointwiseTerrain(TerrainEnvelope):
    """Identity twin ("w/o Terrain continuity"): height and slope decide alone, no region is ever discarded."""

    def regions(
        self, reference: Float32[np.ndarray, "Y X"], candidate: Bool[np.ndarray, "Y X"], size: float, window: float
    ) -> Int32[np.ndarray, "Y X"]:
        """All candidates as one region."""
        return (candidate & np.isfinite(reference)).astype(np.int32)


def plain_cloud(window: float) -> TerrainEnvelope:
    """The stage for a cloud that is no closed surface, such as an airborne scan, in voxels of about one point spacing.

    The reference is the lowest there is, and all that the filter lowers is a body: sparse points of a canopy or a
    gable have no rim that could be tested, steps between them are sharp, and faces would part ground from ground.

    Args:
        window: width of the widest body [m], such as 12 on a site, 36 in a town.
    """
    return PointwiseTerrain(percentile=0.0, window=window, step=0.5, smear=1, body=0.0, gap=3.0)


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


def disagreement(local: LocalGeometry, on_terrain: Bool[np.ndarray, "J"]) -> float:
    """By how much the views disagree about the ground: the height between the first and the last tenth of a normal
    distribution whose median distance to the tangent plane is that of the terrain's voxels [m].

    Views of a network are each bent a little, and what one puts above the other is ground all the same.
    """
    apart = local.discontinuity[on_terrain & local.inlier]
    return 3.8 * float(np.median(apart)) if len(apart) else 0.0
