"""Geometric support: local geometry of voxels, the terrain envelope, the objects that stand off it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Int32

from excavatwin.scene.grid import Grid


@dataclass(frozen=True)
class LocalGeometry:
    """Covariance features of every voxel's neighbourhood (eq:cov) and the spatial-outlier flag (eq:outlier)."""

    normal: Float32[np.ndarray, "J 3"]
    """n_i, unit, pointing up."""
    roughness: Float32[np.ndarray, "J"]
    """r_i = sqrt(lambda_1) [m]."""
    curvature: Float32[np.ndarray, "J"]
    """kappa_i = lambda_1 / sum(lambda), in [0, 1/3]."""
    slope: Float32[np.ndarray, "J"]
    """theta_i, angle between normal and vertical, in [0, pi/2] [rad]."""
    height_variance: Float32[np.ndarray, "J"]
    """Variance of the heights in the neighbourhood [m^2]."""
    discontinuity: Float32[np.ndarray, "J"]
    """Median absolute distance to the local tangent plane [m]."""
    inlier: Bool[np.ndarray, "J"]
    """False for spatial outliers."""


@dataclass(frozen=True)
class Terrain:
    """The terrain envelope."""

    grid: Grid
    """Cells of the reference surface."""
    reference: Float32[np.ndarray, "Y X"]
    """Reference elevation of every observed cell; NaN elsewhere [m]."""
    region: Int32[np.ndarray, "Y X"]
    """Connected terrain region of a cell by eq:gc_continuity, 1 = largest; 0 = not terrain."""
    ground: Float32[np.ndarray, "Y X"]
    """Terrain surface carried on below objects and over gaps, everywhere finite [m]."""
    member: Bool[np.ndarray, "J"]
    """Voxels with terrain support."""
    height: Float32[np.ndarray, "J"]
    """Height above ``ground`` [m]."""


@dataclass(frozen=True)
class ObjectSupport:
    """Object-level components of the non-terrain voxels."""

    component: Int32[np.ndarray, "J"]
    """Component id from 1; 0 = none."""
    task_class: Int32[np.ndarray, "J"]
    """Class c_i whose evidence put the voxel into its component; 0 = none."""
