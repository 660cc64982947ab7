"""Calibration files of RELLIS-3D: ``camera_info.txt`` and ``transforms.yaml``, one pair for each sequence."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from excavatwin.datasets.readers import read_matrix
from excavatwin.errors import InputError

#: k1, k2, p1, p2 of the Basler camera (k3 is 0), as the authors' own projection notebook has them.
LENS = (-0.134313, -0.025905, 0.002181, 0.00084)
#: The one transform that is used; its numbers are the camera's pose in the frame of the Ouster.
KEY = "os1_cloud_node-pylon_camera_node"

_NUMBER = re.compile(r"^\s*([wxyz])\s*:\s*([-+0-9.eE]+)\s*$")


def read_camera_info(path: Path) -> Float64[np.ndarray, "3 3"]:
    """Intrinsics from the one line ``fx fy cx cy``.

    OpenCV's calibration puts pixel centres at whole numbers, ours at +0.5: the principal point moves by half a pixel.

    Raises:
        InputError: the file is damaged or its numbers are no intrinsics.
    """
    rows = read_matrix(path, 4)
    if len(rows) != 1 or (rows <= 0).any():
        raise InputError(f"{path} is no camera_info.txt: expected one line of four positive numbers, fx fy cx cy.")
    fx, fy, cx, cy = rows[0]
    return np.array([[fx, 0, cx + 0.5], [0, fy, cy + 0.5], [0, 0, 1]])


def read_transforms(path: Path) -> Float64[np.ndarray, "4 4"]:
    """T_L_cam: the camera's pose in the lidar frame, from unit quaternion and translation.

    Raises:
        InputError: the file lacks the transform, or its quaternion is not of unit length.
    """
    try:
        text = path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path} cannot be read ({error}).") from error
    values: dict[str, dict[str, float]] = {"q": {}, "t": {}}
    block = part = ""
    for line in text.splitlines():
        word = line.strip().rstrip(":")
        if line and not line[0].isspace():
            block = word
        elif block == KEY and word in values:
            part = word
        elif block == KEY and part and (match := _NUMBER.match(line)):
            values[part][match[1]] = float(match[2])
    if set(values["q"]) != set("wxyz") or set(values["t"]) != set("xyz"):
        raise InputError(f"{path} lacks {KEY} with q (w, x, y, z) and t (x, y, z).")
    w, x, y, z = (values["q"][axis] for axis in "wxyz")
    if abs(np.sqrt(w * w + x * x + y * y + z * z) - 1) > 1e-3:
        raise InputError(f"{path}: the quaternion of {KEY} is not of unit length; the file is damaged.")
    T_L_cam = np.eye(4)
    T_L_cam[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    U, _, Vt = np.linalg.svd(T_L_cam[:3, :3])  # ten digits of text: exactly orthonormal again
    T_L_cam[:3, :3] = U @ Vt
    T_L_cam[:3, 3] = [values["t"][axis] for axis in "xyz"]
    return T_L_cam
