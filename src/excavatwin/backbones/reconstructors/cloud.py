"""A point cloud (LAS, LAZ, PLY) that the photos look at, with cameras from a file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from excavatwin.backbones.cards import Card, Tried
from excavatwin.backbones.finished.camera_files import beside, read_cameras
from excavatwin.backbones.finished.clouds import SUFFIXES, CloudFile
from excavatwin.backbones.finished.found import Scene
from excavatwin.backbones.finished.reader import Finished
from excavatwin.errors import InputError


@dataclass(frozen=True)
class Cloud(Finished):
    """Every photo sees the first surface of the cloud along the rays of its pixels, and nothing where there is none.

    Cloud and cameras are in one frame. A laser scan or a cloud of any photogrammetry will do; its density limits how
    far in front of a surface another one must lie to hide it: about one point spacing.
    """

    card: ClassVar[Card] = Card(
        name="cloud",
        kind="reconstructor",
        summary="a point cloud (LAS, LAZ, PLY) with cameras from a SITE, COLMAP, OpenSfM, nerfstudio or a table",
        tried=Tried.FILES,
        modules=("pycolmap", "cv2", "laspy", "pyproj"),
        install="pip install --upgrade excavatwin",
        argument="source",
        source="docs/backbones.md",
    )
    watched: ClassVar[tuple[str, ...]] = ("*.las", "*.laz", "*.ply", "*.json", "*.csv", "*.bin", "*.txt")

    cameras: str = ""
    """File of cameras, or folder of a COLMAP model; empty for what lies beside the cloud."""

    def read(self, source: Path) -> Scene:
        """Cloud and cameras."""
        cloud = CloudFile(_cloud_in(source))
        epsg = cloud.epsg()
        path = Path(self.cameras).expanduser() if self.cameras else beside(cloud.path)
        if not path.exists():
            raise InputError(f"{path} does not exist; give the cameras of {cloud.path}.")
        found = read_cameras(path, epsg)
        return Scene(
            where=f"{cloud.path} with {path}",
            cameras=found.cameras,
            cloud=cloud,
            up=np.array([0.0, 0.0, 1.0]) if found.upright or epsg else None,
            metres_per_unit=1.0 if found.metric or epsg else None,
            epsg=epsg,
            confidence="constant: the cloud tells none",
            doubts=found.doubts,
        )

    def identity(self) -> str:
        """As of all readers, and the file of cameras where it lies elsewhere."""
        path = Path(self.cameras).expanduser() if self.cameras else None
        if path is None or not path.is_file():
            return super().identity()
        stat = path.stat()
        return f"{super().identity()}; cameras {stat.st_size} {stat.st_mtime_ns}"


def _cloud_in(source: Path) -> Path:
    if source.is_file():
        if source.suffix.lower() not in SUFFIXES:
            raise InputError(f"{source} is no point cloud that can be read; expected {', '.join(SUFFIXES)}.")
        return source
    found = sorted(path for path in source.iterdir() if path.suffix.lower() in SUFFIXES)
    if len(found) != 1:
        many = f"holds {len(found)} point clouds" if found else f"holds no point cloud ({', '.join(SUFFIXES)})"
        raise InputError(f"{source} {many}; name the one: --reconstructor cloud:FILE.")
    return found[0]
