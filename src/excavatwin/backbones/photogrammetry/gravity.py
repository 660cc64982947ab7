"""Which way is up, from gimbal tags or from how people and drones hold cameras over ground."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from excavatwin.backbones.photogrammetry.placement import PlacedCamera
from excavatwin.scene.photo import Gimbal

ROLL = 4.0
"""Cameras are held level about their optical axis to about this [deg]."""
NADIR = 4.0
"""Cameras that look down do so to about this [deg]."""
TERRAIN = 5.0
"""The mean slope of a site is about this [deg]."""
FLIGHT = 2.0
"""Drones that look down fly level, or follow the ground, to about this [deg]."""
FLATNESS = 0.03
"""A track whose distance from its plane stays under this share of the height above ground is a level flight."""
HELD = 35.0
"""Photos are the right way up to about this: only decides what nothing else does [deg]."""
INDEPENDENT = 9
"""More cameras than this add no certainty, and cameras of one heading none at all: their mounting errs the same way."""
PLAUSIBLE = 25.0
"""Ground and cameras must agree on the vertical to this, else the ground is not believed [deg]."""


@dataclass(frozen=True)
class Up:
    """The direction against gravity in the frame of the poses."""

    direction: Float64[np.ndarray, "3"]
    doubt: float
    """Standard deviation [deg]."""
    source: str
    """``gimbal``, ``cameras`` or ``cameras and terrain``."""


def angle(a: Float64[np.ndarray, "3"], b: Float64[np.ndarray, "3"]) -> float:
    """Angle between two directions [deg]."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def unit(v: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3"]:
    """The direction of v."""
    return v / max(float(np.linalg.norm(v)), 1e-300)


def up_from_gimbal(cameras: Sequence[PlacedCamera], gimbals: Mapping[str, Gimbal]) -> Up | None:
    """The vertical that the gimbals report, as a geometric median over the cameras; None below three tags."""
    votes = []
    for camera in cameras:
        gimbal = gimbals.get(camera.name)
        if gimbal is not None:
            pitch, roll = np.radians([gimbal.pitch, gimbal.roll])
            up_cam = np.array([-np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch), np.sin(pitch)])
            votes.append(camera.T_R_cam[:3, :3] @ up_cam)
    if len(votes) < 3:
        return None
    v = np.array(votes)
    up = unit(v.mean(0))
    for _ in range(30):
        up = unit((v / np.maximum(np.linalg.norm(v - up, axis=1), 1e-6)[:, None]).sum(0))
    spread = np.median([angle(vote, up) for vote in v])
    return Up(up, float(np.hypot(0.5, spread / np.sqrt(min(len(v), INDEPENDENT)))), "gimbal")


