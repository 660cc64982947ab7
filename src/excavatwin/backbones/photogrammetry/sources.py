"""Which photos a photo is matched against: common sparse points, seen under a useful angle, from all sides."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from excavatwin.backbones.photogrammetry.placement import PosedImage, SparsePoints


def pair_scores(
    images: Sequence[PosedImage], sparse: SparsePoints, angle_min: float, angle_best: float, angle_max: float
) -> Float64[np.ndarray, "S S"]:
    """How well view s serves as a source of view r, at [r, s]: a sum over their common sparse points.

    A point counts 1 when its rays meet under ``angle_best`` [deg], less towards ``angle_min`` and ``angle_max``, and
    less when the source sees it much smaller or larger. In the spirit of the view selection of MVSNet (Yao et al.,
    ECCV 2018).
    """
    n = len(images)
    centres = np.array([image.T_R_cam[:3, 3] for image in images])
    focal = np.array([image.K_cam[0, 0] for image in images])
    seen = np.zeros((n, len(sparse.xyz)), bool)
    for s, index in enumerate(sparse.visible):
        seen[s, index] = True
    scores = np.zeros((n, n))
    for r in range(n):
        index = np.asarray(sparse.visible[r])
        rays = sparse.xyz[index] - centres[r]
        distance = np.linalg.norm(rays, axis=1)
        for s in range(n):
            both = seen[s, index]
            if s == r or both.sum() < 8:
                continue
            other = sparse.xyz[index[both]] - centres[s]
            reach = np.linalg.norm(other, axis=1)
            cosine = (rays[both] * other).sum(1) / np.maximum(distance[both] * reach, 1e-12)
            angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
            width = np.where(angle < angle_best, (angle_best - angle_min) / 2, (angle_max - angle_best) / 2)
            weight = np.exp(-0.5 * ((angle - angle_best) / width) ** 2)
            zoom = np.log2(focal[s] / reach * distance[both] / focal[r])
            scores[r, s] = (weight * np.exp(-2 * zoom**2))[angle >= angle_min / 2].sum()
    return scores


def choose_sources(
    reference: int, scores: Float64[np.ndarray, "S S"], images: Sequence[PosedImage], count: int
) -> list[int]:
    """The best ``count`` sources of a view, each on another side where possible: what one cannot see, another can."""
    row = scores[reference].copy()
    centre = images[reference].T_R_cam[:3, 3]
    offsets = np.array([image.T_R_cam[:3, 3] - centre for image in images])
    length = np.linalg.norm(offsets, axis=1, keepdims=True)
    direction = offsets / np.where(length > 0, length, 1)
    least = 0.05 * row.max()
    chosen: list[int] = []
    while len(chosen) < count:
        crowding = (np.maximum(direction @ direction[chosen].T, 0) ** 2).sum(1) if chosen else np.zeros(len(images))
        gain = row / (1 + crowding)
        gain[chosen] = 0
        best = int(np.argmax(gain))
        if row[best] <= least or gain[best] <= 0:
            break
        chosen.append(best)
    return chosen


def neighbours(reference: int, scores: Float64[np.ndarray, "S S"], count: int) -> list[int]:
    """The views that a depth map is checked against, best first."""
    order = np.argsort(-scores[reference], kind="stable")[:count]
    return [int(s) for s in order if scores[reference, s] > 0]
