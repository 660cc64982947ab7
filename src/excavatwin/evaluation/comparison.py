"""Two maps of one site, from two backbones or two settings: how far apart they are. Neither is the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int64

from excavatwin.errors import InputError
from excavatwin.evaluation.comparison_frame import CameraFit, Placement, fit_cameras, place
from excavatwin.evaluation.comparison_grid import Layers, common_grid, layers_of_a, layers_of_b
from excavatwin.evaluation.comparison_heights import difference, elevation_figures
from excavatwin.evaluation.comparison_labels import coverage, coverage_figures, cross_table, label_figures
from excavatwin.evaluation.comparison_objects import Pair, moved, object_figures, paired
from excavatwin.evaluation.comparison_runs import Difference, run_differences
from excavatwin.evaluation.comparison_site import ComparedSite
from excavatwin.evaluation.metric import Metric
from excavatwin.scene.elevation_map import MapObject
from excavatwin.scene.grid import Grid


@dataclass(frozen=True, eq=False)
class Comparison:
    """Everything that one run of ``excavatwin compare`` found, in A's frame and unit."""

    a: ComparedSite
    b: ComparedSite
    placement: Placement
    grid: Grid
    """A's grid, carried on until it holds B as well."""
    own: tuple[slice, slice]
    """Rows and columns of it that are A's own."""
    layers_a: Layers
    layers_b: Layers
    difference: Float32[np.ndarray, "Y X"]
    """B minus A as placed; NaN where one has no terrain height."""
    counts: Int64[np.ndarray, "L L"]
    """Cells by class in A (rows) and in B (columns), see ``comparison_labels.VALUES``."""
    objects_b: tuple[MapObject, ...]
    """B's objects in A's frame."""
    pairs: tuple[Pair, ...]
    runs: tuple[Difference, ...]
    metrics: tuple[Metric, ...]
    notes: tuple[str, ...]
    """What a reader should know, one sentence each."""

    @property
    def unit(self) -> str:
        """A's: ``"m"``, or ``"unit"`` where it is arbitrary."""
        return self.a.map.unit

    def value(self, name: str) -> float:
        """A figure by its name; NaN where it was not measured."""
        return next((m.value for m in self.metrics if m.name == name), float("nan"))


def compare(a: ComparedSite, b: ComparedSite, way: str = "auto") -> Comparison:
    """Compare map B with map A.

    Args:
        way: how B comes into A's frame, one of ``comparison_frame.WAYS``.

    Raises:
        InputError: the maps cannot be brought into one frame, or observe no cell in common.
    """
    placement = place(a, b, way)
    grid, own = common_grid(a, b, placement)
    unit = a.map.unit
    ours, theirs = layers_of_a(a.map, grid, own), layers_of_b(b.map, grid, placement)
    covered = coverage(ours, theirs)
    if covered["observed"][2] == 0:
        raise InputError(f"{a.folder} and {b.folder} observe no cell in common; give two maps of one site.")
    d, counts, fit = difference(ours, theirs), cross_table(ours.label, theirs.label), fit_cameras(a, b, placement)
    objects = tuple(moved(o, placement) for o in b.map.objects)
    pairs = paired(a.map.objects, objects)
    metrics = (
        *frame_figures(placement, fit, unit),
        *elevation_figures(d, grid, b.map, ours, fit, unit),
        *label_figures(counts),
        *coverage_figures(covered, grid.cell, unit),
        *object_figures(pairs, len(a.map.objects), len(objects), unit),
    )
    notes = tuple(_notes(a, b, placement, fit, {m.name: m.value for m in metrics}))
    runs = run_differences(a.run, b.run)
    return Comparison(a, b, placement, grid, own, ours, theirs, d, counts, objects, pairs, runs, metrics, notes)


def frame_figures(placement: Placement, fit: CameraFit | None, unit: str) -> tuple[Metric, ...]:
    """What the shared cameras say of the two frames; the scale that was applied where a map has none."""
    found = []
    if placement.scale != 1:
        found.append(Metric("frame_scale", placement.scale, "1", "lengths of A over lengths of B, by the cameras"))
    if fit is None:
        return tuple(found)
    found += [
        Metric("frame_cameras", fit.cameras, "1", "photos that both maps placed, by name"),
        Metric("frame_residual", fit.residual, unit, "RMS distance of B's cameras from A's, as placed"),
    ]
    if fit.similarity is None:
        return tuple(found)
    s, R, _ = fit.similarity
    lean = float(np.rad2deg(np.arccos(np.clip(R[2, 2], -1, 1))))
    return (
        *found,
        Metric("frame_similarity_residual", fit.fitted, unit, "the same after the similarity of these cameras"),
        Metric(
            "frame_similarity_scale", 100 * (s / placement.scale - 1), "%",
            "what that similarity still adds to B's lengths; applied in elevation_similarity_* alone",
        ),
        Metric("frame_similarity_tilt", lean, "deg", "how far it leans B's vertical"),
    )  # fmt: skip


def _notes(
    a: ComparedSite, b: ComparedSite, placement: Placement, fit: CameraFit | None, values: dict[str, float]
) -> list[str]:
    found = []
    if placement.way == "reprojected" and a.map.georeference and b.map.georeference:
        found.append(
            f"B was reprojected from EPSG:{b.map.georeference.epsg} to EPSG:{a.map.georeference.epsg}; heights kept."
        )
    if placement.way == "cameras" and a.map.georeference and b.map.georeference is None:
        found.append("B has no georeference: the cameras place it.")
    if placement.way == "cameras" and b.map.georeference and a.map.georeference is None:
        found.append("A has no georeference, so the difference stands in its local frame.")
    if not a.map.metric:
        more = "; with B first the figures would be metres" if b.map.metric else ", and neither has B"
        found.append(f"A has no metric scale: every length is in its arbitrary unit{more}.")
    elif not b.map.metric:
        found.append("B has no metric scale: the cameras brought it to A's metres, so its scale is not compared.")
    ratio = b.map.grid.cell * placement.scale / a.map.grid.cell
    if abs(ratio - 1) > 1e-6:
        found.append(f"B's cells are {ratio:.3g} times as long as A's; it was looked up at the centres of A's.")
    shift, spread = values["elevation_declared_median"], values["elevation_declared_nmad"]
    if values["elevation_declared_cells"] == 0:
        found.append("No cell has a terrain height in both maps, so there are no figures of elevation.")
    elif abs(shift) > 3 * spread and abs(shift) > 1e-3 * a.map.grid.cell:
        found.append(f"B lies {shift:+.3g} {a.map.unit} off as a whole; elevation_shifted_* leaves that out.")
    if fit is not None and fit.similarity is None:
        found.append("The shared cameras stand on a line, so no similarity is told by them.")
    return found