def terrain_normal(
    points: Float64[np.ndarray, "n 3"], centres: Float64[np.ndarray, "m 3"], seed: int = 0
) -> tuple[Float64[np.ndarray, "3"], float] | None:
    """Normal of the plane that holds most sparse points, towards the cameras, and the share of points it holds.

    Random sampling (Fischler and Bolles 1981), then least squares on what lies within 3 % of the viewing distance.
    """
    if len(points) < 50:
        return None
    rng = np.random.default_rng(seed)
    height = float(np.median(np.linalg.norm(points - centres.mean(0), axis=1)))
    sample = points[rng.permutation(len(points))[:3000]]
    best, held = None, np.zeros(len(points), bool)
    most = 0
    for _ in range(400):
        a, b, c = sample[rng.choice(len(sample), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal)
        if length < 1e-12:
            continue
        count = int((np.abs((sample - a) @ (normal / length)) < 0.03 * height).sum())
        if count > most:
            most, best = count, (normal / length, a)
    if best is None:
        return None
    normal, a = best
    for _ in range(5):
        held = np.abs((points - a) @ normal) < 0.03 * height
        if held.sum() < 20:
            return None
        a = points[held].mean(0)
        normal = np.linalg.svd(points[held] - a, full_matrices=False)[2][2]
    if (centres.mean(0) - a) @ normal < 0:
        normal = -normal
    return normal, float(held.mean())


def up_from_cameras(cameras: Sequence[PlacedCamera], points: Float64[np.ndarray, "n 3"]) -> Up:
    """The vertical u that best explains how the cameras are held, with the ground's help where the two agree.

    Level cameras have x_i · u = 0; cameras that look down have z_i = -u; the ground is level on the whole. Each is a
    squared term over its variance, so the sum's inverse curvature is the doubt.
    """
    R = np.array([camera.T_R_cam[:3, :3] for camera in cameras])
    x, down, forward = R[:, :, 0], R[:, :, 1], R[:, :, 2]
    headings = x.T @ x / len(cameras)
    independent = 1 + 2 * np.linalg.eigvalsh(headings)[1] * (min(len(cameras), INDEPENDENT) - 1)
    level = headings * independent / np.radians(ROLL) ** 2
    axis = -unit(forward.mean(0))
    held = -unit(unit(down.mean(0)) + unit(forward.mean(0)))
    terms: list[tuple[Float64[np.ndarray, "3"], float]] = [(held, HELD)]
    centres = np.array([camera.T_R_cam[:3, 3] for camera in cameras])
    ground = terrain_normal(points, centres)
    look_alike = np.median([angle(-z, axis) for z in forward]) < 15
    if look_alike and (ground is None or ground[1] < 0.3 or angle(ground[0], axis) < 20):
        terms.append((axis, NADIR))
        flight = _flight_normal(centres, points, axis)
        terms += [] if flight is None else [flight]
    alone = _least_squares(level, terms)
    if ground is not None and ground[1] >= 0.3 and angle(ground[0], alone.direction) < max(PLAUSIBLE, 2 * alone.doubt):
        both = _least_squares(level, [*terms, (ground[0], TERRAIN)])
        return Up(both.direction, both.doubt, "cameras and terrain")
    return alone


def _flight_normal(
    centres: Float64[np.ndarray, "n 3"], points: Float64[np.ndarray, "m 3"], axis: Float64[np.ndarray, "3"]
) -> tuple[Float64[np.ndarray, "3"], float] | None:
    """Normal of the plane in which the cameras flew and its doubt [deg]; None when they did not fly in one."""
    if len(centres) < 6:
        return None
    offset = centres - centres.mean(0)
    _, extent, axes = np.linalg.svd(offset, full_matrices=False)
    height = float(np.median((centres.mean(0) - points) @ axis))
    normal = axes[2] if axes[2] @ axis > 0 else -axes[2]
    thickness = extent[2] / np.sqrt(len(centres) - 3)
    doubt = float(np.degrees(thickness / max(extent[1], 1e-12)))
    if thickness > FLATNESS * abs(height) or doubt > FLIGHT or angle(normal, axis) > 20:
        return None
    return normal, float(np.hypot(FLIGHT, doubt))


def _least_squares(level: Float64[np.ndarray, "3 3"], terms: list[tuple[Float64[np.ndarray, "3"], float]]) -> Up:
    """Unit vector that minimises uᵀ level u + sum |u - v|² / sigma² (sigma in degrees), by repeated projection."""
    weight = np.array([1 / np.radians(sigma) ** 2 for _, sigma in terms])
    pull = sum(w * v for w, (v, _) in zip(weight, terms, strict=True))
    up = unit(np.asarray(pull))
    tangent = np.linalg.svd(up[None])[2][1:]
    for _ in range(50):
        tangent = np.linalg.svd(up[None])[2][1:]
        gradient = tangent @ (level @ up - pull)
        curvature = tangent @ level @ tangent.T + weight.sum() * np.eye(2)
        up = unit(up - np.linalg.solve(curvature, gradient) @ tangent)
    curvature = tangent @ level @ tangent.T + weight.sum() * np.eye(2)
    return Up(up, float(np.degrees(np.sqrt(np.linalg.eigvalsh(np.linalg.inv(curvature))[-1]))), "cameras")
