"""Objects against truth: found or not, where, and how large."""

from __future__ import annotations

from collections.abc import Sequence, Sized

import numpy as np
import numpy.typing as npt
from jaxtyping import Float64

from excavatwin.evaluation.elevation import ground_sampling_distance
from excavatwin.evaluation.metric import Metric
from excavatwin.scene.elevation_map import MapObject
from excavatwin.scene.truth import Truth

RESOLVED = 20
"""An object of fewer pixels across, on the ground, is too small for its size to be measured [GSD]."""


def area(polygon: Float64[np.ndarray, "n 2"]) -> float:
    """Signed area by the shoelace formula, positive when counter-clockwise [m2]."""
    x, y = polygon.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def clip(subject: Float64[np.ndarray, "n 2"], window: Float64[np.ndarray, "m 2"]) -> Float64[np.ndarray, "k 2"]:
    """The part of a polygon inside a convex, counter-clockwise one (Sutherland and Hodgman 1974)."""
    kept = [np.asarray(p, float) for p in subject]
    for a, b in zip(window, np.roll(window, -1, axis=0), strict=True):
        edge, points, kept = b - a, kept, []
        side = [edge[0] * (p[1] - a[1]) - edge[1] * (p[0] - a[0]) for p in points]
        for k, p in enumerate(points):
            before, s, s0 = points[k - 1], side[k], side[k - 1]
            if (s >= 0) != (s0 >= 0):
                kept.append(before + (p - before) * s0 / (s0 - s))
            if s >= 0:
                kept.append(p)
    return np.array(kept).reshape(-1, 2)


def rectangle(o: MapObject, offset: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "4 2"]:
    """Corners of an object's box in the truth's frame, counter-clockwise [m]."""
    c, s = np.cos(np.deg2rad(o.yaw)), np.sin(np.deg2rad(o.yaw))
    corners = 0.5 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * o.size[:2]
    return np.array(o.centre[:2]) + offset[:2] + corners @ np.array([[c, s], [-s, c]])


def box_overlap(a: Float64[np.ndarray, "4 2"], b: Float64[np.ndarray, "4 2"]) -> float:
    """Intersection over union of two rectangles on the ground."""
    common = clip(a, b)
    shared = area(common) if len(common) >= 3 else 0.0
    union = area(a) + area(b) - shared
    return shared / union if union > 0 else 0.0


def match(
    mapped: Sequence[MapObject], true: Sequence[MapObject], offset: Float64[np.ndarray, "3"]
) -> list[tuple[int, int, float]]:
    """Pairs (mapped, true, overlap), best overlap first, each object once.

    Boxes that do not overlap still pair when their centres are closer than half the true length.
    """
    pairs = []
    for i, a in enumerate(mapped):
        for j, b in enumerate(true):
            distance = float(np.hypot(*(np.array(a.centre[:2]) + offset[:2] - b.centre[:2])))
            overlap = box_overlap(rectangle(a, offset), rectangle(b, np.zeros(3)))
            if overlap > 0.05 or distance < 0.5 * b.size[0]:
                pairs.append((-overlap, distance, i, j))
    chosen: list[tuple[int, int, float]] = []
    for overlap, _, i, j in sorted(pairs):
        if all(i != a and j != b for a, b, _ in chosen):
            chosen.append((i, j, -overlap))
    return chosen


def object_metrics(mapped: Sequence[MapObject], truth: Truth) -> tuple[Metric, ...]:
    """Recall, precision and errors of position and size, over all matched objects and for each one.

    Args:
        mapped: the map's objects in the truth's frame (``Alignment.moved``).

    A size error is positive when the map's box is too large.
    """
    pairs = match(mapped, truth.objects, np.zeros(3))
    ours, theirs = [mapped[i] for i, _, _ in pairs], [truth.objects[j] for _, j, _ in pairs]
    size = np.array([a.size for a in ours]).reshape(-1, 3)
    true_size = np.array([b.size for b in theirs]).reshape(-1, 3)
    error = np.abs(size - true_size)
    gsd = ground_sampling_distance(truth)
    resolved = true_size[:, 1] >= (RESOLVED * gsd if np.isfinite(gsd) else 0.0)  # without photos every object counts
    apart = [np.hypot(*(np.array(a.centre[:2]) - b.centre[:2])) for a, b in zip(ours, theirs, strict=True)]
    tops = [abs(a.z_top - b.z_top) for a, b in zip(ours, theirs, strict=True)]
    right = [a.task_class == b.task_class for a, b in zip(ours, theirs, strict=True)]
    return (
        Metric("object_recall", 100 * share(pairs, truth.objects), "%", f"of {len(truth.objects)} true objects"),
        Metric("object_precision", 100 * share(pairs, mapped), "%", f"of {len(mapped)} mapped objects"),
        Metric("object_class_accuracy", 100 * mean(right), "%", "matched objects of the right class"),
        Metric("object_overlap", 100 * mean([o for _, _, o in pairs]), "%", "mean IoU of the footprints' boxes"),
        Metric("object_centre_error", mean(apart), "m", "mean horizontal distance of the centres"),
        Metric("object_top_error", mean(tops), "m", "mean absolute error of the tops"),
        Metric("object_size_error", mean(error), "m", "mean absolute error of length, width and height"),
        Metric("object_size_relative_error", 100 * mean(error / true_size), "%", "mean of the same, of the true size"),
        Metric(
            "object_size_relative_error_resolved",
            100 * mean((error / true_size)[resolved]),
            "%",
            f"mean of the same, objects of at least {RESOLVED} GSD across",
        ),
        *(figure for pair in sorted(pairs, key=lambda pair: pair[1]) for figure in one_object(pair, mapped, truth)),
    )


def one_object(pair: tuple[int, int, float], mapped: Sequence[MapObject], truth: Truth) -> list[Metric]:
    """Errors of length, width and height of one matched object, relative to the true ones, and its overlap."""
    i, j, overlap = pair
    a, b = mapped[i], truth.objects[j]
    name = f"object_{j + 1}_{truth.names[j] if j < len(truth.names) else 'object'}"
    figures = [
        Metric(f"{name}_{side}_error", 100 * (ours / true - 1), "%", f"{side} {ours:.2f} m, true {true:.2f} m")
        for side, ours, true in zip(("length", "width", "height"), a.size, b.size, strict=True)
    ]
    return [*figures, Metric(f"{name}_overlap", 100 * overlap, "%", "IoU of the footprints' boxes")]


def mean(values: npt.ArrayLike) -> float:
    """Mean; NaN of nothing."""
    a = np.asarray(values, float)
    return float(a.mean()) if a.size else float("nan")


def share(part: Sized, whole: Sized) -> float:
    """Length of a part over that of the whole; NaN of nothing."""
    return len(part) / len(whole) if len(whole) else float("nan")
