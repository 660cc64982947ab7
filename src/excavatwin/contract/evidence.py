"""Semantic evidence by its numbers alone: logits, sums above 1, arg-max only, labels that were interpolated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32

from excavatwin.contract.findings import Finding, named, refusal, report
from excavatwin.contract.labels import between
from excavatwin.scene.observations import View

#: Evidence may exceed 1 by this: sums of float32.
ROUNDING = 1e-3
#: Share of pixels whose evidence may add up to more than 1: masks that overlap a little.
_SOME = 0.005


def evidence_range(views: Sequence[View]) -> tuple[Finding, ...]:
    """What is wrong with the values of evidence, over all views together."""
    largest = {view.name: float(view.evidence.max(initial=0)) for view in views}
    if not any(largest.values()):
        return ()  # nobody has segmented yet
    over = [name for name, value in largest.items() if value > 1 + ROUNDING]
    if over:
        return (_too_large(over, largest, len(views)),)
    sums = {view.name: _sampled(view).sum(axis=-1) for view in views}
    over = [name for name, value in sums.items() if (value > 1 + ROUNDING).any()]
    if over and np.mean([(value > 1 + ROUNDING).mean() for value in sums.values()]) > _SOME:
        worst = max(float(value.max()) for value in sums.values())
        return (
            report(
                f"the evidence of {named(over, len(views))} adds up to more than 1 (up to {worst:.2f})",
                "independent scores (sigmoid, overlapping masks) are added as if they were a distribution",
                "divide by the sum where it exceeds 1",
                largest_sum=worst,
            ),
        )
    return _one_hot(views)


def _sampled(view: View) -> Float32[np.ndarray, "n K"]:
    flat = view.evidence.reshape(-1, view.evidence.shape[-1])
    return flat[:: 1 + len(flat) // 20_000]


def _too_large(over: list[str], largest: dict[str, float], total: int) -> Finding:
    worst = max(largest.values())
    what = f"the evidence of {named(over, total)} reaches {worst:.4g}; expected 0..1"
    if worst in (100.0, 255.0):
        return refusal(what, f"scores in 0..{worst:.0f}", f"divide them by {worst:.0f}", largest=worst)
    return refusal(
        what,
        "logits are given as evidence",
        "apply softmax (or sigmoid) over the model's classes before they are mapped to task classes",
        largest=worst,
    )


def _one_hot(views: Sequence[View]) -> tuple[Finding, ...]:
    """Evidence that is nothing but labels says nothing about its doubts; and labels may have been interpolated."""
    sampled = [_sampled(view) for view in views]
    if any(((e > 0).sum(axis=-1) > 1).any() for e in sampled):
        return ()
    values = np.concatenate([e.max(axis=-1) for e in sampled])
    if np.ptp(values[values > 0]) > 0.01:
        return ()
    rings = [view.name for view in views if between(_labels(view)) is not None]
    if 2 * len(rings) > len(views):
        return (
            refusal(
                f"the evidence of {named(rings, len(views))} has rings of other classes around its regions",
                "the labels were resized with interpolation: values between two ids are other classes",
                "resize label images by nearest neighbour (Pillow NEAREST, cv2.INTER_NEAREST)",
            ),
        )
    return (
        report(
            "the evidence is arg-max only: one class at each pixel with one and the same score",
            remedy="give the model's probabilities if it has them; doubt about classes cannot be weighed otherwise",
        ),
    )


def _labels(view: View) -> np.ndarray:
    return np.where(view.evidence.any(axis=-1), view.evidence.argmax(axis=-1) + 1, 0)
