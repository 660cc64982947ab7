"""Elevation of two maps of one site: B minus A, and what a shift, a tilt or the cameras explain."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float32, Float64

from excavatwin.evaluation.comparison_frame import CameraFit
from excavatwin.evaluation.comparison_grid import Layers, heights_by_similarity
from excavatwin.evaluation.elevation import without_plane
from excavatwin.evaluation.metric import Metric
from excavatwin.scene.elevation_map import ElevationMap
from excavatwin.scene.grid import Grid

FAMILIES = {
    "declared": "as placed",
    "shifted": "after the best vertical shift",
    "levelled": "after the best vertical shift and tilt",
    "similarity": "after the similarity of the shared cameras",
}
"""Name in ``elevation_NAME_*`` -> what was done to B before."""


def difference(a: Layers, b: Layers) -> Float32[np.ndarray, "Y X"]:
    """B minus A, NaN where one of them has no terrain height [A's unit]."""
    return (b.elevation.astype(np.float64) - a.elevation).astype(np.float32)


def figures(name: str, d: Float64[np.ndarray, "n"], unit: str, when: str) -> tuple[Metric, ...]:
    """Signed and unsigned figures of a difference; NaN of nothing."""
    size, nan, some = np.abs(d), float("nan"), len(d) > 0
    middle = float(np.median(d)) if some else nan
    said = f"B minus A {when}"
    return (
        Metric(f"{name}_mean", float(d.mean()) if some else nan, unit, f"mean of {said}"),
        Metric(f"{name}_median", middle, unit, f"median of {said}"),
        Metric(
            f"{name}_nmad", float(1.4826 * np.median(np.abs(d - middle))) if some else nan, unit,
            f"normalised median absolute deviation of {said}",
        ),
        Metric(f"{name}_p95", float(np.percentile(size, 95)) if some else nan, unit, f"95 % of {said} are smaller"),
        Metric(f"{name}_rmse", float(np.sqrt((d**2).mean())) if some else nan, unit, f"root mean square of {said}"),
        Metric(f"{name}_cells", float(len(d)), "1", f"cells with a height in both maps, {when}"),
    )  # fmt: skip


def elevation_figures(
    d: Float32[np.ndarray, "Y X"], grid: Grid, b: ElevationMap, a: Layers, fit: CameraFit | None, unit: str
) -> tuple[Metric, ...]:
    """Every figure of the difference ``d`` on the common grid.

    Args:
        b: map B in its own frame, for the similarity of the shared cameras.
        a: map A on the common grid.
        fit: what the shared cameras say; without a similarity in it that family is left out.
    """
    row, col = np.nonzero(np.isfinite(d))
    known = d[row, col].astype(np.float64)
    said = {name: f"elevation_{name}" for name in FAMILIES}
    found = [*figures(said["declared"], known, unit, FAMILIES["declared"])]
    mean = known.mean() if len(known) else 0.0
    found += figures(said["shifted"], known - mean, unit, FAMILIES["shifted"])
    if len(known) >= 3:
        level, plane = without_plane(known, grid.x[col], grid.y[row])
        tilt = float(np.rad2deg(np.arctan(np.hypot(plane[0], plane[1]))))
        found += figures(said["levelled"], level, unit, FAMILIES["levelled"])
        found.append(Metric("elevation_tilt", tilt, "deg", "tilt of B against A, by their common cells"))
    if fit is not None and fit.similarity is not None:
        moved = heights_by_similarity(b, grid, fit.similarity)
        found += figures(said["similarity"], _known(moved, a.elevation), unit, FAMILIES["similarity"])
    return tuple(found)


def _known(b: Float[np.ndarray, "Y X"], a: Float[np.ndarray, "Y X"]) -> Float64[np.ndarray, "n"]:
    d = b.astype(np.float64) - a
    return d[np.isfinite(d)]
