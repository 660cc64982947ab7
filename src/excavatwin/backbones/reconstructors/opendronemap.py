"""OpenDroneMap's project folder: OpenSfM's cameras, and depth from its depth maps or from the georeferenced cloud.

Facts, read in OpenDroneMap/ODM (``stages/run_opensfm.py``, ``stages/odm_georeferencing.py``, ``opendm/location.py``,
``opendm/types.py``) and mapillary/OpenSfM (``dense.py``, ``undistort.py``):

* ``odm_georeferencing/coords.txt``: the CRS, then the offset (easting, northing) of all local coordinates;
* georeferenced projects of 2021 and later keep OpenSfM's own frame in ``opensfm/reconstruction.topocentric.json`` and
  write ``reconstruction.json`` in the CRS less that offset; before, and in newest versions, the latter is topocentric;
* ``odm_georeferenced_model.laz`` carries full coordinates of the CRS;
* ``undistorted/depthmaps/SHOT.clean.npz`` (only without OpenMVS): ``depth``, 0 = none, and ``score``, on undistorted
  images whose principal point is the middle.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import Float64

from excavatwin.backbones.cards import Card, Tried
from excavatwin.backbones.finished.clouds import CloudFile, projected
from excavatwin.backbones.finished.found import FoundCamera, Scene
from excavatwin.backbones.finished.lenses import Lens
from excavatwin.backbones.finished.opensfm_files import OpenSfm, Shot, read_opensfm, to_projected
from excavatwin.backbones.finished.posed_depth import DepthMap
from excavatwin.backbones.finished.reader import Finished
from excavatwin.errors import InputError

_CLOUDS = ("odm_georeferenced_model_unaligned.laz", "odm_georeferenced_model.laz", "odm_georeferenced_model.las")


@dataclass(frozen=True)
class OpenDroneMap(Finished):
    """A project of OpenDroneMap (or of OpenSfM alone): metres, +z up and map coordinates where it is georeferenced."""

    card: ClassVar[Card] = Card(
        name="opendronemap",
        kind="reconstructor",
        summary="an OpenDroneMap project: OpenSfM's cameras with depth maps or the georeferenced cloud",
        tried=Tried.FILES,
        modules=("pycolmap", "cv2", "laspy", "pyproj"),
        install="pip install --upgrade excavatwin",
        argument="source",
        metric=True,
        source="https://github.com/OpenDroneMap/ODM",
    )
    watched: ClassVar[tuple[str, ...]] = (
        "reconstruction*.json",
        "reference_lla.json",
        "coords.txt",
        "proj.txt",
        "*.clean.npz",
        "odm_georeferenced_model*.la[sz]",
        "point_cloud.ply",
        "merged.ply",
    )

    def read(self, source: Path) -> Scene:
        """Cameras, depth and frame of a project."""
        opensfm = source / "opensfm" if (source / "opensfm").is_dir() else source
        path = opensfm / "reconstruction.json"
        if not path.is_file():
            raise InputError(f"{source} holds no opensfm/reconstruction.json; give the project folder of OpenDroneMap.")
        found = read_opensfm(path)
        doubts = []
        if found.others:
            doubts.append(f"{path} falls into pieces: {found.others} photos of the smaller ones are left out.")
        maps = _depth_maps(opensfm / "undistorted" / "depthmaps", found.shots)
        tied = _crs(source, found)
        local = _is_local(opensfm, found)
        clouds = [source / "odm_georeferencing" / name for name in _CLOUDS]
        cloud = next((CloudFile(file) for file in clouds if file.is_file()), None)
        epsg, poses = _poses(found, tied, local)
        if not maps and cloud is None:
            cloud = CloudFile(_local_cloud(source, opensfm))  # in the frame of reconstruction.json
            if local and tied is not None:
                cloud = CloudFile(cloud.path, np.array([*tied[1], 0.0]))
            elif epsg is not None:
                epsg, poses = None, {name: shot.T_W_cam for name, shot in found.shots.items()}
                doubts.append(f"{cloud.path} is in the local frame: no map coordinates are given.")
        if cloud is not None and not maps:
            _agree_on_crs(cloud, epsg)
        if cloud is not None and "unaligned" in cloud.path.name:
            doubts.append("the cloud was aligned to another one after its reconstruction; the unaligned one is used.")
        return Scene(
            where=str(path),
            cameras=tuple(
                FoundCamera(name, shot.lens, poses[name], maps.get(name), "has no undistorted/depthmaps/*.clean.npz")
                for name, shot in found.shots.items()
            ),
            cloud=None if maps else cloud,
            up=np.array([0.0, 0.0, 1.0]) if found.reference or tied else None,
            metres_per_unit=1.0 if found.reference or tied else None,
            epsg=epsg,
            confidence="correlation score of OpenSfM, 0..1" if maps else "constant: the cloud tells none",
            doubts=tuple(doubts),
        )


def _crs(source: Path, found: OpenSfm) -> tuple[int, tuple[float, float]] | None:
    """EPSG code of the project and the offset of its local coordinates; None when it is not georeferenced.

    Raises:
        InputError: a file tells a CRS that cannot be used.
    """
    coords = source / "odm_georeferencing" / "coords.txt"
    lines = coords.read_text(encoding="utf-8").splitlines() if coords.is_file() else []
    if len(lines) >= 2:
        try:
            east, north = (float(word) for word in lines[1].split()[:2])
        except ValueError as error:
            raise InputError(f"{coords} has no offset in its second line, but {lines[1]!r}.") from error
        return _epsg(lines[0], coords), (east, north)
    if found.reference is None:
        return None
    latitude, longitude, _ = found.reference
    zone = int((longitude + 180) // 6) % 60 + 1
    return (32600 if latitude >= 0 else 32700) + zone, (0.0, 0.0)


def _epsg(line: str, where: Path) -> int:
    utm = re.fullmatch(r"WGS84 UTM (\d{1,2})([NS])", line.strip(), re.IGNORECASE)
    if utm and 1 <= int(utm[1]) <= 60:
        return (32600 if utm[2].upper() == "N" else 32700) + int(utm[1])
    from pyproj.exceptions import CRSError

    try:
        code = projected(line.strip().strip("'"), str(where))
    except CRSError as error:
        raise InputError(f"{where} names no CRS in its first line, but {line!r}.") from error
    if code is None:
        raise InputError(f"{where} names a CRS without an EPSG code, {line!r}; run OpenDroneMap with a UTM zone.")
    return code


def _is_local(opensfm: Path, found: OpenSfm) -> bool:
    """Whether ``reconstruction.json`` is in the CRS less the offset, and not in OpenSfM's own frame."""
    path = opensfm / "reconstruction.topocentric.json"
    if not path.is_file():
        return False
    own = read_opensfm(path).shots
    shared = [name for name in own if name in found.shots]
    apart = [np.abs(own[name].T_W_cam - found.shots[name].T_W_cam).max() for name in shared]
    return bool(apart and max(apart) > 1e-6)


