"""The fused semantic vote (eq:vote)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from excavatwin.accumulation import per_voxel
from excavatwin.paper import equation
from excavatwin.scene.voxels import Voxels


@dataclass(frozen=True)
class Vote:
    """Reliability-weighted mean of what the views say."""

    epsilon: float = 0.02
    """Weight of one more view that says nothing: keeps a single doubtful view from looking certain."""

    def __call__(
        self, voxels: Voxels, evidence: Float32[np.ndarray, "M K"], weight: Float32[np.ndarray, "M"]
    ) -> Float32[np.ndarray, "J K"]:
        """v_j(k) of every voxel."""
        return vote(voxels, evidence, weight, self.epsilon)


@equation("eq:vote")
def vote(
    voxels: Voxels, evidence: Float32[np.ndarray, "M K"], weight: Float32[np.ndarray, "M"], epsilon: float
) -> Float32[np.ndarray, "J K"]:
    """v_j(k) = sum_s w_js e_js(k) / (sum_s w_js + epsilon), over the views s that observe voxel j."""
    w = weight[:, None].astype(np.float64)
    return (per_voxel(voxels, w * evidence) / (per_voxel(voxels, w) + epsilon)).astype(np.float32)
