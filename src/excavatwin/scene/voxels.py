"""Voxels: the shared spatial support, and the samples that each view consolidates on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int32


@dataclass(frozen=True)
class Voxels:
    """J occupied voxels, in ascending order of their grid index, and the view samples inside them.

    A *view sample* m is what one view s has to say about one voxel j: the mean of its samples there. All that follows
    works on voxels and view samples, so that a view which samples a place densely counts no more than another.
    """

    size: float
    """Edge length [m]."""
    centre: Float32[np.ndarray, "J 3"]
    """Mean over the views of the voxel's view samples [m, frame M]."""
    of_point: Int32[np.ndarray, "N"]
    """Voxel of every sample."""
    voxel: Int32[np.ndarray, "M"]
    """j of every view sample; view samples are ordered by view, then by first appearance."""
    view: Int32[np.ndarray, "M"]
    """s of every view sample."""
    xyz: Float32[np.ndarray, "M 3"]
    """Mean position [m]."""
    confidence: Float32[np.ndarray, "M"]
    """Mean reconstruction confidence."""
    evidence: Float32[np.ndarray, "M K"]
    """Mean evidence e_{j,s}(k)."""
    rgb: Float32[np.ndarray, "J 3"]
    """Mean colour, every view counting once, 0..255."""
    footprint: Float32[np.ndarray, "J"]
    """Finest footprint of a pixel among the views that see the voxel [m]."""
    centres: Float64[np.ndarray, "S 3"]
    """Camera centres [m]."""
    neighbours: Int32[np.ndarray, "J k"]
    """N_j: the k nearest voxels, nearest first, without j itself."""
    distances: Float32[np.ndarray, "J k"]
    """Their distances [m]."""

    def __len__(self) -> int:
        return len(self.centre)
