"""``transforms.json`` of nerfstudio and its relatives (instant-ngp, Polycam, Record3D, Blender exports).

Facts, read in nerfstudio-project/nerfstudio (``data/dataparsers/nerfstudio_dataparser.py``,
``data/utils/data_utils.py``, ``process_data/*_utils.py``) and its documentation:

* ``transform_matrix`` is camera-to-world with OpenGL axes (y up, z backward);
* ``fl_x``, ``fl_y``, ``cx``, ``cy``, ``w``, ``h``, ``k1`` .. ``k4``, ``p1``, ``p2`` stand at the top or in every frame;
  rays go through pixel centres at +0.5; older files have ``camera_angle_x`` instead of ``fl_x``;
* ``camera_model`` is PINHOLE, OPENCV or OPENCV_FISHEYE, among others;
* depth maps lie on the images as they are (with their lens), along the optical axis, and are multiplied by
  ``depth_unit_scale_factor``, 1e-3 by default, NPY as well as PNG;
* the cloud of ``ply_file_path`` is in the frame of the poses, with ``applied_transform`` in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from excavatwin.backbones.finished.depth_images import image_size
from excavatwin.backbones.finished.json_files import number, read_json
from excavatwin.backbones.finished.lenses import Lens
from excavatwin.errors import InputError

_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
_PERSPECTIVE = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "PERSPECTIVE")
_FISHEYE = ("OPENCV_FISHEYE", "FISHEYE")
_SUFFIXES = ("", ".png", ".jpg", ".jpeg")


@dataclass(frozen=True)
class Frame:
    """One frame of the file."""

    name: str
    """As the file names it: a path relative to the file."""
    lens: Lens
    T_W_cam: Float64[np.ndarray, "4 4"]
    """Camera-to-world, OpenCV axes."""
    depth: Path | None


@dataclass(frozen=True)
class Transforms:
    """What the file says."""

    path: Path
    frames: tuple[Frame, ...]
    unit: float | None
    """What depth values are multiplied by, where the file says so."""
    cloud: Path | None


def read_transforms(path: Path) -> Transforms:
    """Read ``transforms.json``.

    Raises:
        InputError: it is damaged, a frame lacks its pose, size or focal length, or the camera model is unknown.
    """
    meta = read_json(path)
    records = meta.get("frames") if isinstance(meta, dict) else None
    if not isinstance(records, list) or not records:
        raise InputError(f"{path} has no list of frames; expected a transforms.json as nerfstudio writes it.")
    frames = []
    for index, record in enumerate(records):
        where = f"frame {index} of {path}"
        if not isinstance(record, dict) or not isinstance(record.get("file_path"), str):
            raise InputError(f"{where} names no file_path.")
        depth = record.get("depth_file_path")
        frames.append(
            Frame(
                name=record["file_path"].removeprefix("./"),
                lens=_lens({**meta, **record}, path, where),
                T_W_cam=_pose(record.get("transform_matrix"), where),
                depth=path.parent / depth if isinstance(depth, str) else None,
            )
        )
    unit = number(meta, "depth_unit_scale_factor", str(path)) if "depth_unit_scale_factor" in meta else None
    cloud = meta.get("ply_file_path")
    return Transforms(path, tuple(frames), unit, path.parent / cloud if isinstance(cloud, str) else None)


def _pose(matrix: Any, where: str) -> Float64[np.ndarray, "4 4"]:
    try:
        T = np.array(matrix, float)
    except (TypeError, ValueError):
        T = np.zeros(0)
    if T.shape == (3, 4):
        T = np.vstack([T, [0, 0, 0, 1]])
    if T.shape != (4, 4) or not np.isfinite(T).all():
        raise InputError(f"{where} has no transform_matrix of 4 x 4 finite numbers.")
    if np.abs(T[:3, :3].T @ T[:3, :3] - np.eye(3)).max() > 1e-3 or np.linalg.det(T[:3, :3]) < 0:
        raise InputError(f"the transform_matrix of {where} is no rotation and translation; export it anew.")
    return T @ _OPENGL


def _lens(values: dict[str, Any], path: Path, where: str) -> Lens:
    if "w" in values and "h" in values:
        width, height = int(number(values, "w", where)), int(number(values, "h", where))
    else:
        files = (path.parent / (values["file_path"] + suffix) for suffix in _SUFFIXES)
        width, height = image_size(next((file for file in files if file.is_file()), path.parent / values["file_path"]))
    if "fl_x" in values:
        fx = number(values, "fl_x", where)
        fy = number(values, "fl_y", where, fx)
    elif "camera_angle_x" in values:
        fx = fy = 0.5 * width / float(np.tan(0.5 * number(values, "camera_angle_x", where)))
    else:
        raise InputError(f"{where} has no focal length; expected fl_x in pixels, or camera_angle_x.")
    K = (fx, fy, number(values, "cx", where, width / 2), number(values, "cy", where, height / 2))
    k1, k2, k3, k4, p1, p2 = (number(values, name, where, 0.0) for name in ("k1", "k2", "k3", "k4", "p1", "p2"))
    model = str(values.get("camera_model", "OPENCV")).upper()
    if values.get("is_fisheye") or model in _FISHEYE:
        return Lens(width, height, "OPENCV_FISHEYE", (*K, k1, k2, k3, k4))
    if model not in _PERSPECTIVE:
        raise InputError(f"{where} has camera_model {model!r}; expected a perspective or OPENCV_FISHEYE camera.")
    if k4:
        raise InputError(f"{where} has a fourth radial term k4 = {k4:g}; give undistorted images.")
    return Lens.brown(width, height, K, (k1, k2, k3), (p1, p2))
