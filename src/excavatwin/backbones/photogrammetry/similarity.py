"""Similarity transforms between camera centres and their GPS positions, and how well they are determined."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from excavatwin.scene.frames import umeyama

TRIALS = 300
"""Random minimal sets of the robust start."""
CORRELATED = 3.0
"""So many neighbouring GPS errors count as one: a receiver drifts, it does not toss coins."""


@dataclass(frozen=True)
class Similarity:
    """``target = scale * rotation @ source + translation``, with its fit."""

    scale: float
    rotation: Float64[np.ndarray, "d d"]
    translation: Float64[np.ndarray, "d"]
    inliers: Bool[np.ndarray, "n"]
    """Pairs that were not rejected as outliers."""
    residual: float
    """RMS length of the residuals of the inliers [units of the target]."""
    sigma: float
    """The same per axis and corrected for the parameters that were fitted [units of the target]."""

    def apply(self, p: Float64[np.ndarray, "*n d"]) -> Float64[np.ndarray, "*n d"]:
        """Points of the source frame in the target frame."""
        return self.scale * p @ self.rotation.T + self.translation


def fit_similarity(
    source: Float64[np.ndarray, "n d"], target: Float64[np.ndarray, "n d"], seed: int = 0
) -> Similarity | None:
    """Robust similarity in 2 or 3 dimensions; None if n < d + 1.

    Least median of squares (Rousseeuw 1984) starts it, with up to half of the pairs spoilt; reweighting (Cauchy) then
    gives the good ones their full precision.
    """
    n, d = source.shape
    if n < d + 1:
        return None
    rng = np.random.default_rng(seed)
    best, best_score = np.full(n, np.inf), np.inf
    for _ in range(TRIALS):
        pick = rng.choice(n, d, replace=False)
        s, R, t = umeyama(source[pick], target[pick], np.ones(d))
        error = np.linalg.norm(s * source @ R.T + t - target, axis=1)
        score = float(np.partition(error, n // 2)[n // 2])
        if score < best_score:
            best, best_score = error, score
    error = best
    for _ in range(20):
        spread = max(1.4826 * float(np.median(error)), 1e-9)
        weight = np.where(error < 6 * spread, 1 / (1 + (error / (2 * spread)) ** 2), 0.0)
        s, R, t = umeyama(source, target, weight)
        error = np.linalg.norm(s * source @ R.T + t - target, axis=1)
    inliers = error <= max(6 * 1.4826 * float(np.median(error)), 1e-9)
    square = float((error[inliers] ** 2).sum())
    m = int(inliers.sum())
    freedom = max(m * d - (d + 1 + d * (d - 1) // 2), 1)
    return Similarity(s, R, t, inliers, float(np.sqrt(square / m)), float(np.sqrt(square / freedom)))


def tilt_doubt(fit: Similarity, source: Float64[np.ndarray, "n 3"]) -> float:
    """Standard deviation of the target's vertical as the fit finds it [deg]: huge when the points lie on one line.

    A small rotation w moves a point p by w x p, so that its information is the sum of |p|² I - p pᵀ.
    """
    p = fit.apply(source[fit.inliers])
    p = p - p.mean(0)
    information = (p**2).sum() * np.eye(3) - p.T @ p
    covariance = np.linalg.pinv(information + 1e-12 * np.trace(information) * np.eye(3)) * fit.sigma**2 * CORRELATED
    return float(np.degrees(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1])))


def scale_doubt(fit: Similarity, source: Float64[np.ndarray, "n d"]) -> float:
    """Relative standard deviation of the scale; in two dimensions also that of the direction in radians."""
    p = fit.apply(source[fit.inliers])
    p = p - p.mean(0)
    return float(fit.sigma * np.sqrt(CORRELATED / max((p**2).sum(), 1e-300)))
