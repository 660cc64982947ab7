"""Fused labels and backbone labels against the truth, pixel by pixel of the photos: the paper's semantic protocol.

Scored are the pixels whose true place lies inside the site's extent and has a class. A pixel without reconstructed point,
or whose voxel is unknown, has no class: it counts as wrong in a strict figure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, UInt8

from excavatwin.scene.observations import Observations
from excavatwin.scene.taxonomy import NOT_OBSERVED, K
from excavatwin.scene.trace import Trace
from excavatwin.simulation import RenderedView

LABELLED = 0.2
"""Least evidence with which a backbone's pixel counts as labelled."""


@dataclass(frozen=True, eq=False)
class PixelLabels:
    """Scored pixels of all photos of a site, in one row."""

    predicted: UInt8[np.ndarray, "n"]
    """Task class, 0 = none."""
    confidence: Float32[np.ndarray, "n"]
    """Of the prediction; 0 where there is none."""
    true: UInt8[np.ndarray, "n"]
    """Task class 1..K."""


def scored(view: RenderedView, extent: float) -> np.ndarray:
    """Pixels (H, W) that count: a task class, inside the square of edge ``extent`` about the origin."""
    with np.errstate(invalid="ignore"):
        inside = (np.abs(view.points[..., :2]) <= extent / 2).all(axis=-1)
    return inside & (view.label >= 1) & (view.label <= K)


def backbone_labels(observations: Observations, views: Sequence[RenderedView], extent: float) -> PixelLabels:
    """What the segmenter alone says: the strongest class where its evidence counts as a label."""
    parts = []
    for seen, true in zip(observations.views, views, strict=True):
        at = scored(true, extent)
        evidence = seen.evidence[at]
        best = evidence.max(axis=1)
        label = np.where(best >= LABELLED, evidence.argmax(axis=1) + 1, 0).astype(np.uint8)
        parts.append((label, np.where(label > 0, best, 0).astype(np.float32), true.label[at]))
    return PixelLabels(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def fused_labels(trace: Trace, views: Sequence[RenderedView], extent: float) -> PixelLabels:
    """What the fusion says about every pixel: the decision of the voxel of its point."""
    voxel = trace.voxels.of_point
    labels = trace.points.unflatten(trace.labels.label[voxel], NOT_OBSERVED)
    sure = trace.points.unflatten(trace.labels.confidence[voxel], 0.0)
    parts = []
    for label, confidence, true in zip(labels, sure, views, strict=True):
        at = scored(true, extent)
        known = (label[at] >= 1) & (label[at] <= K)
        parts.append((np.where(known, label[at], 0).astype(np.uint8), confidence[at] * known, true.label[at]))
    return PixelLabels(*(np.concatenate(column) for column in zip(*parts, strict=True)))
