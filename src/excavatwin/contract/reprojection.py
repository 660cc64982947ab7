"""Do the points of a view fall on their own pixels? If not, which mistake of convention explains it?

A wrong pose direction can look plausible in the map; it cannot reproject. Pixel centres lie at +0.5, cameras follow
OpenCV, poses are camera-to-world.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64

from excavatwin.scene.frames import invert_rigid, project

#: A median above this is reported [px].
REPORTED = 1.0
#: A median above this share of the image width is refused.
REFUSED = 0.02
_SAMPLES = 5_000
_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Reprojection:
    """How far the points of one view miss their own pixels."""

    median: float
    """Median distance; infinite when half of the points lie behind the camera [px]."""
    cause: str
    """The mistake of convention that explains it, with its remedy; empty when none does or none is needed."""


@dataclass(frozen=True)
class _Samples:
    """Some points of a view with their pixels."""

    points: Float64[np.ndarray, "n 3"]
    pixels: Float64[np.ndarray, "n 2"]
    """Column and row of the pixel centres, at +0.5."""
    shape: tuple[int, int]


def reprojection(
    points: Float[np.ndarray, "H W 3"], T_R_cam: Float64[np.ndarray, "4 4"], K_cam: Float64[np.ndarray, "3 3"]
) -> Reprojection | None:
    """The median miss of a view's points and its likely cause; None when the view has no point."""
    H, W = points.shape[:2]
    flat = np.flatnonzero(~np.isnan(points[..., 0]))
    if not len(flat):
        return None
    flat = flat[:: max(1, len(flat) // _SAMPLES)]
    pixels = np.stack([flat % W + 0.5, flat // W + 0.5], axis=-1)
    samples = _Samples(points.reshape(-1, 3)[flat].astype(float), pixels, (H, W))
    median = _median(samples, T_R_cam, K_cam)
    if median <= 0.3:
        return Reprojection(median, "")
    if _median(samples, T_R_cam, K_cam, offset=-0.5) < 0.3 * median:
        return Reprojection(
            median, "K counts pixel centres at whole numbers; add 0.5 to cx and cy, pixel centres lie at +0.5"
        )
    return Reprojection(median, _cause(samples, T_R_cam, K_cam, median) if median > REPORTED else "")


def _median(
    s: _Samples, T_R_cam: Float64[np.ndarray, "4 4"], K: Float64[np.ndarray, "3 3"], offset: float = 0.0
) -> float:
    uv, z = project(K, T_R_cam, s.points)
    miss = np.where(z > 0, np.hypot(*(uv - s.pixels - offset).T), np.inf)
    return float(np.median(miss))


def _poses(T: Float64[np.ndarray, "4 4"]) -> Iterator[tuple[Float64[np.ndarray, "4 4"], str]]:
    """Poses that other conventions would have meant by T, with what to do."""
    inverse = invert_rigid(T)
    turned = T.copy()
    turned[:3, :3] = T[:3, :3].T
    yield inverse, "the pose is world-to-camera; T_world_cam must be camera-to-world: invert it"
    yield T @ _OPENGL, "the camera axes are OpenGL's (y up, z backward); negate the second and third column of T"
    yield (
        invert_rigid(_OPENGL @ T),
        "the pose is world-to-camera with OpenGL axes; invert it, negate its columns 2, 3",
    )
    yield turned, "the rotation is transposed (row-major read as column-major): transpose the 3 x 3 block"
    yield np.eye(4), "the points are in camera coordinates; apply T_world_cam to bring them into the world"


def _cause(s: _Samples, T: Float64[np.ndarray, "4 4"], K: Float64[np.ndarray, "3 3"], median: float) -> str:
    good = min(max(REPORTED, 0.002 * s.shape[1]), 0.25 * median)
    for pose, remedy in _poses(T):
        if _median(s, pose, K) < good:
            return remedy
    swapped = _Samples(s.points, s.pixels[:, ::-1], s.shape)
    if _median(swapped, T, K) < good:
        return "rows and columns are swapped; swap the first two axes of points, confidence and evidence"
    for pose, remedy in [(T, ""), *_poses(T)]:
        intrinsics = _intrinsics_cause(s, pose, K, good)
        if intrinsics:
            return f"{remedy}; and {intrinsics}" if remedy else intrinsics
    return ""


def _intrinsics_cause(s: _Samples, T: Float64[np.ndarray, "4 4"], K: Float64[np.ndarray, "3 3"], good: float) -> str:
    """The intrinsics that would fit this pose, as a sentence; empty when none would."""
    uv, z = project(np.eye(3), T, s.points)
    front = z > 0
    if front.sum() < max(10, 0.9 * len(z)) or np.ptp(uv[front], axis=0).min() < 1e-9:
        return ""
    (fx, cx), (fy, cy) = (np.polyfit(uv[front, a], s.pixels[front, a], 1) for a in (0, 1))
    fitted = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    if min(fx, fy) <= 0 or _median(s, T, fitted) >= good:
        return ""
    ratio = np.array([K[0, 0] / fx, K[1, 1] / fy, K[0, 2] / cx, K[1, 2] / cy])
    if np.ptp(ratio) < 0.02 * ratio.mean():
        return (
            f"K belongs to an image {ratio.mean():.3g} times as large; divide its first two rows by {ratio.mean():.4g}"
        )
    return (
        f"K does not belong to this lattice (crop, padding or another size?); fx {fx:.1f}, fy {fy:.1f}, cx {cx:.1f}, "
        f"cy {cy:.1f} would fit"
    )
