"""COLMAP's folders: sparse models, and what its dense steps leave behind (https://colmap.github.io/format.html)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64

from excavatwin.backbones.finished.lenses import Lens
from excavatwin.errors import InputError
from excavatwin.scene.frames import invert_rigid

_PARTS = ("cameras", "images", "points3D")


@dataclass(frozen=True)
class PosedImage:
    """An image of a sparse model."""

    lens: Lens
    T_W_cam: Float64[np.ndarray, "4 4"]


@dataclass(frozen=True)
class SparseModel:
    """A sparse model: which image was taken where."""

    folder: Path
    images: dict[str, PosedImage]
    """By name, relative to the image folder."""


def is_model(folder: Path) -> bool:
    """Whether a folder holds a binary or a text model."""
    return any(all((folder / f"{part}{suffix}").is_file() for part in _PARTS) for suffix in (".bin", ".txt"))


def models_in(folder: Path) -> list[Path]:
    """Models in a folder: itself, its ``sparse``, the numbered ones in there, and those right below."""
    near = [folder, folder / "sparse"]
    inside = [child for parent in near if parent.is_dir() for child in sorted(parent.iterdir()) if child.is_dir()]
    found = [path for path in (*near, *inside) if is_model(path)]
    return list(dict.fromkeys(path.resolve() for path in found))


def read_model(folder: Path) -> SparseModel:
    """Cameras and poses of the images that were registered.

    Raises:
        InputError: the files are damaged or hold no posed image.
    """
    import pycolmap

    try:
        model = pycolmap.Reconstruction(folder)
    except Exception as error:  # pycolmap passes on whatever COLMAP throws
        first = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{folder} cannot be read as a COLMAP model ({first}); export it again.") from error
    images = {}
    for image_id in sorted(model.reg_image_ids()):
        image = model.image(image_id)
        if not image.has_pose:
            continue
        camera = model.camera(image.camera_id)
        lens = Lens(int(camera.width), int(camera.height), camera.model.name, tuple(float(p) for p in camera.params))
        T_cam_W = np.eye(4)
        T_cam_W[:3] = image.cam_from_world().matrix()
        images[image.name] = PosedImage(lens, invert_rigid(T_cam_W))
    if not images:
        raise InputError(f"{folder} holds no image with a pose; give the model that COLMAP's mapper wrote.")
    return SparseModel(folder, images)


def read_array(path: Path) -> Float32[np.ndarray, "h w"]:
    """A depth map as COLMAP stores it: ``width&height&channels&``, then float32 row by row; 0 = none becomes NaN.

    Raises:
        InputError: the header is none, or the file is too short.
    """
    with path.open("rb") as file:
        head = file.read(64)
        parts = head.split(b"&", 3)
        if len(parts) < 4 or not all(part.isdigit() for part in parts[:3]):
            raise InputError(f"{path} is not a depth map of COLMAP; it should begin with 'width&height&1&'.")
        width, height, channels = (int(part) for part in parts[:3])
        file.seek(sum(len(part) + 1 for part in parts[:3]))
        values = np.fromfile(file, "<f4")
    if channels != 1 or len(values) != width * height:
        raise InputError(
            f"{path} promises {width} x {height} x {channels} values but holds {len(values)}; compute it again."
        )
    depth = values.reshape(height, width).astype(np.float32)
    return np.where(depth > 0, depth, np.float32(np.nan))


def depth_maps(dense: Path) -> Path:
    """Where the depth maps of a dense workspace lie."""
    return dense / "stereo" / "depth_maps"


def dense_folder(source: Path) -> Path | None:
    """The dense workspace in or around a folder: the one with the most depth maps, else one with a fused cloud."""
    around = [source, source / "dense", source.parent if source.name in ("sparse", "stereo", "images") else source]
    if (source / "dense").is_dir():
        around += sorted(child for child in (source / "dense").iterdir() if child.is_dir())
    found = [(_maps(folder), (folder / "fused.ply").is_file(), -n) for n, folder in enumerate(around)]
    best = max(range(len(around)), key=lambda n: found[n])
    return around[best] if found[best][0] or found[best][1] else None


def _maps(dense: Path) -> int:
    folder = depth_maps(dense)
    return sum(1 for _ in folder.rglob("*.bin")) if folder.is_dir() else 0
