"""From what networks call depth, extrinsics and intrinsics to world points and our kind of camera.

Ours: camera-to-world, OpenCV axes, pixel centres at +0.5. Most networks deliver camera-from-world matrices and count
pixel centres at whole numbers; whoever adds the half pixel to K must not add it to the points as well.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float32, Float64

from excavatwin.scene.frames import unproject


def rigid(poses: Float[np.ndarray, "S rows 4"]) -> Float64[np.ndarray, "S 4 4"]:
    """Poses (3 or 4 rows) as 4 x 4 with the nearest rotation: networks' are orthonormal only to single precision.

    A matrix that is no rotation at all (not finite, or a mirror) is left for the validator to name.
    """
    T = np.tile(np.eye(4), (len(poses), 1, 1))
    T[:, :3] = poses[:, :3]
    R = T[:, :3, :3]
    if not np.isfinite(R).all() or (np.linalg.det(R) <= 0).any():
        return T
    U, _, Vt = np.linalg.svd(R)
    nearest = U @ Vt
    close = np.abs(nearest - R).max(axis=(1, 2)) < 0.01
    T[close, :3, :3] = nearest[close]
    return T


def camera_to_world(extrinsics: Float[np.ndarray, "S rows 4"]) -> Float64[np.ndarray, "S 4 4"]:
    """Camera-to-world poses from camera-from-world ones (3 or 4 rows)."""
    from_world = rigid(extrinsics)
    T = np.tile(np.eye(4), (len(from_world), 1, 1))
    T[:, :3, :3] = from_world[:, :3, :3].transpose(0, 2, 1)
    T[:, :3, 3] = -np.einsum("sij,sj->si", T[:, :3, :3], from_world[:, :3, 3])
    return T


def centred(K: Float[np.ndarray, "S 3 3"]) -> Float64[np.ndarray, "S 3 3"]:
    """Intrinsics whose pixel centres lie at +0.5, from such that count them at whole numbers."""
    moved = K.astype(np.float64)
    moved[:, :2, 2] += 0.5
    return moved


def world_points(
    depth: Float32[np.ndarray, "S H W"], K: Float64[np.ndarray, "S 3 3"], T: Float64[np.ndarray, "S 4 4"]
) -> Float32[np.ndarray, "S H W 3"]:
    """World point of every pixel from its depth along the optical axis; NaN where that is no positive number.

    Args:
        depth: [su].
        K: pixel centres at +0.5 [px].
        T: camera-to-world [su].
    """
    with np.errstate(invalid="ignore"):
        z = np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(np.nan)).astype(np.float32)
    return np.stack([unproject(*view) for view in zip(z, K, T, strict=True)])


def fitted_intrinsics(points: Float32[np.ndarray, "S H W 3"]) -> Float64[np.ndarray, "S 3 3"]:
    """Intrinsics under which points in camera coordinates fall on their own pixels (centres at +0.5).

    For networks that deliver point maps and no K. A line is fitted to x / z over the pixel, in both directions; then
    again without the tenth that missed most, because what such networks say at edges of objects lies between them.
    All NaN for a view without points in front of its camera.
    """
    S, H, W = points.shape[:3]
    v, u = np.mgrid[:H, :W] + 0.5
    K = np.tile(np.eye(3), (S, 1, 1))
    for s, view in enumerate(points.astype(np.float64)):
        with np.errstate(invalid="ignore"):
            use = np.isfinite(view).all(-1) & (view[..., 2] > 0)
        ray = view[use][:, :2] / view[use][:, 2:]
        for axis, pixel in enumerate((u[use], v[use])):
            K[s, axis, axis], K[s, axis, 2] = _focal(pixel, ray[:, axis])
    return K


def _focal(pixel: Float64[np.ndarray, "n"], ray: Float64[np.ndarray, "n"]) -> tuple[float, float]:
    """Focal length and principal point from one coordinate of pixels and their rays at depth 1."""
    if len(pixel) < 10 or np.ptp(pixel) < 2:
        return float("nan"), float("nan")
    kept = np.ones(len(pixel), bool)
    for _ in range(3):
        slope, offset = np.polyfit(pixel[kept], ray[kept], 1)
        miss = np.abs(ray - slope * pixel - offset)
        kept = miss <= np.quantile(miss, 0.9)
    return float(1 / slope), float(-offset / slope)
