"""Truth of a site: what a perfect survey would have found. Only evaluation compares with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from excavatwin.scene.elevation_map import MapObject
from excavatwin.scene.grid import Grid
from excavatwin.scene.observations import Georeference


@dataclass(frozen=True, eq=False)
class ViewTruth:
    """One photo's true camera and classes."""

    name: str
    width: int
    """Of the photo [px]."""
    height: int
    K_cam: Float64[np.ndarray, "3 3"]
    """Of the photo; pixel centres at +0.5 [px]."""
    T_M_cam: Float64[np.ndarray, "4 4"]
    """Camera-to-map pose [m]."""
    label: UInt8[np.ndarray, "h w"]
    """Task class at the centres of a coarser lattice over the same field of view; 255 = sky."""


@dataclass(frozen=True, eq=False)
class Truth:
    """Exact rasters (Y, X), row 0 north, objects and cameras in frame M (east, north, up from the origin)."""

    grid: Grid
    height: Float32[np.ndarray, "Y X"]
    """Terrain without objects and cover, at the cell centres [m]."""
    surface: Float32[np.ndarray, "Y X"]
    """What is on top, seen from above, at the cell centres [m]."""
    label: UInt8[np.ndarray, "Y X"]
    """Task class of what is on top."""
    instance: UInt8[np.ndarray, "Y X"]
    """Object id of what is on top, 0 = none."""
    objects: tuple[MapObject, ...] = ()
    names: tuple[str, ...] = ()
    """What each object is, such as ``"pickup"``."""
    views: tuple[ViewTruth, ...] = ()
    georeference: Georeference | None = None
