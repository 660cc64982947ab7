"""Classes against truth.

Strict: a place without a class (unknown, not observed) counts as wrong. Selective: such places are left out, which is
only honest beside the coverage. The policy is the one by which the *truth* was brought to the task classes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Float64, Int64, UInt8

from excavatwin.evaluation.alignment import Alignment, cell_at
from excavatwin.evaluation.metric import Metric
from excavatwin.evaluation.selective import RiskCoverage, risk_coverage, selective_metrics
from excavatwin.scene.elevation_map import ElevationMap
from excavatwin.scene.site import MappedView
from excavatwin.scene.taxonomy import NOT_OBSERVED, TASK_CLASSES, K, class_name
from excavatwin.scene.truth import Truth, ViewTruth

__all__ = [
    "RiskCoverage",
    "confusion",
    "intersection_over_union",
    "risk_coverage",
    "semantic_metrics",
    "semantic_scores",
]


TASK_POLICY = "task"
"""Policy of a truth that was made in task classes: nothing had to be mapped."""


def confusion(predicted: UInt8[np.ndarray, "n"], true: UInt8[np.ndarray, "n"]) -> Int64[np.ndarray, "K K+1"]:
    """Counts by true class 1..K (rows) and predicted class 1..K (columns); the last column has no class."""
    valid = (true >= 1) & (true <= K)
    column = np.where((predicted >= 1) & (predicted <= K), predicted.astype(int) - 1, K)
    flat = (true[valid].astype(int) - 1) * (K + 1) + column[valid]
    return np.bincount(flat, minlength=K * (K + 1)).reshape(K, K + 1)


def intersection_over_union(counts: Int64[np.ndarray, "K K+1"]) -> Float64[np.ndarray, "K"]:
    """IoU of each class; NaN for a class that neither truth nor prediction has."""
    hit = np.diag(counts).astype(float)
    union = counts.sum(1) + counts[:, :K].sum(0) - hit
    return np.where(union > 0, hit / np.maximum(union, 1), np.nan)


def selective_iou(counts: Int64[np.ndarray, "K K+1"]) -> Float64[np.ndarray, "K"]:
    """IoU of each class among the places that have a class; never below the strict one, NaN where none has it."""
    return intersection_over_union(np.concatenate([counts[:, :K], np.zeros((K, 1), counts.dtype)], axis=1))


def mean_over(iou: Float64[np.ndarray, "K"], present: Bool[np.ndarray, "K"]) -> float:
    """Mean of the IoU over the classes that the truth has, leaving out undefined ones; NaN of nothing."""
    scored = iou[present & np.isfinite(iou)]
    return float(scored.mean()) if len(scored) else float("nan")


def semantic_metrics(
    name: str, counts: Int64[np.ndarray, "K K+1"], place: str, policy: str = TASK_POLICY
) -> tuple[Metric, ...]:
    """Strict and selective mIoU over the classes that the truth has, coverage, accuracies, IoU of each class [%]."""
    iou = intersection_over_union(counts)
    total, labelled, hit = counts.sum(), counts[:, :K].sum(), np.diag(counts).sum()
    present = counts.sum(1) > 0
    nan = float("nan")
    by = f"policy {policy!r}"
    return (
        Metric(
            f"{name}_miou", 100 * mean_over(iou, present), "%",
            f"strict mean IoU, unknown is wrong, {by}; {place}",
        ),
        Metric(
            f"{name}_miou_selective", 100 * mean_over(selective_iou(counts), present), "%",
            f"selective mean IoU, unknown left out, {by}; {place}",
        ),
        Metric(
            f"{name}_coverage", 100 * float(labelled / total) if total else nan, "%", f"share of {place} with a class",
        ),
        Metric(
            f"{name}_accuracy", 100 * float(hit / total) if total else nan, "%",
            f"share of {place} with the right class",
        ),
        Metric(
            f"{name}_accuracy_selective", 100 * float(hit / labelled) if labelled else nan, "%",
            f"share of right ones among {place} with a class",
        ),
        *(
            Metric(f"{name}_iou_{class_name(k)}", 100 * float(iou[k - 1]), "%", f"strict IoU over {place}, {by}")
            for k in TASK_CLASSES
            if present[k - 1]
        ),
    )  # fmt: skip


def semantic_scores(
    predicted: UInt8[np.ndarray, "n"],
    true: UInt8[np.ndarray, "n"],
    confidence: Float[np.ndarray, "n"] | None = None,
    *,
    forced: UInt8[np.ndarray, "n"] | None = None,
    name: str = "map",
    place: str = "places",
    policy: str = TASK_POLICY,
) -> tuple[Metric, ...]:
    """Every semantic figure of classes against truth: ``semantic_metrics`` and, with a confidence, what it is worth.

    Args:
        predicted: class 1..K; 0, 255 and all else have no class.
        true: class 1..K; places with another value are not scored.
        confidence: stated for the class, 0..1.
        forced: arg-max without rejection (tau = 0), to compare the risk at 95 % coverage with it; ``confidence`` is
            then its confidence, too.
        name: first word of the metrics' names.
        place: what one entry is, for the meanings: "the photos' pixels".
        policy: name of the class mapping of the truth.

    Returns:
        ``NAME_miou`` (strict), ``NAME_miou_selective``, ``NAME_coverage``, ``NAME_accuracy``,
        ``NAME_accuracy_selective``, ``NAME_iou_CLASS``; with confidence ``NAME_aurc``, ``NAME_risk_at_95``,
        ``NAME_ece``; with forced ``NAME_risk_forced``, ``NAME_risk_ratio``. In per cent, the ratio plain.
    """
    figures = semantic_metrics(name, confusion(predicted, true), place, policy)
    if confidence is None:
        return figures
    return (*figures, *selective_metrics(name, predicted, true, confidence, place, forced))


def map_at_truth(
    m: ElevationMap, truth: Truth, alignment: Alignment
) -> tuple[UInt8[np.ndarray, "n"], Float64[np.ndarray, "n"]]:
    """Class and confidence of the map's cell at the centre of every cell of the truth; outside there is no class."""
    index = cell_at(m, truth, alignment).ravel()
    inside, index = index >= 0, np.maximum(index, 0)
    predicted = np.where(inside, m.label.ravel()[index], NOT_OBSERVED).astype(np.uint8)
    return predicted, np.where(inside, m.confidence.ravel()[index], 0.0)


