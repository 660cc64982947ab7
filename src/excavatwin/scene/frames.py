"""Frames and rigid or similarity transforms.

**R** reconstruction (arbitrary similarity) · **G** gravity-aligned (z up, units of R) · **M** map (z up, metres).
``T_target_source`` maps source coordinates into the target. Cameras follow OpenCV (x right, y down, z forward);
poses are camera-to-world (``T_R_cam``); pixel centres lie at +0.5.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float32, Float64


def invert_rigid(T_a_b: Float64[np.ndarray, "4 4"]) -> Float64[np.ndarray, "4 4"]:
    """Inverse of a rigid transform, by transposing its rotation."""
    R, t = T_a_b[:3, :3], T_a_b[:3, 3]
    T_b_a = np.eye(4)
    T_b_a[:3, :3] = R.T
    T_b_a[:3, 3] = -R.T @ t
    return T_b_a


def transform(T_a_b: Float64[np.ndarray, "4 4"], p_b: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Map points of frame b into frame a, in the dtype of the points."""
    A = T_a_b[:3, :3].astype(p_b.dtype)
    return p_b @ A.T + T_a_b[:3, 3].astype(p_b.dtype)


def rotation_between(a: Float[np.ndarray, "3"], b: Float[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    """The smallest rotation that takes the direction of ``a`` to the direction of ``b`` (Rodrigues)."""
    a = np.asarray(a, float) / np.linalg.norm(a)
    b = np.asarray(b, float) / np.linalg.norm(b)
    c = float(a @ b)
    if c < -1 + 1e-12:  # opposite: half a turn about any axis normal to a
        axis = np.cross(a, np.eye(3)[np.argmin(np.abs(a))])
        axis /= np.linalg.norm(axis)
        return 2 * np.outer(axis, axis) - np.eye(3)
    v = np.cross(a, b)
    V = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + V + V @ V / (1 + c)


def project(
    K_cam: Float64[np.ndarray, "3 3"], T_R_cam: Float64[np.ndarray, "4 4"], p_R: Float[np.ndarray, "*n 3"]
) -> tuple[Float[np.ndarray, "*n 2"], Float[np.ndarray, "*n"]]:
    """Pixel coordinates (centres at +0.5) and depth along the optical axis of points of frame R."""
    p_cam = transform(invert_rigid(T_R_cam), np.asarray(p_R, float))
    z = p_cam[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        uv = p_cam[..., :2] / z[..., None] * np.array([K_cam[0, 0], K_cam[1, 1]]) + K_cam[:2, 2]
    return uv, z


def unproject(
    depth: Float32[np.ndarray, "H W"], K_cam: Float64[np.ndarray, "3 3"], T_R_cam: Float64[np.ndarray, "4 4"]
) -> Float32[np.ndarray, "H W 3"]:
    """World point of every pixel from its depth along the optical axis; NaN stays NaN."""
    height, width = depth.shape
    v, u = np.mgrid[:height, :width] + 0.5
    z = depth.astype(float)
    p_cam = np.stack([(u - K_cam[0, 2]) / K_cam[0, 0] * z, (v - K_cam[1, 2]) / K_cam[1, 1] * z, z], axis=-1)
    return (p_cam @ T_R_cam[:3, :3].T + T_R_cam[:3, 3]).astype(np.float32)


def umeyama(
    source: Float64[np.ndarray, "n d"], target: Float64[np.ndarray, "n d"], weight: Float64[np.ndarray, "n"]
) -> tuple[float, Float64[np.ndarray, "d d"], Float64[np.ndarray, "d"]]:
    """Weighted least-squares similarity (Umeyama, PAMI 1991): scale, rotation, translation."""
    w = weight / weight.sum()
    a, b = w @ source, w @ target
    A, B = source - a, target - b
    U, D, Vt = np.linalg.svd((B * w[:, None]).T @ A)
    sign = np.ones(len(D))
    sign[-1] = np.sign(np.linalg.det(U) * np.linalg.det(Vt)) or 1.0
    R = (U * sign) @ Vt
    scale = float((D * sign).sum() / max((w[:, None] * A**2).sum(), 1e-300))
    return scale, R, b - scale * R @ a
