"""Objects of two maps of one site: which are the same, and by how much their boxes differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from excavatwin.evaluation.comparison_frame import Placement
from excavatwin.evaluation.metric import Metric
from excavatwin.evaluation.objects import box_overlap, mean, rectangle
from excavatwin.scene.elevation_map import MapObject
from excavatwin.scene.taxonomy import class_name

SAME = 0.05
"""Least IoU of the footprints' boxes of one object in two maps."""


@dataclass(frozen=True)
class Pair:
    """One object in both maps, in A's frame and unit."""

    a: MapObject
    b: MapObject
    overlap: float
    """IoU of the footprints' boxes, 0..1."""

    @property
    def apart(self) -> float:
        """Horizontal distance of the centres."""
        return float(np.hypot(self.a.centre[0] - self.b.centre[0], self.a.centre[1] - self.b.centre[1]))

    def record(self) -> dict[str, Any]:
        """As a row of a table; differences are B minus A."""
        return {
            "a": self.a.object_id, "b": self.b.object_id,
            "class_a": class_name(self.a.task_class), "class_b": class_name(self.b.task_class),
            "overlap": self.overlap, "distance": self.apart,
            "size_a": list(self.a.size), "size_b": list(self.b.size),
            "size_difference": [theirs - ours for ours, theirs in zip(self.a.size, self.b.size, strict=True)],
            "top_difference": self.b.z_top - self.a.z_top,
        }  # fmt: skip


def moved(o: MapObject, placement: Placement) -> MapObject:
    """An object of B in A's frame."""
    a = np.deg2rad(o.yaw)
    tip = np.array(o.centre[:2]) + 0.5 * o.size[0] * np.array([np.cos(a), np.sin(a)])
    x, y = placement.to_a(np.array([o.centre[0], tip[0]]), np.array([o.centre[1], tip[1]]))
    turned = o.size[0] > 0 and np.hypot(x[1] - x[0], y[1] - y[0]) > 0
    yaw = float(np.rad2deg(np.arctan2(y[1] - y[0], x[1] - x[0]))) if turned else o.yaw
    length, width, height = (placement.scale * side for side in o.size)
    return replace(
        o, centre=(float(x[0]), float(y[0]), float(placement.height(o.centre[2]))), size=(length, width, height),
        yaw=(yaw + 90) % 180 - 90, z_base=float(placement.height(o.z_base)), z_top=float(placement.height(o.z_top)),
        footprint=np.stack(placement.to_a(o.footprint[:, 0], o.footprint[:, 1]), axis=-1),
    )  # fmt: skip


def paired(a: Sequence[MapObject], b: Sequence[MapObject]) -> tuple[Pair, ...]:
    """Objects whose boxes overlap on the ground, best overlap first, each once; in the order of A's objects."""
    zero = np.zeros(3)
    boxes_a, boxes_b = ([rectangle(o, zero) for o in side] for side in (a, b))
    overlaps = [(box_overlap(p, q), i, j) for i, p in enumerate(boxes_a) for j, q in enumerate(boxes_b)]
    chosen: list[tuple[int, int, float]] = []
    for shared, i, j in sorted(overlaps, key=lambda row: (-row[0], a[row[1]].object_id + b[row[2]].object_id)):
        if shared < SAME:
            break
        if all(i != k and j != m for k, m, _ in chosen):
            chosen.append((i, j, shared))
    return tuple(Pair(a[i], b[j], shared) for i, j, shared in sorted(chosen))


def object_figures(pairs: Sequence[Pair], a: int, b: int, unit: str) -> tuple[Metric, ...]:
    """How many objects are in one map and in both, and how much those in both differ.

    Args:
        a: number of objects of A.
        b: number of objects of B.
    """
    sizes = np.array([[pair.a.size, pair.b.size] for pair in pairs], float).reshape(-1, 2, 3)
    step = np.abs(sizes[:, 1] - sizes[:, 0])
    return (
        Metric("object_matched", len(pairs), "1", "objects whose boxes overlap on the ground, in both maps"),
        Metric("object_only_a", a - len(pairs), "1", f"of {a} objects of A"),
        Metric("object_only_b", b - len(pairs), "1", f"of {b} objects of B"),
        Metric("object_overlap", 100 * mean([pair.overlap for pair in pairs]), "%", "mean IoU of the matched boxes"),
        Metric("object_distance", mean([pair.apart for pair in pairs]), unit, "mean distance of their centres"),
        *(
            Metric(f"object_{side}_difference", mean(step[:, k]), unit, f"mean of the absolute difference of {side}")
            for k, side in enumerate(("length", "width", "height"))
        ),
        Metric(
            "object_class_agreement", 100 * mean([pair.a.task_class == pair.b.task_class for pair in pairs]), "%",
            "matched objects of the same class",
        ),
    )  # fmt: skip
