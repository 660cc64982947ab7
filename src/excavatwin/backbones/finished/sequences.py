"""Text files of RGB-D sequences: lists by time, poses, trajectories, intrinsics."""

from __future__ import annotations

import json
from bisect import bisect_left
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from excavatwin.errors import InputError


def timed(path: Path) -> tuple[list[float], list[list[str]]]:
    """Times [s] in ascending order, and the other words of each line; ``#`` begins a comment (TUM RGB-D).

    Raises:
        InputError: a line does not begin with a time, or there is none.
    """
    rows = []
    for number, line in enumerate(_lines(path), 1):
        words = line.replace(",", " ").split()
        if words and not words[0].startswith("#"):
            try:
                rows.append((float(words[0]), words[1:]))
            except ValueError as error:
                raise InputError(f"{path}, line {number}, begins with {words[0]!r}; expected a time.") from error
    if not rows:
        raise InputError(f"{path} is empty; copy the whole sequence.")
    rows.sort(key=lambda row: row[0])
    return [time for time, _ in rows], [words for _, words in rows]


def nearest(times: list[float], time: float, most: float) -> int | None:
    """Index of the nearest time within ``most`` [s]."""
    at = bisect_left(times, time)
    near = min((i for i in (at - 1, at) if 0 <= i < len(times)), key=lambda i: abs(times[i] - time))
    return near if abs(times[near] - time) <= most else None


def quaternion_pose(words: list[str], where: str) -> Float64[np.ndarray, "4 4"]:
    """Camera-to-world pose from ``tx ty tz qx qy qz qw``.

    Raises:
        InputError: these are not seven numbers.
    """
    from scipy.spatial.transform import Rotation

    try:
        values = [float(word) for word in words[:7]]
        rotation = Rotation.from_quat(values[3:7]).as_matrix()
    except ValueError as error:
        raise InputError(f"{where} has {' '.join(words)!r}; expected tx ty tz qx qy qz qw.") from error
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, values[:3]
    return T


def matrix(path: Path) -> Float64[np.ndarray, "n m"]:
    """A matrix of numbers, one row a line.

    Raises:
        InputError: it is none.
    """
    try:
        return np.loadtxt(_lines(path), ndmin=2)
    except ValueError as error:
        raise InputError(f"{path} is no matrix of numbers ({error}).") from error


def pose(T: Float64[np.ndarray, "n m"], where: str) -> Float64[np.ndarray, "4 4"] | None:
    """A camera-to-world pose; None where the tracker was lost (not finite).

    Raises:
        InputError: it is no rotation and translation.
    """
    if T.shape != (4, 4):
        raise InputError(f"{where} is {T.shape[0]} x {T.shape[1]}; expected a 4 x 4 camera-to-world pose.")
    if not np.isfinite(T).all():
        return None
    if np.abs(T[:3, :3].T @ T[:3, :3] - np.eye(3)).max() > 1e-3 or np.linalg.det(T[:3, :3]) < 0:
        raise InputError(f"{where} is no rotation and translation; expected a 4 x 4 camera-to-world pose.")
    return T


def trajectory(path: Path) -> list[Float64[np.ndarray, "4 4"] | None]:
    """Poses of a Redwood ``.log``: for every frame one line of three numbers, then a 4 x 4 camera-to-world matrix.

    Raises:
        InputError: the file has another layout.
    """
    lines = [line for line in _lines(path) if line.strip()]
    if not lines or len(lines) % 5:
        raise InputError(f"{path} has {len(lines)} lines; expected five for every frame (numbers, then 4 x 4).")
    poses = []
    for first in range(0, len(lines), 5):
        try:
            T = np.loadtxt(lines[first + 1 : first + 5], ndmin=2)
        except ValueError as error:
            raise InputError(f"{path}, frame {first // 5}, is no 4 x 4 matrix ({error}).") from error
        poses.append(pose(T, f"frame {first // 5} of {path}"))
    return poses


def intrinsics(path: Path) -> Float64[np.ndarray, "n"]:
    """fx, fy, cx, cy and distortion terms (k1 k2 p1 p2 k3), pixel centres as in the file.

    A 3 x 3 or 4 x 4 matrix (ScanNet, 7-Scenes), one row of numbers, or Open3D's JSON (column by column).

    Raises:
        InputError: it is none of these.
    """
    if path.suffix == ".json":
        try:
            values = np.array(json.loads("".join(_lines(path)))["intrinsic_matrix"], float).reshape(3, 3).T
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(f"{path} has no intrinsic_matrix of nine numbers ({error}).") from error
    else:
        values = matrix(path)
    if values.shape in ((3, 3), (4, 4), (3, 4)):
        return np.array([values[0, 0], values[1, 1], values[0, 2], values[1, 2]])
    if values.shape[0] == 1 and values.shape[1] in (4, 8, 9):
        return values[0]
    raise InputError(f"{path} is {values.shape[0]} x {values.shape[1]}; expected 3 x 3, or fx fy cx cy (k1 k2 p1 p2).")


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path} cannot be read as text ({error}).") from error
