"""Terrain accuracy with a network's geometry, against an oracle on the same points.

The oracle is given what the method has to find out: the true class of every point and the true similarity into the map
frame. What it still has is the error of the points themselves, so the ratio of both errors is what the method adds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from excavatwin.evaluation.alignment import Alignment
from excavatwin.evaluation.dimensions import MeasuredObject
from excavatwin.evaluation.elevation import without_plane
from excavatwin.evaluation.frame import true_height, true_label
from excavatwin.evaluation.objects import match
from excavatwin.mapping.elevation import terrain_elevation
from excavatwin.scene.frames import transform
from excavatwin.scene.grid import Grid
from excavatwin.scene.taxonomy import TERRAIN_CLASSES
from excavatwin.scene.trace import Trace
from excavatwin.scene.truth import Truth
from excavatwin.studies.cases import Case


@dataclass(frozen=True)
class TerrainErrors:
    """Errors of one map's terrain."""

    mae: float
    """Mean absolute error as the map stands [m]."""
    fitted_mae: float
    """The same after an extra vertical shift and tilt [m]."""
    rmse: float
    fitted_rmse: float
    scale_error: float
    """Relative error of the scale."""
    cells: int
    """Scored cells."""


def terrain_figures(trace: Trace, case: Case) -> dict[str, float]:
    """Terrain errors of a map and of the oracle [m], and their ratios; nothing where the case has no true terrain.

    ``elevation_*``: by the map's own gravity and declared scale. ``elevation_fitted_*``: after an extra vertical shift
    and tilt. ``elevation_placed_*``: by the true similarity, so that only the choice of the points is left.
    """
    if case.truth is None or case.T_M_R is None or not trace.map.metric:
        return {}
    ours, placed = map_errors(trace, case), map_errors(trace, case, placed=True)
    best = oracle_errors(case, trace.map.grid.cell)
    return {
        "elevation_mae": ours.mae,
        "elevation_rmse": ours.rmse,
        "elevation_fitted_mae": ours.fitted_mae,
        "elevation_fitted_rmse": ours.fitted_rmse,
        "elevation_placed_mae": placed.mae,
        "elevation_placed_rmse": placed.rmse,
        "elevation_scale_error": 100 * ours.scale_error,
        "elevation_cells": float(ours.cells),
        "oracle_elevation_mae": best.mae,
        "oracle_elevation_fitted_mae": best.fitted_mae,
        "elevation_ratio": ours.mae / best.mae,
        "elevation_fitted_ratio": ours.fitted_mae / best.fitted_mae,
        "elevation_placed_ratio": placed.mae / best.mae,
    }


def map_errors(trace: Trace, case: Case, placed: bool = False) -> TerrainErrors:
    """Of the method: its own gravity and its own scale; heading and position by the cameras, never by the terrain.

    Args:
        placed: bring the terrain into place by the true similarity instead.
    """
    truth, T_M_R = _known(case)
    g = trace.map.grid
    at = np.argwhere(np.isfinite(trace.map.elevation))
    xyz = np.stack([g.x[at[:, 1]], g.y[at[:, 0]], trace.map.elevation[at[:, 0], at[:, 1]]], axis=-1).astype(float)
    T = T_M_R @ np.linalg.inv(trace.T_M_R) if placed else in_place(trace, case)
    scale = float(np.cbrt(np.linalg.det(trace.T_M_R[:3, :3]) / np.linalg.det(T_M_R[:3, :3])))
    return score(transform(T, xyz), truth, scale - 1)


def in_place(trace: Trace, case: Case) -> Float64[np.ndarray, "4 4"]:
    """From the map's frame into the truth's: heading and position by the cameras, no tilt and no scale."""
    _, T_M_R = _known(case)
    return heading_and_position(camera_centres(trace.T_M_R, case), camera_centres(T_M_R, case))


def measured_objects(trace: Trace, case: Case) -> tuple[MeasuredObject, ...]:
    """Mapped objects that are true ones, with both sizes [m]; without the one that gave the scale."""
    if case.truth is None or case.T_M_R is None or not trace.map.metric:
        return ()
    T, truth = in_place(trace, case), case.truth
    alignment = Alignment("cameras", float(np.arctan2(T[1, 0], T[0, 0])), T[:3, 3])
    mapped = [alignment.moved(o) for o in trace.map.objects]
    return tuple(
        MeasuredObject(
            case.name, truth.names[j] if j < len(truth.names) else "object", mapped[i].size, truth.objects[j].size
        )
        for i, j, _ in match(mapped, truth.objects, np.zeros(3))
        if truth.objects[j].object_id != case.reference_object and min(mapped[i].size) > 0
    )


def oracle_errors(case: Case, cell: float) -> TerrainErrors:
    """Of the oracle: the median height of the truly terrain points of every cell, under the true similarity."""
    truth, T_M_R = _known(case)
    points = np.concatenate(
        [
            view.points[np.isin(label, TERRAIN_CLASSES) & np.isfinite(view.points).all(axis=-1)]
            for view, label in zip(case.observations.views, case.labels, strict=True)
        ]
    )
    xyz = transform(T_M_R, points.astype(np.float64))
    size = truth.grid.cols * truth.grid.cell
    count = int(np.ceil(size / cell))
    grid = Grid(truth.grid.west, truth.grid.north, cell, count, count)
    H = terrain_elevation(xyz[:, 2], grid.flat_index(xyz[:, :2]).astype(np.int32), count * count)
    at = np.flatnonzero(np.isfinite(H))
    x, y = np.meshgrid(grid.x, grid.y)
    return score(np.stack([x.ravel()[at], y.ravel()[at], H[at].astype(float)], axis=-1), truth, 0.0)


def score(xyz: Float64[np.ndarray, "n 3"], truth: Truth, scale_error: float) -> TerrainErrors:
    """Errors of terrain heights where the truth has terrain on top, before and after an extra shift and tilt."""
    x, y, z = xyz.T
    reference = true_height(truth, x, y)
    scored = np.isin(true_label(truth, x, y), TERRAIN_CLASSES) & np.isfinite(reference)
    error = (z - reference)[scored]
    fitted, _ = without_plane(error, x[scored], y[scored])
    rms = [float(np.sqrt((e**2).mean())) for e in (error, fitted)]
    mae = [float(np.abs(e).mean()) for e in (error, fitted)]
    return TerrainErrors(mae[0], mae[1], rms[0], rms[1], scale_error, int(scored.sum()))


def camera_centres(T_M_R: Float64[np.ndarray, "4 4"], case: Case) -> Float64[np.ndarray, "S 3"]:
    """Where a similarity puts the cameras [m]."""
    return transform(T_M_R, np.array([view.centre for view in case.observations.views], float))


def heading_and_position(p: Float64[np.ndarray, "n 3"], q: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "4 4"]:
    """The turn about z and the shift that bring p closest to q: no tilt, no scale."""
    a, b = p - p.mean(axis=0), q - q.mean(axis=0)
    yaw = np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a[:, :2] * b[:, :2]).sum())
    T = np.eye(4)
    c, s = np.cos(yaw), np.sin(yaw)
    T[:2, :2] = [[c, -s], [s, c]]
    T[:3, 3] = q.mean(axis=0) - T[:3, :3] @ p.mean(axis=0)
    return T


def _known(case: Case) -> tuple[Truth, Float64[np.ndarray, "4 4"]]:
    if case.truth is None or case.T_M_R is None:
        raise ValueError(f"{case.name} has no true terrain or no true similarity to compare with.")
    return case.truth, case.T_M_R
