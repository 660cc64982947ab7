"""Object-level components of the non-terrain voxels (Sec. "Non-Terrain Object Extraction")."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32

from excavatwin.accumulation import accumulate
from excavatwin.errors import require
from excavatwin.paper import equation
from excavatwin.scene.support import LocalGeometry, ObjectSupport, Terrain
from excavatwin.scene.taxonomy import OBJECT_CLASSES
from excavatwin.scene.voxels import Voxels
from excavatwin.topology import radius_clusters


@dataclass(frozen=True)
class Objects:
    """Reliability filter, clusters on a scene-relative radius graph, geometric clean-up."""

    q: float = 0.10
    """Quantile of the reconstruction confidence within a class below which a point is not retained."""
    e_min: float = 0.15
    """Least accumulated evidence for the point's own class."""
    radius: float = 2.5
    """Linkage distance [voxels]."""
    min_voxels: int = 12
    """Smallest component."""
    min_height: float = 2.0
    """Least height above the terrain that a component must reach [voxels]."""

    def __post_init__(self) -> None:
        require(self, "q", 0.0, 1.0)
        require(self, "e_min", 0.0, 1.0)
        require(self, "radius", 0.0, open_low=True)

    def __call__(
        self, voxels: Voxels, evidence: Float32[np.ndarray, "M K"], local: LocalGeometry, terrain: Terrain
    ) -> ObjectSupport:
        """Components of excavator and obstacle voxels."""
        J = len(voxels)
        e, phi = accumulate(voxels, evidence)
        own = (e.argmax(axis=1) + 1).astype(np.int32)
        standing = local.inlier & ~terrain.member & np.isin(own, OBJECT_CLASSES)
        retained = standing.copy()
        retained[standing] = confidence_filter(phi[standing], e[standing], own[standing], self.q, self.e_min)
        rows = np.flatnonzero(retained)
        cluster, size = radius_clusters(voxels.centre[rows], self.radius * voxels.size, own[rows])
        top = np.full(len(size), -np.inf)
        np.maximum.at(top, cluster, terrain.height[rows])
        keep = (size >= self.min_voxels) & (top >= self.min_height * voxels.size)
        number = np.where(keep, np.cumsum(keep), 0)
        component, task_class = np.zeros(J, np.int32), np.zeros(J, np.int32)
        component[rows] = number[cluster]
        task_class[rows] = np.where(component[rows] > 0, own[rows], 0)
        return ObjectSupport(component, task_class)


@dataclass(frozen=True)
class NoObjects:
    """Identity twin ("w/o Object support"): no component is formed."""

    def __call__(
        self, voxels: Voxels, evidence: Float32[np.ndarray, "M K"], local: LocalGeometry, terrain: Terrain
    ) -> None:
        """Nothing: the admissibility of objects rests on the terrain support alone."""
        return None


@equation("eq:gc_conf_filter")
def confidence_filter(
    phi: Float[np.ndarray, "n"], e: Float[np.ndarray, "n K"], c: Int32[np.ndarray, "n"], q: float, e_min: float
) -> Bool[np.ndarray, "n"]:
    """phi_i >= Q_q({phi_j : c_j = c_i}) and e_i(c_i) >= e_min.

    Args:
        phi: reconstruction confidence.
        e: accumulated evidence for the classes 1..K.
        c: class of each point, 1..K.
        q: quantile in [0, 1].
        e_min: evidence threshold.
    """
    confident = np.zeros(len(phi), bool)
    for k in np.unique(c):
        of_class = c == k
        confident[of_class] = phi[of_class] >= np.quantile(phi[of_class], q)
    return confident & (e[np.arange(len(c)), c - 1] >= e_min)
