"""OpenSfM's reconstruction: lenses in units of the longer side, poses world-to-camera, a frame tied to the Earth.

Facts, read in mapillary/OpenSfM (``io.py``, ``features.py``, ``undistort.py``, ``actions/export_geocoords.py``,
``src/geometry``):

* normalised image coordinates are (pixel - half the size) / longer side, pixel centres at +0.5;
* ``rotation`` is an angle-axis vector and ``x_cam = R x + translation``, OpenCV axes;
* ``perspective``, ``fisheye`` (k1, k2, principal point in the middle), ``brown`` (OpenCV's order of terms, with k3),
  ``fisheye_opencv``, ``simple_radial`` and ``radial`` have OpenCV's formulas;
* the frame is east, north, up at ``reference_lla``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from excavatwin.backbones.finished.json_files import number, read_json
from excavatwin.backbones.finished.lenses import Lens
from excavatwin.errors import InputError
from excavatwin.scene.frames import invert_rigid


@dataclass(frozen=True)
class Shot:
    """An image of a reconstruction."""

    lens: Lens
    T_W_cam: Float64[np.ndarray, "4 4"]


@dataclass(frozen=True)
class OpenSfm:
    """The largest reconstruction of a file."""

    path: Path
    shots: dict[str, Shot]
    reference: tuple[float, float, float] | None
    """Latitude, longitude [deg] and altitude [m] of the origin; None when the frame is not tied to the Earth."""
    others: int
    """Images in the smaller reconstructions, which are left out."""


def read_opensfm(path: Path) -> OpenSfm:
    """Read ``reconstruction.json``, with ``reference_lla.json`` beside it where the file itself tells no reference.

    Raises:
        InputError: it is damaged, or uses a lens that no photo can be undistorted with.
    """
    from scipy.spatial.transform import Rotation

    content = read_json(path)
    if not isinstance(content, list) or not all(isinstance(one, dict) and "shots" in one for one in content):
        raise InputError(f"{path} is not a reconstruction of OpenSfM; expected a list of cameras, shots and points.")
    found: dict[str, Any] = max(content, key=lambda one: len(one["shots"]), default={"shots": {}})
    if not found["shots"]:
        raise InputError(f"{path} holds no shots; the photos were not reconstructed.")
    lenses = {name: _lens(camera, f"camera {name!r} of {path}") for name, camera in found["cameras"].items()}
    shots = {}
    for name, shot in found["shots"].items():
        try:
            T = np.eye(4)
            T[:3, :3] = Rotation.from_rotvec(np.asarray(shot["rotation"], float)).as_matrix()
            T[:3, 3] = shot["translation"]
            shots[name] = Shot(lenses[shot["camera"]], invert_rigid(T))
        except (KeyError, ValueError, TypeError) as error:
            raise InputError(f"shot {name!r} of {path} has no rotation, translation and camera ({error}).") from error
    others = sum(len(one["shots"]) for one in content) - len(shots)
    return OpenSfm(path, shots, _reference(found, path), others)


def _lens(camera: dict[str, Any], where: str) -> Lens:
    kind = camera.get("projection_type", "perspective")
    width, height = int(number(camera, "width", where)), int(number(camera, "height", where))
    size = max(width, height)

    def terms(*names: str) -> tuple[float, ...]:
        return tuple(number(camera, name, where, 0.0) for name in names)

    if kind in ("perspective", "fisheye"):
        f = size * number(camera, "focal", where)
        K = (f, f, width / 2, height / 2)
    elif kind in ("brown", "fisheye_opencv", "simple_radial", "radial"):
        cx, cy = terms("c_x", "c_y")
        fx, fy = (size * number(camera, name, where) for name in ("focal_x", "focal_y"))
        K = (fx, fy, width / 2 + size * cx, height / 2 + size * cy)
    else:
        raise InputError(f"{where} is of type {kind!r}; expected a perspective, brown, radial or fisheye camera.")
    if kind == "fisheye":
        return Lens(width, height, "OPENCV_FISHEYE", (*K, *terms("k1", "k2"), 0.0, 0.0))
    if kind == "fisheye_opencv":
        return Lens(width, height, "OPENCV_FISHEYE", (*K, *terms("k1", "k2", "k3", "k4")))
    return Lens.brown(width, height, K, terms("k1", "k2", "k3"), terms("p1", "p2"))


def _reference(found: dict[str, Any], path: Path) -> tuple[float, float, float] | None:
    record = found.get("reference_lla")
    beside = path.with_name("reference_lla.json")
    if record is None and beside.is_file():
        record = read_json(beside)
    if not isinstance(record, dict):
        return None
    latitude, longitude, altitude = (number(record, key, str(path)) for key in ("latitude", "longitude", "altitude"))
    return None if latitude == longitude == 0 else (latitude, longitude, altitude)  # written so without any GPS


def to_projected(
    T_W_cam: Float64[np.ndarray, "4 4"], reference: tuple[float, float, float], epsg: int
) -> Float64[np.ndarray, "4 4"]:
    """A pose in the frame east, north, up at ``reference`` as a pose in a projected CRS, exact at the camera.

    The projection's scale (0.04 % at a zone's middle) is left out of the rotation, as a camera needs.
    """
    centre = T_W_cam[:3, 3]
    at = _project(np.concatenate([centre[None], centre + np.eye(3)]), reference, epsg)
    turn = (at[1:] - at[0]).T
    U, _, Vt = np.linalg.svd(turn)
    T = np.eye(4)
    T[:3, :3] = U @ Vt @ T_W_cam[:3, :3]
    T[:3, 3] = at[0]
    return T


def _project(
    enu: Float64[np.ndarray, "n 3"], reference: tuple[float, float, float], epsg: int
) -> Float64[np.ndarray, "n 3"]:
    from pyproj import Transformer

    latitude, longitude, altitude = reference
    to_lonlat = Transformer.from_pipeline(
        f"+proj=pipeline +step +inv +proj=topocentric +ellps=WGS84 +lat_0={latitude!r} +lon_0={longitude!r} "
        f"+h_0={altitude!r} +step +inv +proj=cart +ellps=WGS84 +step +proj=unitconvert +xy_in=rad +xy_out=deg"
    )
    lon, lat, height = to_lonlat.transform(*enu.T)
    east, north = Transformer.from_crs(4326, epsg, always_xy=True).transform(lon, lat)
    return np.stack([east, north, height], axis=1)
