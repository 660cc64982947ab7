"""Flights of a drone over a site: around it, in lines across it, or hovering. Equal seeds give equal flights."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Float64

from excavatwin.errors import InputError
from excavatwin.simulation.camera import Camera, look_at, orbit

ASPECT = 0.75
FOCAL_RATIO = 27 / np.hypot(36, 24) * 1.25
"""Focal length over image width of all flights: 27 mm equivalent, which EXIF can say exactly (CIPA DCG-001 relates the
diagonals of 36 mm x 24 mm and of a 4:3 image)."""
__all__ = ["FLIGHTS", "Flight", "hover", "lawnmower", "orbit"]


def lawnmower(
    views: int | None = None,
    extent: float = 26.0,
    height: float = 19.0,
    overlap: tuple[float, float] = (0.75, 0.65),
    tilt: float = 15.0,
    heading: float = 0.0,
    width: int = 1280,
    aspect: float = ASPECT,
    focal_ratio: float = FOCAL_RATIO,
    jitter: float = 1.0,
    seed: int = 7,
) -> tuple[Camera, ...]:
    """Parallel lines flown to and fro; the camera looks down, tilted forwards.

    Args:
        views: number of photos; by default what the overlaps ask for. A number that is given stretches the spacing.
        extent: edge of the square that the lines cover, about the origin [m].
        height: above z = 0 [m].
        overlap: share of a photo that the next one shows again, along a line and between lines, at tilt 0.
        tilt: of the optical axis from the vertical, in the direction of flight; 0 is nadir [deg].
        heading: of the first line, clockwise from north [deg].
        jitter: scale of the drone's deviations (0.3 m in position, 1.5 degrees in each angle).

    Raises:
        InputError: an overlap is not in 0..0.95, or there are fewer than 2 views.
    """
    if not all(0 <= share <= 0.95 for share in overlap):
        raise InputError(f"the overlaps are {overlap[0]:g} and {overlap[1]:g}; give shares from 0 to 0.95.")
    along, across = aspect * height / focal_ratio * (1 - overlap[0]), height / focal_ratio * (1 - overlap[1])
    lines, each = (max(2, int(np.ceil(extent / spacing)) + 1) for spacing in (across, along))
    if views is not None:
        _at_least_two(views)
        lines = max(1, round(np.sqrt(views * lines / each)))
        each = -(-views // lines)
    rng = np.random.default_rng(seed)
    side, ahead = (np.linspace(-extent / 2, extent / 2, n) if n > 1 else np.zeros(1) for n in (lines, each))
    cameras = []
    for line in range(lines):
        way = -1.0 if line % 2 else 1.0
        for step in range(each):
            drift, wobble = jitter * rng.normal(0, 0.3, 3), np.deg2rad(1.5) * jitter * rng.normal(size=3)
            turn = -np.deg2rad(heading)
            north, east = np.array([-np.sin(turn), np.cos(turn), 0]), np.array([np.cos(turn), np.sin(turn), 0])
            eye = side[line] * east + way * ahead[step] * north + np.array([0, 0, height]) + drift
            pose = _forwards(eye, way * north, np.deg2rad(tilt), wobble)
            cameras.append(Camera(width, int(round(width * aspect)), focal_ratio * width, pose))
    return tuple(cameras if views is None else cameras[:views])


def hover(
    views: int = 16,
    azimuth: float | None = None,
    radius: float = 20.0,
    height: float = 16.0,
    drift: float = 0.4,
    width: int = 1280,
    aspect: float = ASPECT,
    focal_ratio: float = FOCAL_RATIO,
    jitter: float = 1.0,
    seed: int = 7,
) -> tuple[Camera, ...]:
    """One place from which a drone watches the dig at a slant; the wind moves it a little.

    Hardly any baseline: geometry from such photos alone is weak, as it is for real hovering drones.

    Args:
        azimuth: of the drone as seen from the site, clockwise from north; drawn from the seed by default [deg].
        radius: horizontal distance from the centre [m].
        height: above z = 0 [m].
        drift: standard deviation of the drone's wander from its place [m].
        jitter: scale of the wobble of the camera (0.3 degrees).
    """
    _at_least_two(views)
    rng = np.random.default_rng(seed)
    drawn = rng.uniform(0, 360)
    a = np.deg2rad(drawn if azimuth is None else azimuth)
    home = np.array([radius * np.sin(a), radius * np.cos(a), height])
    wander = np.zeros(3)
    cameras = []
    for _ in range(views):
        wander = 0.8 * wander + 0.6 * drift * rng.normal(size=3)  # stationary with standard deviation ``drift``
        target = jitter * np.deg2rad(0.3) * np.hypot(radius, height) * rng.normal(size=3)
        pose = look_at(home + wander, target, jitter * np.deg2rad(0.3) * rng.normal())
        cameras.append(Camera(width, int(round(width * aspect)), focal_ratio * width, pose))
    return tuple(cameras)


def _at_least_two(views: int) -> None:
    if views < 2:
        raise InputError(f"{views} photos make no flight; give at least 2.")


def _forwards(
    eye: Float64[np.ndarray, "3"], ahead: Float64[np.ndarray, "3"], tilt: float, wobble: Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, "4 4"]:
    """Pose of a camera that looks down and ``tilt`` ahead, turned a little about its own axes [rad]."""
    forward = np.sin(tilt) * ahead - np.cos(tilt) * np.array([0, 0, 1.0])
    right = np.cross(ahead, [0, 0, 1.0])
    axes = np.stack([right, np.cross(forward, right), forward], axis=1)
    x, y, z = wobble
    turn = np.array([[1, -z, y], [z, 1, -x], [-y, x, 1.0]])
    q, r = np.linalg.qr(turn)
    T = np.eye(4)
    T[:3, :3] = axes @ (q * np.sign(np.diag(r)))
    T[:3, 3] = eye
    return T


def _around(views: int, width: int, seed: int) -> tuple[Camera, ...]:
    _at_least_two(views)
    return orbit(views, width=width, focal_ratio=FOCAL_RATIO, seed=seed)


def _across(views: int, width: int, seed: int) -> tuple[Camera, ...]:
    return lawnmower(views, width=width, seed=seed)


def _above(views: int, width: int, seed: int) -> tuple[Camera, ...]:
    return hover(views, width=width, seed=seed)


Flight = Callable[[int, int, int], tuple[Camera, ...]]
"""(number of photos, their width [px], seed) -> cameras."""
FLIGHTS: Mapping[str, Flight] = {"orbit": _around, "lawnmower": _across, "hover": _above}
