"""Reliability w_{j,s} of what a view says about a voxel (docs/decisions/reliability.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from excavatwin.scene.support import LocalGeometry
from excavatwin.scene.voxels import Voxels


@dataclass(frozen=True)
class Reliability:
    """Product of semantic confidence, reconstruction confidence, viewing angle and camera distance.

    Each term lies in [floor, 1]. The first weighs a view by how much it has to say, so that views in which the
    segmenter abstains do not dilute the ones in which it does not.
    """

    floor: float = 0.05
    """Least value of each term."""
    semantic: float = 1.0
    """Exponent of the semantic confidence, the strongest evidence of the sample (clipped to 1)."""
    reconstruction: float = 0.5
    """Exponent of the reconstruction confidence, ranked among its distinct values (scales differ by backbone)."""
    angle: float = 0.5
    """Exponent of |cos| of the angle between normal and ray."""
    distance: float = 1.0
    """Exponent of (finest footprint of the voxel) / (footprint of this view), by distances."""

    def __call__(
        self, voxels: Voxels, evidence: Float32[np.ndarray, "M K"], local: LocalGeometry
    ) -> Float32[np.ndarray, "M"]:
        """w_{j,s} of every view sample."""
        ray = voxels.centres[voxels.view] - voxels.xyz
        length = np.maximum(np.linalg.norm(ray, axis=1), 1e-12)
        cosine = np.abs((ray * local.normal[voxels.voxel]).sum(axis=1)) / length
        nearest = np.full(len(voxels), np.inf)
        np.minimum.at(nearest, voxels.voxel, length)
        terms = (
            (np.minimum(evidence.max(axis=1), 1.0), self.semantic),
            (distinct_rank(voxels.confidence), self.reconstruction),
            (cosine, self.angle),
            (nearest[voxels.voxel] / length, self.distance),
        )
        weight = np.ones(len(length))
        for term, exponent in terms:
            weight *= np.clip(term, self.floor, 1.0) ** exponent
        return weight.astype(np.float32)


@dataclass(frozen=True)
class Uniform:
    """Identity twin ("w/o View reliability"): every view counts the same."""

    def __call__(
        self, voxels: Voxels, evidence: Float32[np.ndarray, "M K"], local: LocalGeometry
    ) -> Float32[np.ndarray, "M"]:
        """Ones."""
        return np.ones(len(voxels.voxel), np.float32)


def distinct_rank(confidence: Float32[np.ndarray, "M"]) -> Float32[np.ndarray, "M"]:
    """Rank of each value among the distinct ones, scaled to (0, 1]: free of the backbone's scale and of repetition."""
    distinct, rank = np.unique(confidence, return_inverse=True)
    return ((rank + 1) / len(distinct)).astype(np.float32)
