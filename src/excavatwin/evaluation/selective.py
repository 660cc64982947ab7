"""What a confidence is worth: risk against coverage, and calibration.

A *place* is a pixel, point or cell whose true class is known. Its risk is 0 or 1 (right or wrong class). Places are
accepted from the most confident down; the rest is unknown.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float64, UInt8

from excavatwin.evaluation.metric import Metric
from excavatwin.scene.taxonomy import K

BINS = 15
"""Bins of equal width over [0, 1] of the calibration error (Guo et al., ICML 2017)."""
COVERAGE = 0.95
"""Coverage at which the value of knowing what one does not know is stated."""


@dataclass(frozen=True)
class RiskCoverage:
    """Risk-coverage curve (El-Yaniv and Wiener, JMLR 2010): one entry a place that has a class, accepted in order.

    Places of equal confidence are accepted in random order; the curve is the expectation over it, so it depends on
    no order of the input.
    """

    coverage: Float64[np.ndarray, "m"]
    """Share of all places accepted so far, ascending, 0..1; it ends below 1 where places have no class at all."""
    risk: Float64[np.ndarray, "m"]
    """Share of wrong ones among the accepted, 0..1."""
    threshold: Float64[np.ndarray, "m"]
    """Confidence of the place accepted last, descending."""

    @property
    def area(self) -> float:
        """AURC (Geifman and El-Yaniv, ICLR 2019): mean risk over the curve; NaN where nothing has a class."""
        return float(self.risk.mean()) if len(self.risk) else float("nan")

    def risk_at(self, coverage: float) -> float:
        """Risk when just that share of all places is accepted; NaN where the curve ends before it."""
        k = int(np.searchsorted(self.coverage, coverage - 1e-12))
        return float(self.risk[k]) if k < len(self.risk) else float("nan")

    def thinned(self, count: int = 101) -> RiskCoverage:
        """At most ``count`` entries, evenly spaced, with the first and the last: for files and pictures."""
        if len(self.risk) <= count:
            return self
        keep = np.unique(np.round(np.linspace(0, len(self.risk) - 1, count)).astype(int))
        return RiskCoverage(self.coverage[keep], self.risk[keep], self.threshold[keep])


def valid_places(true: UInt8[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
    """Places whose true class is known: 1..K."""
    return (true >= 1) & (true <= K)


def risk_coverage(
    predicted: UInt8[np.ndarray, "n"], true: UInt8[np.ndarray, "n"], confidence: Float[np.ndarray, "n"]
) -> RiskCoverage:
    """The curve of classes with their confidences.

    Args:
        predicted: class 1..K; anything else has no class and is never accepted. Give the *forced* arg-max here to
            have the whole curve, up to the risk of forced arg-max at its end.
        true: class 1..K; places with another value are left out.
        confidence: any order-preserving score; a NaN is the lowest.
    """
    valid = valid_places(true)
    total = int(valid.sum())
    labelled = valid & (predicted >= 1) & (predicted <= K)
    score = np.nan_to_num(confidence[labelled].astype(float), nan=-np.inf, posinf=np.inf, neginf=-np.inf)
    order = np.argsort(-score, kind="stable")
    score, wrong = score[order], (predicted[labelled] != true[labelled])[order].astype(float)
    if not len(score):
        return RiskCoverage(np.zeros(0), np.zeros(0), np.zeros(0))
    start = np.flatnonzero(np.r_[True, score[1:] != score[:-1]])
    size = np.diff(np.r_[start, len(score)])
    wrong = np.repeat(np.add.reduceat(wrong, start) / size, size)  # expectation over the order of ties
    accepted = np.arange(1, len(score) + 1)
    return RiskCoverage(accepted / total, np.cumsum(wrong) / accepted, score)


def expected_calibration_error(
    right: Bool[np.ndarray, "n"], confidence: Float[np.ndarray, "n"], bins: int = BINS
) -> float:
    """ECE: mean over equal-width bins of |share of right ones - mean confidence|, weighted by their counts, 0..1.

    Confidences outside [0, 1] are clipped, NaN ones left out. NaN of nothing.
    """
    known = np.isfinite(confidence)
    if not known.any():
        return float("nan")
    stated, hit = np.clip(confidence[known].astype(float), 0, 1), right[known].astype(float)
    index = np.minimum((stated * bins).astype(int), bins - 1)
    gap = np.bincount(index, hit, bins) - np.bincount(index, stated, bins)
    return float(np.abs(gap).sum() / len(stated))


def selective_metrics(
    name: str,
    predicted: UInt8[np.ndarray, "n"],
    true: UInt8[np.ndarray, "n"],
    confidence: Float[np.ndarray, "n"],
    place: str,
    forced: UInt8[np.ndarray, "n"] | None = None,
) -> tuple[Metric, ...]:
    """AURC, risk at 95 % coverage and ECE; with ``forced`` also the risk of forced arg-max and the ratio of both.

    Args:
        forced: arg-max classes without any rejection; the curve is then drawn over them. A place where even they
            have no class is one that forced arg-max has wrong.
    """
    curve = risk_coverage(predicted if forced is None else forced, true, confidence)
    at, share = curve.risk_at(COVERAGE), f"{100 * COVERAGE:.0f}"
    figures = [
        Metric(f"{name}_aurc", 100 * curve.area, "%", f"area under the risk-coverage curve over {place}"),
        Metric(
            f"{name}_risk_at_{share}", 100 * at, "%",
            f"wrong ones among the most confident {share} % of {place}; - where fewer have a class",
        ),
    ]  # fmt: skip
    valid = valid_places(true)
    if forced is not None and valid.any():
        risk = float((forced[valid] != true[valid]).mean())
        ratio = at / risk if risk > 0 else float("nan")
        figures += [
            Metric(f"{name}_risk_forced", 100 * risk, "%", f"wrong ones of {place} under forced arg-max"),
            Metric(f"{name}_risk_ratio", ratio, "1", f"risk at {share} % coverage over that of forced arg-max"),
        ]
    labelled = valid & (predicted >= 1) & (predicted <= K)
    ece = expected_calibration_error(predicted[labelled] == true[labelled], confidence[labelled])
    figures.append(
        Metric(
            f"{name}_ece", 100 * ece, "%", f"expected calibration error of the confidence, {BINS} bins, over {place}"
        )
    )
    return tuple(figures)
