"""Cameras from any file that we can read: our own SITE, COLMAP, OpenSfM, transforms.json, or a table of angles."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from excavatwin.backbones.finished.colmap_files import is_model, models_in, read_model
from excavatwin.backbones.finished.found import FoundCamera
from excavatwin.backbones.finished.json_files import read_json
from excavatwin.backbones.finished.lenses import Lens
from excavatwin.backbones.finished.opensfm_files import read_opensfm, to_projected
from excavatwin.backbones.finished.transforms_file import read_transforms
from excavatwin.errors import InputError

#: What is looked for beside a cloud, in this order.
USUAL = ("cameras.json", "transforms.json", "reconstruction.json", "cameras.csv", "sparse/0", "sparse")
_ANGLES = ("omega", "phi", "kappa")
_DOWN = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class CameraFile:
    """Cameras and what their file says about the frame."""

    path: Path
    cameras: tuple[FoundCamera, ...]
    upright: bool = False
    """+z is up."""
    metric: bool = False
    """The unit is the metre."""
    doubts: tuple[str, ...] = ()


def read_cameras(path: Path, epsg: int | None) -> CameraFile:
    """Cameras in the frame of a cloud.

    Args:
        path: ``cameras.json`` of a SITE, a COLMAP model (folder), OpenSfM's ``reconstruction.json``, nerfstudio's
            ``transforms.json``, or a table (CSV) with angles.
        epsg: CRS of the cloud, None without one. OpenSfM's cameras, east, north, up at their reference, go into it.

    Raises:
        InputError: the file is none of these, or damaged.
    """
    if path.is_dir():
        models = [path] if is_model(path) else models_in(path)
        if not models:
            raise InputError(f"{path} holds no COLMAP model; give a file of cameras.")
        found = read_model(models[0])
        return CameraFile(path, tuple(FoundCamera(n, one.lens, one.T_W_cam) for n, one in found.images.items()))
    if path.suffix.lower() in (".csv", ".txt"):
        return _table(path)
    content = read_json(path)
    if isinstance(content, list):
        return _opensfm(path, epsg)
    if isinstance(content, dict) and "frames" in content:
        frames = read_transforms(path).frames
        return CameraFile(path, tuple(FoundCamera(one.name, one.lens, one.T_W_cam) for one in frames))
    if isinstance(content, dict) and isinstance(content.get("cameras"), list) and "conventions" in content:
        return _site(path, content)
    raise InputError(
        f"{path} is no file of cameras that is known; expected cameras.json of a SITE, reconstruction.json of OpenSfM, "
        "transforms.json of nerfstudio, a COLMAP model or a CSV."
    )


def _opensfm(path: Path, epsg: int | None) -> CameraFile:
    found = read_opensfm(path)
    tied = epsg is not None and found.reference is not None
    cameras = []
    for name, shot in found.shots.items():
        T = shot.T_W_cam
        if epsg is not None and found.reference is not None:
            T = to_projected(T, found.reference, epsg)
        cameras.append(FoundCamera(name, shot.lens, T))
    return CameraFile(path, tuple(cameras), upright=tied or found.reference is not None, metric=tied)


def _site(path: Path, content: dict[str, Any]) -> CameraFile:
    cameras = []
    for one in content["cameras"]:
        if not one.get("placed"):
            continue
        try:
            K, T = np.array(one["K"], float), np.array(one["T_map_cam"], float)
            k1, k2, p1, p2 = (float(value) for value in one["distortion"])
            intrinsics = (float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
            lens = Lens.brown(int(one["width"]), int(one["height"]), intrinsics, (k1, k2), (p1, p2))
            cameras.append(FoundCamera(str(one["name"]), lens, T.reshape(4, 4)))
        except (KeyError, ValueError, TypeError, IndexError) as error:
            raise InputError(f"{path} has a camera without K, distortion, size and T_map_cam ({error}).") from error
    if not cameras:
        raise InputError(f"{path} holds no placed camera; give cameras.json of a finished SITE.")
    return CameraFile(path, tuple(cameras), upright=True, metric=content.get("unit") in ("m", "metre"))


def _table(path: Path) -> CameraFile:
    """A table: name, x, y, z, omega, phi, kappa [deg], and perhaps f, cx, cy, width, height [px], k1, k2, p1, p2.

    Angles as Pix4D and OpenSfM define them: camera-to-world = Rx(omega) Ry(phi) Rz(kappa) with photogrammetric camera
    axes (x right, y up, z backward), x, y, z of the world being east, north and up.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path} cannot be read as a table ({error}).") from error
    first = text.splitlines()[0] if text.strip() else ""
    delimiter = next((one for one in (",", ";", "\t") if one in first), " ")
    rows = list(csv.DictReader(text.splitlines(), delimiter=delimiter, skipinitialspace=True))
    rows = [{str(key).strip().casefold(): value for key, value in row.items()} for row in rows]
    columns = set(rows[0]) if rows else set()
    name = next((one for one in ("name", "imagename", "label", "filename") if one in columns), None)
    missing = [one for one in ("x", "y", "z", *_ANGLES) if one not in columns]
    if name is None or missing:
        raise InputError(
            f"{path} lacks the column {missing[0] if missing else 'name'}; expected name, x, y, z, omega, phi, kappa "
            "in its first line."
        )
    cameras = [_row(row, name, f"{path}, row {number}") for number, row in enumerate(rows, 2)]
    told = all(camera.lens is not None for camera in cameras)
    doubt = f"{path} tells no lens: focal lengths are those that the photos' files tell, without distortion."
    return CameraFile(path, tuple(cameras), upright=True, doubts=() if told else (doubt,))


def _row(row: dict[str, str], name: str, where: str) -> FoundCamera:
    from scipy.spatial.transform import Rotation

    try:
        centre = [float(row[axis]) for axis in "xyz"]
        turn = Rotation.from_euler("XYZ", [float(row[angle]) for angle in _ANGLES], degrees=True).as_matrix()
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = turn @ _DOWN, centre
        return FoundCamera(str(row[name]), _row_lens(row), T)
    except (TypeError, ValueError) as error:
        raise InputError(f"{where} is incomplete or holds a word where a number should be ({error}).") from error


def _row_lens(row: dict[str, str]) -> Lens | None:
    if not {"f", "width", "height"} <= set(row):
        return None
    width, height, f = int(float(row["width"])), int(float(row["height"])), float(row["f"])
    cx, cy = float(row.get("cx", width / 2)), float(row.get("cy", height / 2))
    k1, k2, k3, p1, p2 = (float(row.get(term, 0.0)) for term in ("k1", "k2", "k3", "p1", "p2"))
    return Lens.brown(width, height, (f, f, cx, cy), (k1, k2, k3), (p1, p2))


def beside(cloud: Path) -> Path:
    """The cameras that lie beside a cloud.

    Raises:
        InputError: there are none.
    """
    folder = cloud.parent
    for name in USUAL:
        path = folder / name
        if path.is_file() or (path.is_dir() and is_model(path)):
            return path
    if is_model(folder):
        return folder
    raise InputError(f"{cloud} lies beside no cameras ({', '.join(USUAL)}); say where they are: --cloud.cameras PATH.")