def _poses(
    found: OpenSfm, tied: tuple[int, tuple[float, float]] | None, local: bool
) -> tuple[int | None, dict[str, Float64[np.ndarray, "4 4"]]]:
    """EPSG code and poses in its coordinates, where the project has them; else the poses as they are."""
    as_they_are = {name: shot.T_W_cam for name, shot in found.shots.items()}
    if tied is None or (not local and found.reference is None):
        return None, as_they_are
    epsg, (east, north) = tied
    if local:
        return epsg, {name: _moved(T, np.array([east, north, 0.0])) for name, T in as_they_are.items()}
    assert found.reference is not None
    return epsg, {name: to_projected(T, found.reference, epsg) for name, T in as_they_are.items()}


def _moved(T: Float64[np.ndarray, "4 4"], by: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "4 4"]:
    T = T.copy()
    T[:3, 3] += by
    return T


def _depth_maps(folder: Path, shots: Mapping[str, Shot]) -> dict[str, Callable[[], DepthMap]]:
    """By name of the shot: what reads its cleaned depth map."""
    maps: dict[str, Callable[[], DepthMap]] = {}
    for name, shot in shots.items():
        for suffix in ("", ".tif", ".png", ".jpg"):
            path = folder / f"{name}{suffix}.clean.npz"
            if path.is_file():
                maps[name] = partial(_clean, path, shot.lens)
                break
    return maps


def _clean(path: Path, lens: Lens) -> DepthMap:
    try:
        with path.open("rb") as raw, np.load(raw) as file:
            depth, score = file["depth"].astype(np.float32), file["score"].astype(np.float32)
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise InputError(f"{path} is not a depth map of OpenSfM ({error}); compute it again.") from error
    height, width = depth.shape
    f = float(lens.K[0, 0] + lens.K[1, 1]) / 2 * width / lens.width
    K = np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1.0]])
    return DepthMap(np.where(depth > 0, depth, np.float32(np.nan)), Lens.pinhole(width, height, K), score)


def _local_cloud(source: Path, opensfm: Path) -> Path:
    """A dense cloud in the frame of ``reconstruction.json``."""
    paths = (source / "odm_filterpoints" / "point_cloud.ply", opensfm / "undistorted" / "depthmaps" / "merged.ply")
    for path in paths:
        if path.is_file():
            return path
    raise InputError(
        f"{source} holds neither odm_georeferencing/odm_georeferenced_model.laz nor depth maps; run OpenDroneMap to "
        "its point cloud (without --fast-orthophoto)."
    )


def _agree_on_crs(cloud: CloudFile, epsg: int | None) -> None:
    own = cloud.epsg()
    if own is not None and epsg is not None and own != epsg:
        raise InputError(f"{cloud.path} is in EPSG:{own} but its project in EPSG:{epsg}; run OpenDroneMap again.")
