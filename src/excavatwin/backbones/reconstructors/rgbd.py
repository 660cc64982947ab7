"""Sequences of a depth camera: TUM's lists by time, or folders of colour, depth and poses (ScanNet, Redwood, 7-Scenes).

Facts: TUM RGB-D (Sturm et al. 2012, https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats): 16-bit PNG, 5000
a metre, 0 = none; ``groundtruth.txt`` is time, position and quaternion (x, y, z, w) of the colour camera in the world;
times are matched within 0.02 s; depth is registered to colour. ScanNet's and Redwood's depths are millimetres, their
poses camera-to-world. All count the first pixel's centre as 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import Float64

from excavatwin.backbones.cards import Card, Tried
from excavatwin.backbones.finished import sequences
from excavatwin.backbones.finished.depth_images import image_size, read_depth
from excavatwin.backbones.finished.found import FoundCamera, Scene
from excavatwin.backbones.finished.lenses import Lens
from excavatwin.backbones.finished.posed_depth import DepthMap
from excavatwin.backbones.finished.reader import Finished
from excavatwin.errors import InputError, require

_COLOUR = ("color", "colour", "rgb", "image", "images")
_POSES = ("pose", "poses")
_INTRINSICS = ("intrinsics.txt", "intrinsic.txt", "camera.txt", "camera-intrinsics.txt", "camera_intrinsic.json")
_PICTURES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")


@dataclass(frozen=True)
class Rgbd(Finished):
    """A folder of a depth camera, in metres.

    Either ``rgb.txt``, ``depth.txt`` and ``groundtruth.txt`` (TUM), or ``color/``, ``depth/`` and ``pose/NAME.txt`` or
    ``trajectory.log``. Intrinsics stand in ``intrinsic/intrinsic_color.txt`` (and ``intrinsic_depth.txt``),
    ``intrinsics.txt``, ``camera.txt`` or ``camera_intrinsic.json``, or in the parameter.
    """

    card: ClassVar[Card] = Card(
        name="rgbd",
        kind="reconstructor",
        summary="folders of a depth camera: TUM RGB-D, or colour, depth, poses and intrinsics (ScanNet, Redwood)",
        tried=Tried.FILES,
        modules=("pycolmap", "cv2"),
        install="pip install --upgrade excavatwin",
        argument="source",
        metric=True,
        source="https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats",
    )
    watched: ClassVar[tuple[str, ...]] = ("*.txt", "*.log", "*.json", "*depth*/*")

    depth_per_metre: float | None = None
    """Depth value of one metre; None for 5000 in TUM's layout and 1000 elsewhere."""
    intrinsics: tuple[float, ...] = ()
    """fx, fy, cx, cy of the colour images, then k1, k2, p1, p2, k3 where they distort; empty reads them from a file."""
    first_centre: float = 0.0
    """Where those intrinsics, and those in files, put the centre of the first pixel: 0 (OpenCV), or 0.5 [px]."""
    apart: float = 0.02
    """Most time between an image, its depth and its pose in TUM's layout [s]."""

    def __post_init__(self) -> None:
        """Check the parameters."""
        super().__post_init__()
        require(self, "depth_per_metre", 0, open_low=True)
        require(self, "apart", 0)
        if len(self.intrinsics) not in (0, 4, 8, 9):
            raise InputError(f"Rgbd.intrinsics has {len(self.intrinsics)} numbers; expected fx, fy, cx, cy (and lens).")

    def read(self, source: Path) -> Scene:
        """Images, depth maps and poses."""
        if not source.is_dir():
            raise InputError(f"{source} is a file; give the folder of the sequence.")
        tum = (source / "rgb.txt").is_file()
        rows, doubts = self._tum(source) if tum else self._folders(source)
        per_metre = self.depth_per_metre or (5000.0 if tum else 1000.0)
        cameras = []
        for name, picture, depth, T in rows:
            lens, of_depth = self._lenses(source, image_size(picture))
            read = None if depth is None else partial(_depth, depth, 1 / per_metre, of_depth)
            cameras.append(FoundCamera(name, lens, T, read, "has no depth image"))
        if not any(camera.depth for camera in cameras):
            raise InputError(f"no image of {source} has both a pose and a depth image; copy the whole sequence.")
        return Scene(str(source), tuple(cameras), metres_per_unit=1.0, doubts=doubts)

    def _tum(self, source: Path) -> tuple[list[tuple[str, Path, Path | None, np.ndarray]], tuple[str, ...]]:
        times, images = sequences.timed(source / "rgb.txt")
        depth_times, depths = sequences.timed(source / "depth.txt")
        pose_times, poses = sequences.timed(source / "groundtruth.txt")
        rows, lost = [], 0
        for time, (name, *_) in zip(times, images, strict=True):
            at, of_depth = (sequences.nearest(t, time, self.apart) for t in (pose_times, depth_times))
            if at is None:
                lost += 1
                continue
            T = sequences.quaternion_pose(poses[at], f"{source / 'groundtruth.txt'}")
            rows.append((name, source / name, None if of_depth is None else source / depths[of_depth][0], T))
        said = f"{lost} images of {source} have no pose within {self.apart:g} s." if lost else ""
        return rows, (said,) if said else ()

    def _folders(self, source: Path) -> tuple[list[tuple[str, Path, Path | None, np.ndarray]], tuple[str, ...]]:
        colour = next((source / name for name in _COLOUR if (source / name).is_dir()), None)
        if colour is None or not (source / "depth").is_dir():
            raise InputError(f"{source} has no rgb.txt and no color/ and depth/; give the folder of an RGB-D sequence.")
        depths = {path.stem: path for path in (source / "depth").iterdir() if path.suffix in (".png", ".tif", ".npy")}
        images = sorted(path for path in colour.iterdir() if path.suffix.lower() in _PICTURES)
        poses, lost = _poses(source, images), 0
        rows = []
        for path in images:
            T = poses.get(path.stem)
            if T is None:
                lost += 1
                continue
            rows.append((f"{colour.name}/{path.name}", path, depths.get(path.stem), T))
        return rows, (f"{lost} images of {source} have no pose (tracking lost).",) if lost else ()

    def _lenses(self, source: Path, size: tuple[int, int]) -> tuple[Lens, Lens]:
        """Lenses of the colour and of the depth images; one and the same without a file for depth."""
        values = np.array(self.intrinsics) if self.intrinsics else None
        both = [source / "intrinsic" / f"intrinsic_{kind}.txt" for kind in ("color", "depth")]
        if values is None:
            single = [both[0], *(source / name for name in _INTRINSICS)]
            path = next((path for path in single if path.is_file()), None)
            if path is None:
                raise InputError(
                    f"{source} has no intrinsics ({', '.join(_INTRINSICS)}); write fx fy cx cy into one of these files."
                )
            values = sequences.intrinsics(path)
        colour = self._lens(values, size)
        if self.intrinsics or not both[1].is_file():
            return colour, colour
        depth = next(iter(sorted((source / "depth").iterdir())))
        return colour, self._lens(sequences.intrinsics(both[1]), image_size(depth))

    def _lens(self, values: Float64[np.ndarray, "n"], size: tuple[int, int]) -> Lens:
        fx, fy, cx, cy, *terms = (float(value) for value in values)
        half = 0.5 - self.first_centre
        k1, k2, p1, p2, k3 = (*terms, 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
        return Lens.brown(*size, (fx, fy, cx + half, cy + half), (k1, k2, k3), (p1, p2))


def _poses(source: Path, images: list[Path]) -> dict[str, Float64[np.ndarray, "4 4"] | None]:
    """By stem of the image; None where tracking was lost."""
    for folder in (source / name for name in _POSES):
        if folder.is_dir():
            files = {path.stem: path for path in folder.glob("*.txt")}
            return {stem: sequences.pose(sequences.matrix(path), str(path)) for stem, path in files.items()}
    log = next(iter(sorted(source.glob("*.log"))), None)
    if log is None:
        raise InputError(f"{source} has neither pose/ nor trajectory.log; give a sequence with poses.")
    poses = sequences.trajectory(log)
    if len(poses) != len(images):
        raise InputError(f"{log} has {len(poses)} poses for {len(images)} images; expected one for each.")
    return {path.stem: T for path, T in zip(images, poses, strict=True)}


def _depth(path: Path, unit: float, lens: Lens) -> DepthMap:
    depth = read_depth(path, unit)
    return DepthMap(depth, lens.resized(depth.shape[1], depth.shape[0]))
