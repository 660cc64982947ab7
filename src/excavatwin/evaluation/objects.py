"""Objects against truth: found or not, where, and how large."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
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


def object_metrics(mapped: Sequence[MapObject], truth: Truth, offset: Float64[np.ndarray, "3"]) -> tuple[Metric, ...]:
    """Recall, precision and errors of position and size, over all matched objects and for each one.

    A size error is positive when the map's box is too large.
    """
    pairs = match(mapped, truth.objects, offset)
    per_object: list[Metric] = []
    relative, resolved, absolute, centres, tops = [], [], [], [], []
    gsd = ground_sampling_distance(truth)
    smallest = RESOLVED * gsd if np.isfinite(gsd) else 0.0  # without photos every object counts
    for i, j, overlap in sorted(pairs, key=lambda pair: pair[1]):
        a, b = mapped[i], truth.objects[j]
        name = f"object_{j + 1}_{truth.names[j] if j < len(truth.names) else 'object'}"
        difference = np.array(a.size) - b.size
        share = difference / b.size
        absolute.append(np.abs(difference))
        relative.append(np.abs(share))
        if b.size[1] >= smallest:
            resolved.append(np.abs(share))
        centres.append(float(np.hypot(*(np.array(a.centre[:2]) + offset[:2] - b.centre[:2]))))
        tops.append(abs(a.z_top + offset[2] - b.z_top))
        per_object += [
            Metric(
                f"{name}_{side}_error", 100 * float(share[k]), "%", f"{side} {a.size[k]:.2f} m, true {b.size[k]:.2f} m"
            )
            for k, side in enumerate(("length", "width", "height"))
        ]
        per_object.append(Metric(f"{name}_overlap", 100 * overlap, "%", "IoU of the footprints' boxes"))
    right = [mapped[i].task_class == truth.objects[j].task_class for i, j, _ in pairs]

    def share_of(count: float, total: int) -> float:
        return 100 * count / total if total else float("nan")

    def mean(values: Sequence[np.ndarray] | Sequence[float]) -> float:
        return float(np.mean(values)) if len(values) else float("nan")

    return (
        Metric("object_recall", share_of(len(pairs), len(truth.objects)), "%", f"of {len(truth.objects)} true objects"),
        Metric("object_precision", share_of(len(pairs), len(mapped)), "%", f"of {len(mapped)} mapped objects"),
        Metric("object_class_accuracy", share_of(sum(right), len(pairs)), "%", "matched objects of the right class"),
        Metric("object_overlap", 100 * mean([o for _, _, o in pairs]), "%", "mean IoU of the footprints' boxes"),
        Metric("object_centre_error", mean(centres), "m", "mean horizontal distance of the centres"),
        Metric("object_top_error", mean(tops), "m", "mean absolute error of the tops"),
        Metric("object_size_error", mean(absolute), "m", "mean absolute error of length, width and height"),
        Metric("object_size_relative_error", 100 * mean(relative), "%", "mean of the same, relative to the true size"),
        Metric(
            "object_size_relative_error_resolved",
            100 * mean(resolved),
            "%",
            f"mean of the same, objects of at least {RESOLVED} GSD across",
        ),
        *per_object,
    )
