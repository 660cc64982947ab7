"""Local geometric features (eq:cov)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int32

from excavatwin.paper import equation
from excavatwin.scene.support import LocalGeometry
from excavatwin.scene.voxels import Voxels


@dataclass(frozen=True)
class CovarianceFeatures:
    """Covariance-based surface analysis of every voxel's neighbourhood (Pauly et al., 2002)."""

    def __call__(self, voxels: Voxels) -> LocalGeometry:
        """Features of N_j = {j} and its k neighbours; every voxel is an inlier so far."""
        normal, eigenvalues, height_variance, discontinuity = covariance_features(voxels.centre, voxels.neighbours)
        return LocalGeometry(
            normal=normal,
            roughness=np.sqrt(eigenvalues[:, 0]),
            curvature=surface_variation(eigenvalues),
            slope=np.arccos(np.clip(normal[:, 2], 0.0, 1.0)),
            height_variance=height_variance,
            discontinuity=discontinuity,
            inlier=np.ones(len(voxels), bool),
        )


@dataclass(frozen=True)
class NoLocalGeometry:
    """Identity twin ("w/o Local geometry"): every voxel is a flat, smooth inlier."""

    def __call__(self, voxels: Voxels) -> LocalGeometry:
        """Features of a horizontal plane."""
        zero = np.zeros(len(voxels), np.float32)
        up = np.zeros((len(voxels), 3), np.float32)
        up[:, 2] = 1.0
        return LocalGeometry(up, zero, zero, zero, zero, zero, np.ones(len(voxels), bool))


@equation("eq:cov")
def covariance_features(
    xyz: Float32[np.ndarray, "J 3"], neighbours: Int32[np.ndarray, "J k"]
) -> tuple[Float32[np.ndarray, "J 3"], Float32[np.ndarray, "J 3"], Float32[np.ndarray, "J"], Float32[np.ndarray, "J"]]:
    """Eigen-decomposition of the neighbourhood covariance C_i = mean((p - p_bar)(p - p_bar)^T).

    Returns:
        (normal n_i = v_{i,1}, upward; eigenvalues lambda_{i,1..3} ascending [m^2]; height variance [m^2];
        median absolute distance to the tangent plane [m]).
    """
    from excavatwin.kernels.covariance import local_features

    return local_features(xyz, neighbours)


def surface_variation(eigenvalues: Float[np.ndarray, "J 3"]) -> Float[np.ndarray, "J"]:
    """kappa_i = lambda_1 / (lambda_1 + lambda_2 + lambda_3); 0 for a single point."""
    total = eigenvalues.sum(axis=1)
    return np.divide(eigenvalues[:, 0], total, out=np.zeros_like(total), where=total > 0)
