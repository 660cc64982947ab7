"""Voxels, supports and labels built by hand, so that one stage can be tested without those before it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from excavatwin.geometry.local_geometry import CovarianceFeatures
from excavatwin.geometry.terrain import TerrainEnvelope, reference_grid
from excavatwin.geometry.voxelize import Voxelize
from excavatwin.scene.labels import Labels
from excavatwin.scene.points import Points
from excavatwin.scene.support import LocalGeometry, Terrain
from excavatwin.scene.taxonomy import K
from excavatwin.scene.voxels import Voxels

Surface = Callable[[np.ndarray, np.ndarray], np.ndarray]


def voxels_at(centre: np.ndarray, size: float, S: int = 1, evidence: np.ndarray | None = None) -> Voxels:
    """One voxel at every centre (J, 3), seen by S views that agree on where it is; ``evidence`` is (S J, K)."""
    J = len(centre)
    voxel = np.tile(np.arange(J, dtype=np.int32), S)
    centre = np.asarray(centre, np.float32)
    return Voxels(
        size=size, centre=centre, of_point=voxel, voxel=voxel, view=np.repeat(np.arange(S, dtype=np.int32), J),
        xyz=centre[voxel], confidence=np.ones(S * J, np.float32),
        evidence=np.zeros((S * J, K), np.float32) if evidence is None else np.asarray(evidence, np.float32),
        rgb=np.full((J, 3), 128, np.float32), footprint=np.full(J, size / 2, np.float32),
        centres=np.array([*np.median(centre[:, :2], axis=0), centre[:, 2].max()], float)
        + np.stack([np.array([s - S / 2, -3.0, 20.0]) for s in range(S)]),
        neighbours=np.zeros((J, 0), np.int32), distances=np.zeros((J, 0), np.float32),
    )  # fmt: skip


def flat_local(J: int, inlier: np.ndarray | None = None) -> LocalGeometry:
    """Local geometry of a level, smooth plane."""
    zero = np.zeros(J, np.float32)
    up = np.tile(np.array([0, 0, 1], np.float32), (J, 1))
    return LocalGeometry(up, zero, zero, zero, zero, zero, np.ones(J, bool) if inlier is None else inlier)


def terrain_below(voxels: Voxels, member: np.ndarray, ground: float = 0.0) -> Terrain:
    """Level terrain at height ``ground`` with the given members."""
    grid, _ = reference_grid(voxels)
    level = np.full(grid.shape, ground, np.float32)
    height = (voxels.centre[:, 2] - ground).astype(np.float32)
    return Terrain(grid, level, np.ones(grid.shape, np.int32), level, member, height)


def labels_of(label: np.ndarray, confidence: float = 0.9) -> Labels:
    """A decision that has been taken."""
    J = len(label)
    q = np.zeros((J, K), np.float32)
    return Labels(
        q, q, q, label.astype(np.uint8), np.full(J, confidence, np.float32), np.where(label > 0, 0, 2).astype(np.uint8)
    )


def surface_points(surface: Surface, size: float, rows: int, cols: int, seen: np.ndarray | None = None) -> np.ndarray:
    """Points (n, 3) on a height over (x, y) as an oblique look would give them: nine a cell, and all the way down
    every vertical step between neighbours. ``seen`` (rows, cols) leaves out cells, row 0 at the lowest y."""
    step = size / 3
    x, y = np.meshgrid((np.arange(3 * cols) + 0.5) * step, (np.arange(3 * rows) + 0.5) * step)
    z = np.asarray(surface(x, y), float) + 0 * x
    top = np.stack([x, y, z], axis=-1)
    if seen is not None:
        top[~np.repeat(np.repeat(seen, 3, 0), 3, 1)] = np.nan
    parts = [top.reshape(-1, 3)]
    for low, high in ((top[1:], top[:-1]), (top[:-1], top[1:]), (top[:, 1:], top[:, :-1]), (top[:, :-1], top[:, 1:])):
        fall = np.nan_to_num(high[..., 2] - low[..., 2])
        foot, rise = low[fall > 1.5 * step], fall[fall > 1.5 * step]
        edge = 0.98 * (high - low)[fall > 1.5 * step][:, :2] / 2  # the wall stands half-way, a hair on the low side
        for share in np.arange(step, rise.max(initial=0), step):
            on = share < rise
            parts.append(np.column_stack([foot[on, :2] + edge[on], foot[on, 2] + share]))
    points = np.concatenate(parts)
    return points[np.isfinite(points).all(axis=1)]


def voxelized(xyz: np.ndarray, size: float, k: int = 12) -> Voxels:
    """Points of one view, through the voxel stage."""
    n = len(xyz)
    points = Points(
        xyz=np.asarray(xyz, np.float32), confidence=np.ones(n, np.float32), evidence=np.zeros((n, K), np.float32),
        view=np.zeros(n, np.int32), pixel=np.arange(n), rgb=np.full((n, 3), 128, np.uint8),
        centres=np.array([[0.0, 0.0, 50.0]]), footprint=np.full(n, size / 2, np.float32), shapes=((1, n),),
    )  # fmt: skip
    return Voxelize(size=size, k=k)(points, metric=True)


def terrain_of(
    surface: Surface,
    size: float = 0.25,
    rows: int = 80,
    cols: int = 80,
    seen: np.ndarray | None = None,
    stage: TerrainEnvelope | None = None,
    metric: bool = True,
) -> tuple[Voxels, Terrain]:
    """Terrain envelope of a height over (x, y) in [0, cols size] x [0, rows size]."""
    voxels = voxelized(surface_points(surface, size, rows, cols, seen), size)
    return voxels, (stage or TerrainEnvelope())(voxels, CovarianceFeatures()(voxels), metric)
