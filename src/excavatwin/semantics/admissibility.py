"""Class-dependent geometric support g_j(k): which classes a place can be (docs/decisions/admissibility.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from excavatwin.errors import require
from excavatwin.scene.support import LocalGeometry, ObjectSupport, Terrain
from excavatwin.scene.taxonomy import K, TaskClass
from excavatwin.scene.voxels import Voxels


@dataclass(frozen=True)
class Admissibility:
    """g_j(k) in [0, 1] from terrain support, object components, roughness, slope and height.

    A class that the geometry speaks against keeps a small ``doubtful`` support, since support itself can be wrong:
    strong, repeated evidence may still overcome it. Only spatial outliers admit nothing.
    """

    doubtful: float = 0.04
    """Support of a class that the geometry speaks against."""
    no_component: float = 1.0
    """Support of object classes off the terrain where no component of theirs stands."""
    in_component: float = 0.15
    """Support of every other class where a component of an object class stands."""
    cover_smooth: float = 0.1
    """Support of removable cover on terrain that is as smooth as most of the scene's: short turf is ground."""
    rough: float = 12.0
    """Roughness at which terrain is fully cover-like, in medians of the roughness of the scene's terrain."""
    steep: float = 1.2
    """Slope above which terrain is hardly "other" (paved, trodden, turf) terrain but a dug or dumped face [rad]."""

    def __post_init__(self) -> None:
        require(self, "doubtful", 0.0, 1.0)
        require(self, "no_component", 0.0, 1.0)
        require(self, "in_component", 0.0, 1.0)
        require(self, "cover_smooth", 0.0, 1.0)
        require(self, "rough", 1.0, open_low=True)

    def __call__(
        self, voxels: Voxels, local: LocalGeometry, terrain: Terrain, objects: ObjectSupport | None
    ) -> Float32[np.ndarray, "J K"]:
        """g_j(k) of every voxel and class."""
        g = np.full((len(voxels), K), self.doubtful, np.float32)
        ground, standing = terrain.member, ~terrain.member & local.inlier
        CT, OT, RC, EX, OB = (k - 1 for k in list(TaskClass)[1:])
        g[ground, CT] = 1.0
        g[ground, OT] = np.clip((self.steep - local.slope[ground]) / (self.steep - np.pi / 4), self.doubtful, 1.0)
        g[ground, RC] = self.cover_smooth + (1 - self.cover_smooth) * self.coverlike(local.roughness[ground])
        g[standing, RC] = 1.0
        for k in (EX, OB):
            g[standing, k] = 1.0 if objects is None else self.no_component
        if objects is not None:
            member = standing & (objects.component > 0)
            g[np.ix_(member, (RC, EX, OB))] = self.in_component
            g[member, objects.task_class[member] - 1] = 1.0
        g[~local.inlier] = 0.0
        return g

    def coverlike(self, roughness: Float32[np.ndarray, "t"]) -> Float32[np.ndarray, "t"]:
        """0 for terrain no rougher than the median, 1 from ``rough`` medians on."""
        median = np.median(roughness) if len(roughness) else 0.0
        if median <= 0:
            return np.zeros_like(roughness)
        return np.clip((roughness / median - 1) / (self.rough - 1), 0.0, 1.0)


@dataclass(frozen=True)
class AdmitAll:
    """Identity twin: geometry forbids nothing, as in plain 3D voting."""

    def __call__(
        self, voxels: Voxels, local: LocalGeometry, terrain: Terrain, objects: ObjectSupport | None
    ) -> Float32[np.ndarray, "J K"]:
        """Ones."""
        return np.ones((len(voxels), K), np.float32)
