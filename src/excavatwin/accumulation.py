"""From view samples to voxels."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float32

from excavatwin.scene.voxels import Voxels


def accumulate(
    voxels: Voxels, evidence: Float32[np.ndarray, "M K"]
) -> tuple[Float32[np.ndarray, "J K"], Float32[np.ndarray, "J"]]:
    """Mean evidence over the views that said anything, and mean reconstruction confidence, of every voxel."""
    spoke = evidence.any(axis=1)
    views = np.maximum(np.bincount(voxels.voxel[spoke], minlength=len(voxels)), 1)
    e = per_voxel(voxels, evidence) / views[:, None]
    phi = np.bincount(voxels.voxel, voxels.confidence, len(voxels)) / np.bincount(voxels.voxel, minlength=len(voxels))
    return e.astype(np.float32), phi.astype(np.float32)


def per_voxel(voxels: Voxels, values: Float[np.ndarray, "M C"]) -> Float[np.ndarray, "J C"]:
    """Sum of the rows of the view samples of every voxel, in float64."""
    J = len(voxels)
    return np.stack([np.bincount(voxels.voxel, values[:, c], J) for c in range(values.shape[1])], axis=1)
