"""Which way is up: from the backbone where it knows, else from the cameras and the ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from excavatwin.scene.frames import rotation_between
from excavatwin.scene.observations import Observations


@dataclass(frozen=True)
class Gravity:
    """Rotate the reconstruction so that z points up (the paper's "gravity-aligned coordinate frame")."""

    min_spread: float = 0.05
    """Least variance of the cameras' x-axes along their second direction, of 1: below it they are too parallel to
    span the horizontal plane, and the ground plane decides."""

    def __call__(self, observations: Observations) -> tuple[Float64[np.ndarray, "3 3"], tuple[str, ...]]:
        """Rotation of frame R into frame G, and doubts about it."""
        if observations.up is not None:
            return rotation_between(observations.up, np.array([0.0, 0.0, 1.0])), ()
        poses = np.stack([view.T_R_cam for view in observations.views])
        x_axes, forward, image_up = poses[:, :3, 0], poses[:, :3, 2], -poses[:, :3, 1]
        variance, axes = np.linalg.eigh(x_axes.T @ x_axes / len(x_axes))
        if variance[1] >= self.min_spread:  # a level camera's x-axis is horizontal: up is normal to all of them
            up, how = axes[:, 0], "assuming that the cameras were held level"
        else:
            up, how = _ground_normal(observations), "assuming that the ground is level on the whole"
        if (image_up.mean(axis=0) - forward.mean(axis=0)) @ up < 0:  # cameras stand upright and look down
            up = -up
        doubt = f"the observations do not say which way is up: taken from the cameras, {how}."
        return rotation_between(up, np.array([0.0, 0.0, 1.0])), (doubt,)


@dataclass(frozen=True)
class KeepFrame:
    """Identity twin: the reconstruction's z is up already."""

    def __call__(self, observations: Observations) -> tuple[Float64[np.ndarray, "3 3"], tuple[str, ...]]:
        """The identity."""
        return np.eye(3), ()


def _ground_normal(observations: Observations, samples: int = 20_000, rounds: int = 10) -> Float64[np.ndarray, "3"]:
    """Normal of the dominant plane by iteratively re-weighted least squares (Cauchy weights)."""
    valid = [view.points[np.isfinite(view.points).all(axis=-1)] for view in observations.views]
    xyz = np.concatenate(valid).astype(np.float64)
    xyz = xyz[:: max(1, len(xyz) // samples)]
    weight = np.ones(len(xyz))
    normal = np.array([0.0, 0.0, 1.0])
    for _ in range(rounds):
        centred = xyz - (weight[:, None] * xyz).sum(axis=0) / weight.sum()
        _, vectors = np.linalg.eigh((weight[:, None] * centred).T @ centred)
        normal = vectors[:, 0]
        residual = np.abs(centred @ normal)
        weight = 1.0 / (1.0 + (residual / (1.4826 * np.median(residual) + 1e-12)) ** 2)
    return normal
