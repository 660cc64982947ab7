"""Fused labels and backbone labels against the truth, pixel by pixel of the photos: the paper's semantic protocol.

A pixel without reconstructed point, or whose voxel is unknown, has no class: it counts as wrong in a strict figure.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, UInt8

from excavatwin.evaluation.semantics import semantic_scores
from excavatwin.scene.taxonomy import NOT_OBSERVED
from excavatwin.scene.trace import Trace
from excavatwin.studies.cases import Case

LABELLED = 0.2
"""Least evidence with which a backbone's pixel counts as labelled."""


@dataclass(frozen=True, eq=False)
class PixelLabels:
    """Scored pixels of all photos of a case, in one row."""

    predicted: UInt8[np.ndarray, "n"]
    """Task class, 0 = none."""
    confidence: Float32[np.ndarray, "n"]
    """Of the prediction; 0 where there is none."""
    true: UInt8[np.ndarray, "n"]
    """Task class 1..K."""


def backbone_labels(case: Case) -> PixelLabels:
    """What the segmenter alone says: the strongest class where its evidence counts as a label."""
    predicted, confidence = [], []
    for view, true in zip(case.observations.views, case.labels, strict=True):
        evidence = view.evidence[true != NOT_OBSERVED]
        best = evidence.max(axis=1)
        known = best >= LABELLED
        predicted.append(np.where(known, evidence.argmax(axis=1) + 1, 0).astype(np.uint8))
        confidence.append(np.where(known, best, 0).astype(np.float32))
    return PixelLabels(np.concatenate(predicted), np.concatenate(confidence), true_labels(case))


def fused_labels(trace: Trace, case: Case) -> PixelLabels:
    """What the fusion says about every pixel: the decision of the voxel of its point."""
    voxel = trace.voxels.of_point
    labels = trace.points.unflatten(trace.labels.label[voxel], 0)
    sure = trace.points.unflatten(trace.labels.confidence[voxel], 0.0)
    at = [true != NOT_OBSERVED for true in case.labels]
    predicted = np.concatenate([label[a] for label, a in zip(labels, at, strict=True)])
    confidence = np.concatenate([c[a] for c, a in zip(sure, at, strict=True)]).astype(np.float32)
    return PixelLabels(predicted, np.where(predicted > 0, confidence, 0), true_labels(case))


def true_labels(case: Case) -> UInt8[np.ndarray, "n"]:
    """Classes of the scored pixels."""
    return np.concatenate([true[true != NOT_OBSERVED] for true in case.labels])


def scores(labels: PixelLabels, forced: PixelLabels | None = None) -> dict[str, float]:
    """Figures of classes with their confidences, by name [%; the ratio plain].

    Args:
        forced: the same without rejection, against which the worth of knowing what one does not know is stated.

    Returns:
        ``miou`` (strict, over the classes that the truth has), ``miou_selective``, ``coverage``, ``accuracy``,
        ``accuracy_selective``, ``iou_CLASS``, ``aurc``, ``risk_at_95``, ``ece``; with forced also ``risk_forced``,
        ``risk_ratio``.
    """
    metrics = semantic_scores(
        labels.predicted, labels.true, labels.confidence if forced is None else forced.confidence,
        forced=None if forced is None else forced.predicted, name="photo", place="the photos' pixels",
    )  # fmt: skip
    return {metric.name.removeprefix("photo_"): metric.value for metric in metrics}
