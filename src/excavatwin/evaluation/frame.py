"""Bring a map and a truth into one frame, and look the one up where the other has cells."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8

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


def cell_centres(grid: Grid, offset: Float64[np.ndarray, "3"]) -> tuple[np.ndarray, np.ndarray]:
    """x and y of a map's cell centres in the truth's frame, each (Y, X) [m]."""
    x, y = np.meshgrid(grid.x + offset[0], grid.y + offset[1])
    return x, y


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
    g, z = truth.grid, truth.height.astype(float)
    u = (np.asarray(x) - g.west) / g.cell - 0.5
    v = (g.north - np.asarray(y)) / g.cell - 0.5
    tiny = 1e-9  # a position on the last centre is inside, whatever rounding says
    inside: Bool[np.ndarray, "*n"] = (u >= -tiny) & (v >= -tiny) & (u <= g.cols - 1 + tiny) & (v <= g.rows - 1 + tiny)
    i = np.clip(np.floor(u).astype(int), 0, g.cols - 2)
    j = np.clip(np.floor(v).astype(int), 0, g.rows - 2)
    u, v = np.clip(u - i, 0, 1), np.clip(v - j, 0, 1)
    north = z[j, i] * (1 - u) + z[j, i + 1] * u
    south = z[j + 1, i] * (1 - u) + z[j + 1, i + 1] * u
    return np.where(inside, north * (1 - v) + south * v, np.nan)
