"""The shared support: voxels of scene-adaptive size, the view samples on them, and their k-NN topology."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from excavatwin.errors import InputError, require
from excavatwin.scene.points import Points
from excavatwin.scene.voxels import Voxels
from excavatwin.topology import nearest_neighbours

#: Sizes that people like to read, per decade.
_NICE = np.array([1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0])


@dataclass(frozen=True)
class Voxelize:
    """Voxelize "at a scene-adaptive resolution" (docs/decisions/voxel-size.md)."""

    footprints: float = 2.0
    """Edge of a voxel in median pixel footprints of the scene."""
    size: float | None = None
    """Edge of a voxel [m], instead of ``footprints``."""
    k: int = 24
    """Neighbours of the topology."""

    def __post_init__(self) -> None:
        require(self, "footprints", 0.0, open_low=True)
        require(self, "size", 0.0, open_low=True)
        require(self, "k", 3)

    def __call__(self, points: Points, metric: bool) -> Voxels:
        """Voxels in ascending grid order; voxel boundaries lie at multiples of the size.

        Raises:
            InputError: there are too few points, or the voxels are too small for the scene.
        """
        from excavatwin.kernels.voxel_hash import group_by_view, group_keys, group_means, pack

        size = (
            self.size
            if self.size is not None
            else nice_size(self.footprints * float(np.median(points.footprint)), metric)
        )
        index = np.floor(points.xyz / np.float32(size)).astype(np.int64)
        index -= index.min(axis=0)
        if index.max() >= 1 << 21:
            raise InputError(f"a voxel size of {size:g} is too small for this scene; give a larger one.")
        of_point, distinct = group_keys(pack(index))
        J = len(distinct)
        if J <= 3:
            raise InputError(f"the observations hold {len(points)} points in {J} voxels; expected thousands.")
        sample, voxel, view = group_by_view(of_point, points.view, J)
        M = len(voxel)
        xyz = group_means(points.xyz, sample, M)
        centre = group_means(xyz, voxel, J)
        finest = np.full(J, np.inf, np.float32)
        np.minimum.at(finest, of_point, points.footprint)
        neighbours, distances = nearest_neighbours(centre, self.k, size)
        return Voxels(
            size=size, centre=centre, of_point=of_point, voxel=voxel, view=view, xyz=xyz,
            confidence=group_means(points.confidence[:, None], sample, M)[:, 0],
            evidence=group_means(points.evidence, sample, M),
            rgb=group_means(group_means(points.rgb, sample, M), voxel, J), footprint=finest, centres=points.centres,
            neighbours=neighbours, distances=distances,
        )  # fmt: skip


def nice_size(size: float, metric: bool) -> float:
    """The largest readable length not above ``size``; arbitrary units stay as they are, so that scaling commutes."""
    if not metric or not np.isfinite(size) or size <= 0:
        return size
    decade = 10.0 ** np.floor(np.log10(size))
    return float(np.round(decade * _NICE[size / decade * (1 + 1e-6) >= _NICE][-1], 9))
