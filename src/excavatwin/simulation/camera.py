"""Pinhole cameras and the orbit of a drone that looks at one place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera without distortion; the principal point is the middle of the image."""

    width: int
    height: int
    focal: float
    """[px]"""
    T_M_cam: Float64[np.ndarray, "4 4"]
    """Camera-to-map pose, OpenCV axes [m]."""

    @property
    def K_cam(self) -> Float64[np.ndarray, "3 3"]:
        """Intrinsics; pixel centres at +0.5 [px]."""
        return np.array([[self.focal, 0, self.width / 2], [0, self.focal, self.height / 2], [0, 0, 1.0]])

    def resized(self, width: int) -> Camera:
        """The same camera with another number of pixels over the same field of view."""
        scale = width / self.width
        return Camera(width, int(round(self.height * scale)), self.focal * scale, self.T_M_cam)


def look_at(
    eye: Float64[np.ndarray, "3"], target: Float64[np.ndarray, "3"], roll: float = 0.0
) -> Float64[np.ndarray, "4 4"]:
    """Camera-to-map pose at ``eye`` with the optical axis through ``target``, rolled by ``roll`` [rad]."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    c, s = np.cos(roll), np.sin(roll)
    T = np.eye(4)
    T[:3, :3] = np.stack([c * right + s * down, c * down - s * right, forward], axis=1)
    T[:3, 3] = eye
    return T


def orbit(
    views: int = 14,
    radius: float = 22.0,
    height: float = 18.0,
    width: int = 1280,
    aspect: float = 0.75,
    focal_ratio: float = 0.78,
    jitter: float = 1.0,
    seed: int = 7,
) -> tuple[Camera, ...]:
    """Cameras on a circle about the site's centre, clockwise from north, looking at it.

    Args:
        radius: horizontal distance from the centre [m].
        height: above z = 0 [m].
        focal_ratio: focal length over image width.
        jitter: scale of the drone's deviations (0.6 m in position, 0.8 m in the point it looks at, 1 degree of roll).
    """
    rng = np.random.default_rng(seed)
    cameras = []
    for k in range(views):
        azimuth = 2 * np.pi * (k + 0.3 * jitter * rng.uniform(-0.5, 0.5)) / views
        eye = np.array([radius * np.sin(azimuth), radius * np.cos(azimuth), height]) + jitter * rng.normal(0, 0.6, 3)
        target = jitter * rng.normal(0, 0.8, 3) * np.array([1, 1, 0.2])
        pose = look_at(eye, target, jitter * np.deg2rad(rng.normal()))
        cameras.append(Camera(width, int(round(width * aspect)), focal_ratio * width, pose))
    return tuple(cameras)
