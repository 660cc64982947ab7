"""What a reader finds in the files of another program, before any photo or depth map is opened."""

from __future__ import annotations

import filecmp
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from excavatwin.backbones.finished.clouds import CloudFile
from excavatwin.backbones.finished.lenses import Lens
from excavatwin.backbones.finished.posed_depth import DepthMap
from excavatwin.errors import InputError
from excavatwin.scene.photo import Photo


@dataclass(frozen=True)
class FoundCamera:
    """A camera of a finished reconstruction."""

    name: str
    """Of its image: file name or relative path."""
    lens: Lens | None
    """Of the image as the other program read it; None where the files tell none: then the photo's own focal length."""
    T_W_cam: Float64[np.ndarray, "4 4"]
    """Camera-to-world, OpenCV axes, in float64 and in the coordinates of the files [su]."""
    depth: Callable[[], DepthMap] | None = None
    """Reads its depth map; None when it has none."""
    lack: str = "has no depth map"
    """Why it has none."""
    undistorted: tuple[Lens, Path] | None = None
    """Lens and file of the same image after another program undistorted it, where it did."""

    def lens_of(self, photo: Photo) -> Lens:
        """The lens of the photo: it may be the undistorted image, told by the file itself or by its size.

        Raises:
            InputError: nobody tells a focal length.
        """
        own = self.lens or _lens_by_exif(photo)
        if self.undistorted is None:
            return own
        lens, path = self.undistorted
        size = (photo.width, photo.height)
        if size == lens.size != own.size:
            return lens
        return lens if size == lens.size and _same_file(photo.path, path) else own


@dataclass(frozen=True)
class Scene:
    """What a reader found, before any photo or depth map is opened."""

    where: str
    """File or folder, for messages."""
    cameras: tuple[FoundCamera, ...]
    cloud: CloudFile | None = None
    """Seen by the photos where no camera has a depth map."""
    up: Float64[np.ndarray, "3"] | None = None
    metres_per_unit: float | None = None
    epsg: int | None = None
    """The coordinates of the files are those of this projected CRS."""
    confidence: str = "constant: the files tell none"
    """Kind of the confidence."""
    doubts: tuple[str, ...] = ()

    @property
    def splatted(self) -> bool:
        """Whether depth comes from the cloud."""
        return all(camera.depth is None for camera in self.cameras)


def _lens_by_exif(photo: Photo) -> Lens:
    if photo.focal is None:
        raise InputError(
            f"neither the file of cameras nor {photo.name} tells a focal length; add columns f, width and height [px]."
        )
    K = np.array([[photo.focal, 0, photo.width / 2], [0, photo.focal, photo.height / 2], [0, 0, 1]])
    return Lens.pinhole(photo.width, photo.height, K)


def _same_file(a: Path, b: Path) -> bool:
    if not b.is_file():
        return False
    return a.samefile(b) or filecmp.cmp(a, b, shallow=False)
