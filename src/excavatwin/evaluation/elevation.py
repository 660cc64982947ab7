"""Elevation against truth, where the truth has terrain on top and the map has an elevation."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64

from excavatwin.evaluation.alignment import Alignment, cell_at, cell_centres
from excavatwin.evaluation.frame import true_height, true_label
from excavatwin.evaluation.metric import Metric
from excavatwin.scene.elevation_map import ElevationMap
from excavatwin.scene.taxonomy import TERRAIN_CLASSES
from excavatwin.scene.truth import Truth


def ground_sampling_distance(truth: Truth) -> float:
    """Footprint of a photo's pixel at the scene's centre: mean over the photos of distance / focal length [m]."""
    g = truth.grid
    x, y = g.west + g.cols * g.cell / 2, g.north - g.rows * g.cell / 2
    centre = np.array([x, y, float(true_height(truth, np.array(x), np.array(y)))])
    footprints = [np.linalg.norm(view.T_M_cam[:3, 3] - centre) / view.K_cam[0, 0] for view in truth.views]
    return float(np.mean(footprints)) if footprints else float("nan")


def elevation_errors(
    m: ElevationMap, truth: Truth, alignment: Alignment
) -> tuple[Float64[np.ndarray, "Y X"], Bool[np.ndarray, "Y X"]]:
    """Map minus truth at the map's cell centres [m], NaN where not scored; and where the truth has terrain on top."""
    x, y = cell_centres(m.grid, alignment)
    reference = true_height(truth, x, y)
    terrain = np.isin(true_label(truth, x, y), TERRAIN_CLASSES) & np.isfinite(reference)
    return np.where(terrain, m.elevation + alignment.shift[2] - reference, np.nan), terrain


def completeness(m: ElevationMap, truth: Truth, alignment: Alignment) -> float:
    """Share of the truth's terrain cells whose place has an elevation in the map, 0..1."""
    index = cell_at(m, truth, alignment)
    known = (index >= 0) & np.isfinite(m.elevation.ravel()[np.maximum(index, 0)])
    terrain = np.isin(truth.label, TERRAIN_CLASSES)
    return float(known[terrain].mean()) if terrain.any() else float("nan")


def without_plane(
    error: Float64[np.ndarray, "n"], x: Float64[np.ndarray, "n"], y: Float64[np.ndarray, "n"]
) -> tuple[Float64[np.ndarray, "n"], Float64[np.ndarray, "3"]]:
    """Errors after the best vertical shift and tilt, and that plane: error = a x + b y + c, x and y from their mean."""
    A = np.stack([x - x.mean(), y - y.mean(), np.ones_like(x)], axis=-1)
    plane = np.linalg.lstsq(A, error, rcond=None)[0]
    return error - A @ plane, plane


def spread(name: str, error: Float64[np.ndarray, "n"], gsd: float, when: str) -> tuple[Metric, ...]:
    """The usual figures of signed errors; NMAD is 1.4826 times the median deviation from the median."""
    size = np.abs(error)
    some = len(error) > 0
    nan = float("nan")
    mae = float(size.mean()) if some else nan
    return (
        Metric(f"{name}_mae", mae, "m", f"mean absolute error{when}"),
        Metric(f"{name}_mae_gsd", mae / gsd, "GSD", f"mean absolute error{when}, in pixels on the ground"),
        Metric(f"{name}_rmse", float(np.sqrt((error**2).mean())) if some else nan, "m", f"root mean square{when}"),
        Metric(f"{name}_bias", float(error.mean()) if some else nan, "m", f"mean of map minus truth{when}"),
        Metric(
            f"{name}_nmad", float(1.4826 * np.median(np.abs(error - np.median(error)))) if some else nan, "m",
            f"normalised median absolute deviation{when}",
        ),
        Metric(f"{name}_p95", float(np.percentile(size, 95)) if some else nan, "m", f"95 % are off by less{when}"),
    )  # fmt: skip


def elevation_metrics(m: ElevationMap, truth: Truth, alignment: Alignment) -> tuple[Metric, ...]:
    """Errors as the map stands, and again after an extra vertical shift and tilt (``elevation_fitted_*``)."""
    errors, _ = elevation_errors(m, truth, alignment)
    scored = np.isfinite(errors)
    x, y = (axis[scored] for axis in cell_centres(m.grid, alignment))
    gsd = ground_sampling_distance(truth)
    figures = [
        Metric("gsd", gsd, "m", "footprint of a photo's pixel at the scene's centre"),
        *spread("elevation", errors[scored], gsd, ""),
        Metric(
            "elevation_completeness", 100 * completeness(m, truth, alignment), "%", "share of the terrain with a height"
        ),
    ]
    if scored.sum() >= 3:
        fitted, plane = without_plane(errors[scored], x, y)
        tilt = float(np.rad2deg(np.arctan(np.hypot(plane[0], plane[1]))))
        figures += [
            *spread("elevation_fitted", fitted, gsd, " after a vertical shift and tilt"),
            Metric("elevation_tilt", tilt, "deg", "tilt of the map against the truth"),
        ]
    return tuple(figures)
