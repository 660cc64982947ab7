"""Site: everything that one run leaves behind, ready for the exporters."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64, Int32, UInt8

from excavatwin.scene.elevation_map import ElevationMap
from excavatwin.scene.observations import Lattice, Unplaced


@dataclass(frozen=True)
class FusedPoints:
    """The fused cloud: one point per voxel, in frame M."""

    xyz: Float32[np.ndarray, "J 3"]
    """Centroids [m]."""
    label: UInt8[np.ndarray, "J"]
    """Task class after eq:semantic_decision."""
    confidence: Float32[np.ndarray, "J"]
    rgb: UInt8[np.ndarray, "J 3"]
    """Mean colour; grey where the observations carry no images."""
    object_id: Int32[np.ndarray, "J"]
    support: UInt8[np.ndarray, "J"]


@dataclass(frozen=True)
class MappedView:
    """A placed photo: where its camera stands in the map and what its pixels turned out to be."""

    name: str
    label: UInt8[np.ndarray, "H W"]
    """Refined label image: the decision of each pixel's voxel; 255 = no trustworthy depth."""
    K_cam: Float64[np.ndarray, "3 3"]
    T_M_cam: Float64[np.ndarray, "4 4"]
    """Camera-to-map pose [m]."""
    image: UInt8[np.ndarray, "H W 3"] | None = None
    lattice: Lattice | None = None


@dataclass(frozen=True)
class Site:
    """The map with its cloud, its views and the story of how it came about."""

    map: ElevationMap
    points: FusedPoints
    views: tuple[MappedView, ...]
    unplaced: tuple[Unplaced, ...] = ()
    run: dict[str, Any] = field(default_factory=dict)
    """versions, config, inputs, stage times, peak memory, warnings: the content of run.json."""

    def to_xarray(self) -> Any:
        """The map's rasters as an ``xarray.Dataset``; see ``ElevationMap.to_xarray``."""
        return self.map.to_xarray()
