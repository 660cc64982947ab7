"""The similarity between two chunks, from the photos that both have seen: the same pixel is the same place.

Robust: random sampling (RANSAC with truncated residuals, Torr and Zisserman 2000) starts it, reweighting (Tukey)
refines it. Residuals are measured as shares of the distance from the camera, because so are the errors of networks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from excavatwin.backbones.sequence.similarities import Matrix, similarity
from excavatwin.backbones.sequence.store import Chunk
from excavatwin.scene.frames import umeyama

SAMPLES = 1500
"""Pixels of each shared photo that take part."""
TRIALS = 300
SCORED = 1500
"""Pairs on which a trial is scored."""
CAMERAS = 0.2
"""Weight of a photo's camera against that of all its points: its position and axes are four more pairs."""
TUKEY = 4.685
ROUNDS = 30
LEAST_PAIRS = 20
ROUNDING = 1e-6
"""Residuals of points in float32 are at least of this order."""


@dataclass(frozen=True)
class Pairs:
    """Points of frame b and the same points in frame a."""

    a: Float64[np.ndarray, "n 3"]
    b: Float64[np.ndarray, "n 3"]
    distance: Float64[np.ndarray, "n"]
    """Of the point in frame a from its camera: the unit of its residual [su of a]."""
    weight: Float64[np.ndarray, "n"]
    """>= 0."""

    def residual(self, S_a_b: Matrix) -> Float64[np.ndarray, "n"]:
        """By how much the pairs miss each other, as a share of the distance."""
        return np.linalg.norm(self.b @ S_a_b[:3, :3].T + S_a_b[:3, 3] - self.a, axis=1) / self.distance


@dataclass(frozen=True)
class Alignment:
    """A similarity that was measured."""

    S_a_b: Matrix
    """From frame b into frame a."""
    agreeing: float
    """Share of the pairs (by weight) that agree with it to the tolerance."""
    miss: float
    """Median residual of the pairs, as a share of the distance (by weight)."""
    middle: Float64[np.ndarray, "3"]
    """Of the agreeing points, in frame b."""
    reach: float
    """Their root mean square distance from it [su of b]."""


def shared_pairs(a: Chunk, b: Chunk) -> tuple[Pairs, Pairs]:
    """Pairs of points, and of cameras, of the photos that two chunks share and that are sound in both."""
    photos = [photo for photo in a.photos if photo in b.photos and photo not in a.faults and photo not in b.faults]
    points, cameras = [], []
    for photo in photos:
        at, p_a = a.sample(photo, SAMPLES)
        _, p_b = b.sample(photo, SAMPLES)
        rank = np.minimum(ranks(a.confidence(photo), at, p_a), ranks(b.confidence(photo), at, p_b))
        use = rank > 0
        if use.sum() < LEAST_PAIRS:
            continue
        T_a, T_b = a.T_C_cam[a.at(photo)], b.T_C_cam[b.at(photo)]
        d_a = np.linalg.norm(p_a[use] - T_a[:3, 3], axis=1)
        d_b = np.linalg.norm(p_b[use] - T_b[:3, 3], axis=1)
        points.append(Pairs(p_a[use], p_b[use], np.maximum(d_a, 1e-12), rank[use]))
        cameras.append(_camera(T_a, T_b, float(np.median(d_a)), float(np.median(d_b)), float(rank[use].sum())))
    return joined(points), joined(cameras)


def joined(pairs: Sequence[Pairs]) -> Pairs:
    """All of them."""
    if not pairs:
        return Pairs(np.empty((0, 3)), np.empty((0, 3)), np.empty(0), np.empty(0))
    fields = (np.concatenate([getattr(one, name) for one in pairs]) for name in ("a", "b", "distance", "weight"))
    return Pairs(*fields)


