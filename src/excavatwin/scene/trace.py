"""Trace: the intermediate nouns of one run of the mapper, so that nobody needs to derive them again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int32

from excavatwin.scene.elevation_map import ElevationMap
from excavatwin.scene.labels import Labels
from excavatwin.scene.observations import Observations
from excavatwin.scene.points import Points
from excavatwin.scene.support import LocalGeometry, ObjectSupport, Terrain
from excavatwin.scene.voxels import Voxels


@dataclass(frozen=True)
class Trace:
    """The nouns of Sec. III in the order in which the method makes them."""

    observations: Observations
    T_M_R: Float64[np.ndarray, "4 4"]
    """Similarity from the reconstruction to the map frame: s times the gravity rotation, and a shift."""
    points: Points
    voxels: Voxels
    local: LocalGeometry
    terrain: Terrain
    evidence: Float32[np.ndarray, "M K"]
    """e_{j,s}(k) of the view samples after spatial consistency."""
    objects: ObjectSupport | None
    weight: Float32[np.ndarray, "M"]
    """w_{j,s}: reliability of the view samples."""
    labels: Labels
    occupied: Int32[np.ndarray, "J"]
    """Object of every voxel, 0 = none."""
    map: ElevationMap
    seconds: dict[str, float]
    """Wall time of every stage [s]."""

    def __repr__(self) -> str:
        m = self.map
        size = f"{m.grid.rows} x {m.grid.cols} cells of {m.grid.cell:g} {m.unit}"
        return f"Trace({len(self.points)} points, {len(self.voxels)} voxels, {size}, {len(m.objects)} objects)"
