"""Several segmenters at once: their evidence merged channel by channel, with weights from labelled pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64, UInt8

from excavatwin.backbones.protocols import Segmentation
from excavatwin.errors import InputError
from excavatwin.scene.taxonomy import K

#: Weights are sought between its inverse and this: a channel is never silenced nor trusted without bound.
FURTHEST = 4.0
#: Pixels of one class that are enough to tell the weights; evenly spaced over all pictures.
ENOUGH = 20_000
#: With fewer pixels of a class than this its weights stay 1.
FEWEST = 200
#: A class counts by this power of its share of the pixels: 1 as in the pictures, 0 every class alike.
SHARE = 0.5


@dataclass(frozen=True)
class Merging:
    """Weighted sum of the evidence, scaled down where it exceeds 1: who abstains dilutes nobody.

    A mean would halve what a dense network says wherever a sparse one has nothing to say. In a sum, silence is zero;
    two that agree strengthen each other up to certainty, two that differ share by what they claim. The order of the
    segmenters is irrelevant, and one alone passes unchanged.
    """

    weights: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    """Segmenter -> weight of each of the five channels; 1 for those that are not named (``calibrate`` finds them)."""

    def __post_init__(self) -> None:
        for name, row in self.weights.items():
            if len(row) != K or not all(np.isfinite(value) and value >= 0 for value in row):
                raise InputError(f"merging.weights of {name} is {list(row)}; give {K} numbers of at least 0.")

    def __call__(self, seen: Mapping[str, Segmentation]) -> Segmentation:
        """One segmentation from those of all segmenters, by name.

        Where there is no surface is decided by weight among those that say something about a pixel: a detector that
        found nothing there does not speak against the sky.

        Raises:
            InputError: weights of a segmenter that takes no part, or segmentations of different sizes.
        """
        strange = sorted(self.weights.keys() - seen.keys())
        if strange:
            raise InputError(f"merging.weights names {strange[0]}, but the segmenters are: {', '.join(sorted(seen))}.")
        if len(seen) == 1 and not self.weights:
            return next(iter(seen.values()))
        names = sorted(seen)  # so that rounding does not depend on the order either
        shapes = {seen[name].evidence.shape for name in names}
        if len(shapes) != 1:
            raise InputError(
                f"the segmenters gave evidence of different shapes: {', '.join(map(str, sorted(shapes)))}."
            )
        shape = shapes.pop()
        total, sky, ground = np.zeros(shape), np.zeros(shape[:2]), np.zeros(shape[:2])
        for name in names:
            weight = np.array(self.weights.get(name, (1.0,) * K))
            weighted = seen[name].evidence * weight
            total += weighted
            sky += weight.mean() * seen[name].no_surface
            ground += np.where(seen[name].no_surface, 0, weighted.sum(-1))
        no_surface = sky > ground
        evidence = (total / np.maximum(total.sum(-1, keepdims=True), 1)).astype(np.float32)
        evidence[no_surface] = 0
        doubts = tuple(dict.fromkeys(f"{name}: {text}" for name in names for text in seen[name].doubts))
        return Segmentation(evidence, no_surface, doubts)


def calibrate(
    seen: Sequence[Mapping[str, Segmentation]], truths: Sequence[UInt8[np.ndarray, "H W"]]
) -> dict[str, tuple[float, ...]]:
    """Weights under which the merged evidence makes the true classes of labelled pictures most likely.

    The doubt (what is missing to 1) is shared by all classes alike, so abstaining costs as much as it should. Classes
    count by the square root of their share: by their share alone a machine of 1 % of the pixels would not matter, and
    with all alike the ground would be given away for it. Deterministic: pixels are taken at even steps.

    Args:
        seen: what every segmenter said about each picture; the same segmenters each time.
        truths: task class 1..5 of every pixel; other values are not used.

    Returns:
        Weights for ``Merging``, between 1/4 and 4; 1 in channels of which the truth has too little to tell.

    Raises:
        InputError: no labelled pixel, or pictures seen by different segmenters.
    """
    from scipy.optimize import minimize

    names = sorted(seen[0]) if seen else []
    if any(sorted(one) != names for one in seen):
        raise InputError("every picture must have been seen by the same segmenters; calibrate on those that were.")
    labels = np.concatenate([np.ravel(truth) for truth in truths]) if truths else np.zeros(0, np.uint8)
    counts = np.bincount(labels, minlength=256)[1 : K + 1]
    if not counts.any() or len(seen) != len(truths):
        raise InputError(f"{len(seen)} pictures and {len(truths)} truths hold no pixel of a task class; give both.")
    use = np.concatenate([_spread(np.flatnonzero(labels == k)) for k in range(1, K + 1)])
    evidence = np.stack([np.concatenate([one[n].evidence.reshape(-1, K) for one in seen])[use] for n in names])
    true = labels[use].astype(int) - 1
    share = np.bincount(true, minlength=K)
    importance = (counts[true] / counts.sum()) ** SHARE / share[true]
    free = np.tile(counts >= FEWEST, len(names))
    bounds = [(-np.log(FURTHEST), np.log(FURTHEST)) if one else (0.0, 0.0) for one in free]
    found = minimize(
        _unlikeliness, np.zeros(len(free)), (evidence.astype(float), true, importance), "L-BFGS-B", True, bounds=bounds
    )
    weights = np.exp(found.x).reshape(len(names), K)
    return {name: tuple(round(float(value), 3) for value in row) for name, row in zip(names, weights, strict=True)}


def _spread(index: np.ndarray) -> np.ndarray:
    """At most ``ENOUGH`` of them, at even steps."""
    return index[np.linspace(0, len(index) - 1, min(len(index), ENOUGH)).round().astype(int)]


def _unlikeliness(
    logs: Float64[np.ndarray, "SK"],
    evidence: Float64[np.ndarray, "S n K"],
    true: np.ndarray,
    importance: Float64[np.ndarray, "n"],
) -> tuple[float, Float64[np.ndarray, "SK"]]:
    """Mean of -log p(true class), and its gradient over the logarithms of the weights."""
    weights = np.exp(logs).reshape(len(evidence), 1, K)
    parts = evidence * weights
    rows = np.arange(len(true))
    merged = parts.sum(0)
    total, hit = merged.sum(1), merged[rows, true]
    sure = total > 1
    p = np.maximum(np.where(sure, hit / np.maximum(total, 1), hit + (1 - total) / K), 1e-6)
    # p = hit / total above 1, hit + (1 - total) / K below; slopes of p over hit and over total
    of_hit = np.where(sure, 1 / np.maximum(total, 1), 1.0)
    of_total = np.where(sure, -hit / np.maximum(total, 1) ** 2, -1 / K)
    scale = np.where(p > 1e-6, importance / importance.sum() / p, 0)
    slope = np.einsum("snk,n->sk", parts, scale * of_total)
    for source in range(len(evidence)):
        slope[source] += np.bincount(true, parts[source, rows, true] * scale * of_hit, minlength=K)
    loss = -float(importance @ np.log(p)) / float(importance.sum())
    return loss, -slope.ravel()
