"""Bring a map and a truth into one frame, and look the one up where the other has cells."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Float64, Int64, UInt8

from excavatwin.errors import InputError
from excavatwin.scene.elevation_map import ElevationMap
from excavatwin.scene.grid import Grid
from excavatwin.scene.truth import Truth


def offset_to_truth(m: ElevationMap, truth: Truth) -> Float64[np.ndarray, "3"]:
    """What to add to positions of the map's frame M to have them in the truth's [m].

    Zero when neither is georeferenced: then both are taken to share one frame.

    Raises:
        InputError: only one of them says where it lies, they are in different CRS, or the map has no metric scale.
    """
    if not m.metric:
        raise InputError(
            "The map's unit is arbitrary, so it has no metres to compare; give it a reference length first."
        )
    ours, theirs = m.georeference, truth.georeference
    if (ours is None) != (theirs is None):
        without, with_ = ("map", "truth") if ours is None else ("truth", "map")
        raise InputError(
            f"The {without} has no georeference but the {with_} has one; pass the offset between their frames."
        )
    if ours is None or theirs is None:
        return np.zeros(3)
    if ours.epsg != theirs.epsg:
        raise InputError(f"The map is in EPSG:{ours.epsg} but the truth in EPSG:{theirs.epsg}; reproject one of them.")
    return np.array(ours.origin, float) - np.array(theirs.origin, float)


def nearest(grid: Grid, x: np.ndarray, y: np.ndarray) -> Int64[np.ndarray, "*n"]:
    """Flat index of the cell of each position, -1 outside."""
    xy = np.stack([np.ravel(x), np.ravel(y)], axis=-1)
    return grid.flat_index(xy).reshape(np.shape(x)).astype(np.int64)


def true_label(truth: Truth, x: np.ndarray, y: np.ndarray) -> UInt8[np.ndarray, "*n"]:
    """Task class on top at positions of the truth's frame; 0 outside its grid."""
    index = nearest(truth.grid, x, y)
    return np.where(index >= 0, truth.label.ravel()[np.maximum(index, 0)], 0).astype(np.uint8)


def true_height(truth: Truth, x: np.ndarray, y: np.ndarray) -> Float64[np.ndarray, "*n"]:
    """Bilinear terrain height at positions of the truth's frame; NaN outside its outermost cell centres [m]."""
    return bilinear(truth.grid, truth.height, x, y)


def bilinear(grid: Grid, values: Float[np.ndarray, "Y X"], x: np.ndarray, y: np.ndarray) -> Float64[np.ndarray, "*n"]:
    """Raster values between cell centres; NaN outside the outermost ones and where a cell that counts has none."""
    z = values.astype(float)
    u = (np.asarray(x) - grid.west) / grid.cell - 0.5
    v = (grid.north - np.asarray(y)) / grid.cell - 0.5
    tiny = 1e-9  # a position on a cell centre is inside, and counts that cell alone, whatever rounding says
    near_u, near_v = np.round(u), np.round(v)
    u, v = np.where(np.abs(u - near_u) < tiny, near_u, u), np.where(np.abs(v - near_v) < tiny, near_v, v)
    inside: Bool[np.ndarray, "*n"] = (u >= 0) & (v >= 0) & (u <= grid.cols - 1) & (v <= grid.rows - 1)
    i = np.clip(np.floor(u).astype(int), 0, max(grid.cols - 2, 0))
    j = np.clip(np.floor(v).astype(int), 0, max(grid.rows - 2, 0))
    u, v = np.clip(u - i, 0, 1), np.clip(v - j, 0, 1)
    right, below = np.minimum(i + 1, grid.cols - 1), np.minimum(j + 1, grid.rows - 1)
    north = _between(z[j, i], z[j, right], u)
    south = _between(z[below, i], z[below, right], u)
    return np.where(inside, _between(north, south, v), np.nan)


def _between(a: np.ndarray, b: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Linear interpolation in which an end of weight 0 does not count, NaN or not."""
    return np.where(t == 0, a, np.where(t == 1, b, a * (1 - t) + b * t))
