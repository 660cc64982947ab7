"""Classes against truth. Strict: a place without a class (unknown, not observed) counts as wrong."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64, Int64, UInt8

from excavatwin.evaluation.frame import nearest
from excavatwin.evaluation.metric import Metric
from excavatwin.scene.elevation_map import ElevationMap
from excavatwin.scene.site import MappedView
from excavatwin.scene.taxonomy import NOT_OBSERVED, TASK_CLASSES, K, class_name
from excavatwin.scene.truth import Truth, ViewTruth


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


def semantic_metrics(name: str, counts: Int64[np.ndarray, "K K+1"], place: str) -> tuple[Metric, ...]:
    """Strict mIoU over the classes that the truth has, coverage, accuracy and the IoU of each class, in per cent."""
    iou = intersection_over_union(counts)
    total, labelled = counts.sum(), counts[:, :K].sum()
    present = counts.sum(1) > 0
    nan = float("nan")
    mean = float(iou[present].mean()) if present.any() else nan
    return (
        Metric(f"{name}_miou", 100 * mean, "%", f"mean IoU over {place}; unknown counts as wrong"),
        Metric(
            f"{name}_coverage", 100 * float(labelled / total) if total else nan, "%", f"share of {place} with a class",
        ),
        Metric(
            f"{name}_accuracy", 100 * float(np.diag(counts).sum() / total) if total else nan, "%",
            f"share of {place} with the right class",
        ),
        *(
            Metric(f"{name}_iou_{class_name(k)}", 100 * float(iou[k - 1]), "%", f"IoU over {place}")
            for k in TASK_CLASSES
            if present[k - 1]
        ),
    )  # fmt: skip


def map_confusion(m: ElevationMap, truth: Truth, offset: Float64[np.ndarray, "3"]) -> Int64[np.ndarray, "K K+1"]:
    """Every cell of the truth against the map's cell at its centre; outside the map there is no class."""
    x, y = np.meshgrid(truth.grid.x - offset[0], truth.grid.y - offset[1])
    index = nearest(m.grid, x, y)
    predicted = np.where(index >= 0, m.label.ravel()[np.maximum(index, 0)], NOT_OBSERVED)
    return confusion(predicted.ravel(), truth.label.ravel())


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
