"""Similarities of space as a group: exponential, logarithm, inverse, and what they do to cameras.

A similarity is a 4 x 4 matrix [[s R, t], [0, 1]], ``S_a_b`` takes frame b into frame a; its tangent is (v, w, l):
translation, rotation vector and logarithm of the scale (Eade, "Lie groups for 2D and 3D transformations", 2013).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

Matrix = Float64[np.ndarray, "4 4"]
Tangent = Float64[np.ndarray, "7"]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)


def similarity(scale: float, rotation: Float64[np.ndarray, "3 3"], translation: Float64[np.ndarray, "3"]) -> Matrix:
    """p -> scale rotation p + translation."""
    S = np.eye(4)
    S[:3, :3], S[:3, 3] = scale * rotation, translation
    return S


def scale_of(S: Matrix) -> float:
    """Factor by which it multiplies lengths."""
    return float(np.cbrt(np.linalg.det(S[:3, :3])))


def inverse(S: Matrix) -> Matrix:
    """The similarity that undoes it."""
    A = S[:3, :3].T / scale_of(S) ** 2
    return similarity(1.0, A, -A @ S[:3, 3])


def moved_pose(S_a_b: Matrix, T_b_cam: Matrix) -> Matrix:
    """The camera-to-world pose in frame a: a pose has no scale, only its position takes part in it."""
    T_a_cam = S_a_b @ T_b_cam
    T_a_cam[:3, :3] /= scale_of(S_a_b)
    return T_a_cam


def exp(xi: Tangent) -> Matrix:
    """The similarity of a tangent vector."""
    v, w, log_scale = xi[:3], xi[3:6], xi[6]
    return similarity(float(np.exp(log_scale)), _rotation(w), _mean_motion(w, log_scale) @ v)


def log(S: Matrix) -> Tangent:
    """The tangent vector of a similarity whose rotation is less than half a turn."""
    from scipy.spatial.transform import Rotation

    scale = scale_of(S)
    w = Rotation.from_matrix(S[:3, :3] / scale).as_rotvec()
    log_scale = float(np.log(scale))
    return np.concatenate([np.linalg.solve(_mean_motion(w, log_scale), S[:3, 3]), w, [log_scale]])


def _cross(w: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    return np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


def _rotation(w: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    """Rodrigues' formula, exact at 0."""
    turn, W = np.linalg.norm(w) / np.pi, _cross(w)
    return np.eye(3) + np.sinc(turn) * W + 0.5 * np.sinc(turn / 2) ** 2 * W @ W


def _mean_motion(w: Float64[np.ndarray, "3"], log_scale: float) -> Float64[np.ndarray, "3 3"]:
    """The integral of exp(l x) R(w x) over x in 0..1, by Gauss' quadrature: exact to rounding, no cases near 0."""
    x, weight = (_NODES + 1) / 2, _WEIGHTS / 2 * np.exp(log_scale * (_NODES + 1) / 2)
    angle, W = np.linalg.norm(w), _cross(w)
    first = (weight * x * np.sinc(angle * x / np.pi)).sum()
    second = (weight * 0.5 * x**2 * np.sinc(angle * x / (2 * np.pi)) ** 2).sum()
    return weight.sum() * np.eye(3) + first * W + second * W @ W
