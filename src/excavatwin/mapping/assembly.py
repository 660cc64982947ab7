"""The multi-layer map M = {M^work, M^noise, M^object} (eq:multilayer_map)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32, UInt8

from excavatwin.mapping.occupancy import Occupied
from excavatwin.mapping.raster import Cells
from excavatwin.paper import equation
from excavatwin.scene.elevation_map import ElevationMap
from excavatwin.scene.observations import Georeference
from excavatwin.scene.support import Terrain
from excavatwin.scene.taxonomy import NOT_OBSERVED, Support
from excavatwin.scene.voxels import Voxels


@equation("eq:multilayer_map")
def assemble(
    cells: Cells,
    elevation: tuple[Float32[np.ndarray, "Y X"], Float32[np.ndarray, "Y X"]],
    semantics: tuple[UInt8[np.ndarray, "Y X"], Float32[np.ndarray, "Y X"], UInt8[np.ndarray, "Y X"]],
    occupied: Occupied,
    support: UInt8[np.ndarray, "Y X"],
    metric: bool,
    georeference: Georeference | None,
    doubts: tuple[str, ...],
) -> ElevationMap:
    """Co-registered layers: terrain elevation (work), cover (noise), machines and obstacles (object)."""
    H, sigma = elevation
    label, confidence, reason = semantics
    return ElevationMap(
        grid=cells.grid, elevation=H, elevation_std=sigma, label=label, confidence=confidence,
        observed=(label != NOT_OBSERVED).astype(np.uint8), reason=reason, object_id=occupied.object_id,
        object_top=occupied.top, object_base=occupied.base, support=support, objects=occupied.objects,
        metric=metric, georeference=georeference, doubts=doubts,
    )  # fmt: skip


def cell_support(cells: Cells, voxels: Voxels, terrain: Terrain) -> UInt8[np.ndarray, "Y X"]:
    """Support of most samples of a cell; NONE where it has no sample."""
    n_cells = cells.grid.rows * cells.grid.cols
    kept = cells.of_sample >= 0
    cell, ground = cells.of_sample[kept], terrain.member[voxels.voxel[kept]]
    on = np.bincount(cell[ground], minlength=n_cells)
    off = np.bincount(cell[~ground], minlength=n_cells)
    support = np.where(on >= off, Support.TERRAIN, Support.NON_TERRAIN)
    return np.where(on + off > 0, support, Support.NONE).astype(np.uint8).reshape(cells.grid.shape)