def ranks(confidence: np.ndarray, at: np.ndarray, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n"]:
    """Rank of the confidence among the pixels ``at`` that have a point, in (0, 1]; equal confidences rank equally.

    Scales of confidence differ between networks, their order does not. 0 where there is no point.
    """
    there = np.isfinite(points).all(axis=1)
    found = np.zeros(len(at))
    values = np.asarray(confidence.reshape(-1)[at], float)[there]
    found[there] = np.searchsorted(np.sort(values), values, side="right") / max(len(values), 1)
    return found


def align(points: Pairs, cameras: Pairs, tolerance: float, seed: int = 0) -> Alignment | None:
    """The similarity that most pairs agree on; None when there are too few of them.

    Args:
        points: pairs among which there may be outliers.
        cameras: pairs that refine it (may be empty).
        tolerance: residual up to which a pair agrees, as a share of its distance.
        seed: of the random sampling.
    """
    if len(points.a) < LEAST_PAIRS:
        return None
    S = _start(points, tolerance, seed)
    both = joined([points, cameras])
    for _ in range(ROUNDS):
        residual = both.residual(S)
        near = residual[: len(points.a)] <= tolerance  # the spread of what agrees: half of the rest may be anywhere
        spread = 1.4826 * _median(residual[: len(points.a)][near], points.weight[near]) if near.any() else tolerance
        limit = max(min(TUKEY * spread, 2 * tolerance), ROUNDING)
        weight = both.weight * np.clip(1 - (residual / limit) ** 2, 0, None) ** 2 / both.distance**2
        if (weight > 0).sum() < LEAST_PAIRS:
            break
        refined = similarity(*umeyama(both.b, both.a, weight))
        step = float(np.abs(refined - S).max() / max(np.abs(refined).max(), 1e-300))
        S = refined
        if step < 1e-12:
            break
    residual = points.residual(S)
    agrees = residual <= tolerance
    middle = points.b[agrees].mean(0) if agrees.any() else points.b.mean(0)
    reach = float(np.sqrt(((points.b[agrees] - middle) ** 2).sum(1).mean())) if agrees.any() else 0.0
    share = float(points.weight[agrees].sum() / points.weight.sum())
    return Alignment(S, share, _median(residual, points.weight), middle, reach)


def _start(pairs: Pairs, tolerance: float, seed: int) -> Matrix:
    """Of many similarities through three pairs the one with the least truncated residual."""
    rng = np.random.default_rng(seed)
    chance = pairs.weight / pairs.weight.sum()
    at = rng.choice(len(chance), min(SCORED, len(chance)), replace=False, p=chance if (chance > 0).all() else None)
    scored = Pairs(pairs.a[at], pairs.b[at], pairs.distance[at], pairs.weight[at])
    best, least = np.eye(4), np.inf
    for _ in range(TRIALS):
        three = rng.choice(len(at), 3, replace=False)
        S = similarity(*umeyama(scored.b[three], scored.a[three], np.ones(3)))
        cost = float((scored.weight * np.minimum(scored.residual(S) / tolerance, 1.0) ** 2).sum())
        if cost < least:
            best, least = S, cost
    return best


def _camera(T_a: Matrix, T_b: Matrix, d_a: float, d_b: float, weight: float) -> Pairs:
    """Position of a camera, and the ends of its axes at the distance of the scene, in both frames."""
    ends = np.vstack([np.zeros(3), np.eye(3)])
    a = T_a[:3, 3] + d_a * ends @ T_a[:3, :3].T
    b = T_b[:3, 3] + d_b * ends @ T_b[:3, :3].T
    return Pairs(a, b, np.full(4, d_a), np.full(4, CAMERAS * weight / 4))


def _median(values: Float64[np.ndarray, "n"], weight: Float64[np.ndarray, "n"]) -> float:
    """The value that half of the weight lies below."""
    order = np.argsort(values)
    below = np.cumsum(weight[order])
    return float(values[order[np.searchsorted(below, below[-1] / 2)]])