def map_scores(m: ElevationMap, truth: Truth, alignment: Alignment, policy: str = TASK_POLICY) -> tuple[Metric, ...]:
    """Every semantic figure of the map's cells, over the cells of the truth."""
    predicted, confidence = map_at_truth(m, truth, alignment)
    return semantic_scores(
        predicted, truth.label.ravel(), confidence, name="map", place="the truth's cells", policy=policy
    )


def map_curve(m: ElevationMap, truth: Truth, alignment: Alignment) -> RiskCoverage:
    """Risk-coverage curve of the map's cells."""
    predicted, confidence = map_at_truth(m, truth, alignment)
    return risk_coverage(predicted, truth.label.ravel(), confidence)


def view_labels_at_truth(view: MappedView, true: ViewTruth) -> UInt8[np.ndarray, "h w"]:
    """Labels of a mapped view at the truth's pixels; 255 where its lattice does not reach."""
    h, w = true.label.shape
    v, u = np.mgrid[:h, :w] + 0.5
    pixels = np.stack([u.ravel() * true.width / w, v.ravel() * true.height / h], axis=-1)
    lattice = view.lattice.from_photo(pixels) if view.lattice else pixels
    H, W = view.label.shape
    col, row = np.floor(lattice).astype(int).T
    inside = (col >= 0) & (col < W) & (row >= 0) & (row < H)
    found = view.label[np.clip(row, 0, H - 1), np.clip(col, 0, W - 1)]
    return np.where(inside, found, NOT_OBSERVED).reshape(h, w).astype(np.uint8)


def photo_confusion(views: Sequence[MappedView], truth: Truth) -> Int64[np.ndarray, "K K+1"]:
    """Every pixel of every true photo against the refined labels; a photo that was not placed has no classes."""
    by_name = {view.name: view for view in views}
    counts = np.zeros((K, K + 1), np.int64)
    for true in truth.views:
        view = by_name.get(true.name)
        predicted = np.full(true.label.shape, NOT_OBSERVED, np.uint8)
        if view is not None:
            predicted = view_labels_at_truth(view, true)
        counts += confusion(predicted.ravel(), true.label.ravel())
    return counts
