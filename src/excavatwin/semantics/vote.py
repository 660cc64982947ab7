"""The fused semantic vote (eq:vote)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32

from excavatwin.paper import equation
from excavatwin.scene.accumulation import per_voxel
from excavatwin.scene.voxels import Voxels


@equation("eq:vote")
def vote(
    voxels: Voxels, evidence: Float32[np.ndarray, "M K"], weight: Float32[np.ndarray, "M"], epsilon: float
) -> Float32[np.ndarray, "J K"]:
    """v_j(k) = sum_s w_js e_js(k) / (sum_s w_js + epsilon), over the views s that observe voxel j."""
    w = weight[:, None].astype(np.float64)
    return (per_voxel(voxels, w * evidence) / (per_voxel(voxels, w) + epsilon)).astype(np.float32)
