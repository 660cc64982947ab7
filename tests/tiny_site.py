"""A tiny dig site with exact truth, small enough for the laws of the method to be checked in seconds.

Everything is a height over (x, y): a tilted plain, a pit with vertical walls, a heap at 35 degrees, a box for a
machine, a smaller box for an obstacle and a hemisphere for a bush.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from excavatwin.scene.observations import Observations, View
from excavatwin.scene.taxonomy import TaskClass

PIT = (-5.0, -1.0, 1.0, 5.0)
"""x0, x1, y0, y1 [m]; 1.5 m deep."""
HEAP = (4.0, 4.0, 2.0)
"""x, y, height [m]; 35 degrees."""
MACHINE = (1.0, 4.0, -4.4, -2.6, 2.2)
"""x0, x1, y0, y1, height [m]."""
BLOCK = (-5.0, -3.8, -5.0, -4.0, 1.0)
BUSH = (-1.5, -4.0, 0.9)
"""x, y, radius [m]."""
HALF = 9.0
"""Half the edge of the site [m]."""


def plain(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The undisturbed ground."""
    return 0.05 * x + 0.02 * y + 0.05 * np.sin(x) * np.cos(0.7 * y)


def terrain(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Terrain without objects and cover."""
    z = plain(x, y)
    z = np.where((x > PIT[0]) & (x < PIT[1]) & (y > PIT[2]) & (y < PIT[3]), z - 1.5, z)
    cone = HEAP[2] - np.tan(np.radians(35)) * np.hypot(x - HEAP[0], y - HEAP[1])
    return z + np.maximum(cone, 0)


def surface(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Top surface and its class."""
    z = terrain(x, y)
    label = np.where(np.hypot(x, y) < 7, TaskClass.CONSTRUCTION_TERRAIN, TaskClass.OTHER_TERRAIN)
    for (x0, x1, y0, y1, h), k in ((MACHINE, TaskClass.EXCAVATOR), (BLOCK, TaskClass.OBSTACLE)):
        inside = (x > x0) & (x < x1) & (y > y0) & (y < y1)
        z = np.where(inside, plain((x0 + x1) / 2, (y0 + y1) / 2) + h, z)
        label = np.where(inside, k, label)
    r2 = (x - BUSH[0]) ** 2 + (y - BUSH[1]) ** 2
    dome = plain(*BUSH[:2]) + np.sqrt(np.maximum(BUSH[2] ** 2 - r2, 0))
    bush = (r2 < BUSH[2] ** 2) & (dome > z)
    return np.where(bush, dome, z), np.where(bush, TaskClass.REMOVABLE_COVER, label)


def look_at(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Camera-to-world pose, OpenCV axes."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    T = np.eye(4)
    T[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    T[:3, 3] = eye
    return T


def cast(eye: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """First hits of rays (n, 3) with the surface, by marching and bisection; NaN outside the site."""
    near, far = np.zeros(len(rays)), np.full(len(rays), np.nan)
    step = 0.06
    for t in np.arange(4.0, 34.0, step):
        p = eye + t * rays
        below = np.isnan(far) & (p[:, 2] < surface(p[:, 0], p[:, 1])[0])
        far[below], near[below] = t, t - step
    for _ in range(18):
        middle = (near + far) / 2
        p = eye + middle[:, None] * rays
        below = p[:, 2] < surface(p[:, 0], p[:, 1])[0]
        far, near = np.where(below, middle, far), np.where(below, near, middle)
    p = eye + far[:, None] * rays
    p[(np.abs(p[:, :2]) > HALF).any(axis=1)] = np.nan
    return p


@dataclass(frozen=True)
class Emulation:
    """How the observations depart from the truth."""

    noise: float = 0.03
    """Standard deviation along the ray [m]."""
    silent: float = 0.2
    """Share of pixels where the segmenter says nothing."""
    wrong: float = 0.15
    """Share of pixels where it names another class."""
    seed: int = 0


def observations(S: int = 8, width: int = 120, emulation: Emulation = Emulation()) -> Observations:
    """Views of an oblique orbit, with z up and metres."""
    rng = np.random.default_rng(emulation.seed)
    height, focal = width * 3 // 4, 0.8 * width
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    v, u = np.mgrid[:height, :width] + 0.5
    pixel_rays = np.stack([(u - K[0, 2]) / focal, (v - K[1, 2]) / focal, np.ones_like(u)], axis=-1).reshape(-1, 3)
    views = []
    for s in range(S):
        azimuth = 2 * np.pi * (s + 0.13) / S
        eye = np.array([13 * np.cos(azimuth), 13 * np.sin(azimuth), 12.0])
        T = look_at(eye, np.zeros(3))
        rays = pixel_rays @ T[:3, :3].T
        exact = cast(eye, rays)
        _, label = surface(*(exact[:, :2] + 1e-4 * rays[:, :2]).T)  # a hair inside, so that faces get their body
        valid = np.isfinite(exact[:, 0])
        depth_noise = rng.normal(0, emulation.noise, len(rays))
        points = exact + depth_noise[:, None] * rays / np.linalg.norm(rays, axis=1, keepdims=True)
        named = np.where(rng.random(len(rays)) < emulation.wrong, rng.integers(1, 6, len(rays)), label)
        evidence = np.zeros((len(rays), 5), np.float32)
        evidence[np.arange(len(rays)), named - 1] = 0.7 + 0.3 * rng.random(len(rays))
        evidence[(rng.random(len(rays)) < emulation.silent) | ~valid] = 0
        shape = (height, width)
        views.append(
            View(
                name=f"{s:02d}.jpg", points=points.reshape(*shape, 3).astype(np.float32),
                confidence=(1 + rng.random(shape)).astype(np.float32), evidence=evidence.reshape(*shape, 5),
                T_R_cam=T, K_cam=K, image=np.full((*shape, 3), 40 * s % 255, np.uint8),
            )
        )  # fmt: skip
    return Observations(tuple(views), up=np.array([0.0, 0.0, 1.0]), metres_per_unit=1.0)
