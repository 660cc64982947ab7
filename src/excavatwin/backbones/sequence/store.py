"""Views on disk: arrays are written one after the other and come back as memory maps, so that memory stays flat.

Writing goes through plain file writes, not through maps: pages of a written map count as memory of the process.
"""

from __future__ import annotations

import errno
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64, Int64

from excavatwin.backbones.sequence.network import Prediction
from excavatwin.errors import OutputError

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)
"""Errors that say that a disk takes no more."""


class Stack:
    """A ``.npy`` file of ``count`` equal arrays that are appended one by one."""

    def __init__(self, path: Path, count: int, shape: tuple[int, ...], dtype: type) -> None:
        self._file = path.open("wb")
        self._item, self._dtype = shape, np.dtype(dtype)
        header: Any = {
            "descr": np.lib.format.dtype_to_descr(self._dtype), "fortran_order": False, "shape": (count, *shape)
        }  # fmt: skip
        np.lib.format.write_array_header_1_0(self._file, header)
        self._left = count

    def append(self, array: np.ndarray) -> None:
        """Write the next one."""
        assert array.shape == self._item
        assert self._left > 0
        self._file.write(np.ascontiguousarray(array, self._dtype).data)
        self._left -= 1

    def __enter__(self) -> Stack:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._file.close()
        assert kind is not None or self._left == 0


def stored(path: Path) -> np.ndarray:
    """A ``.npy`` file as a read-only memory map."""
    return np.load(path, mmap_mode="r", allow_pickle=False)


@dataclass(frozen=True)
class Chunk:
    """What a network said about some photos, in a frame of its own; points and confidence are on disk."""

    photos: tuple[int, ...]
    """Positions in the sequence."""
    T_C_cam: Float64[np.ndarray, "S 4 4"]
    """Camera-to-chunk poses [su of this chunk]."""
    K_cam: Float64[np.ndarray, "S 3 3"]
    """Intrinsics on the lattice [px]."""
    metric: bool
    faults: dict[int, str]
    """Position in the sequence -> why what the network said about that photo cannot be used."""
    path: Path
    """Of the points; the confidence is beside them."""

    def at(self, photo: int) -> int:
        """Where in the chunk a photo is."""
        return self.photos.index(photo)

    def points(self, photo: int) -> Float32[np.ndarray, "H W 3"]:
        """Point map of a photo in the frame of the chunk; NaN where there is none."""
        return stored(self.path)[self.at(photo)]

    def confidence(self, photo: int) -> Float32[np.ndarray, "H W"]:
        """Confidence of the points of a photo."""
        return stored(_beside(self.path))[self.at(photo)]

    def sample(self, photo: int, count: int) -> tuple[Int64[np.ndarray, "n"], Float64[np.ndarray, "n 3"]]:
        """About ``count`` pixels (flat index) on a regular grid, and their points."""
        points = self.points(photo)
        at = grid(points.shape[0], points.shape[1], count)
        return at, np.asarray(points.reshape(-1, 3)[at], float)

    def delete(self) -> None:
        """Free the disk."""
        self.path.unlink(missing_ok=True)
        _beside(self.path).unlink(missing_ok=True)


def keep(prediction: Prediction, photos: tuple[int, ...], faults: dict[int, str], path: Path) -> Chunk:
    """Write a prediction to disk and forget its arrays."""
    np.save(path, np.asarray(prediction.points, np.float32))
    np.save(_beside(path), np.asarray(prediction.confidence, np.float32))
    return Chunk(
        photos,
        np.asarray(prediction.T_world_cam, float),
        np.asarray(prediction.K_cam, float),
        bool(prediction.metric),
        faults,
        path,
    )


def grid(height: int, width: int, count: int) -> Int64[np.ndarray, "n"]:
    """Flat indices of about ``count`` pixels in equal steps along rows and columns."""
    step = max(1, round(float(np.sqrt(height * width / count))))
    rows, cols = np.arange(step // 2, height, step), np.arange(step // 2, width, step)
    return (rows[:, None] * width + cols).ravel()


@contextmanager
def disk(folder: Path, photos: int, shape: tuple[int, int], repeated: float) -> Iterator[None]:
    """Work in a folder that must hold views of so many photos.

    Args:
        folder: of the files.
        photos: in the sequence.
        shape: (H, W) of the lattice.
        repeated: how many times each photo is predicted on average.

    Raises:
        OutputError: the disk is too small, or became full.
    """
    need = photos * shape[0] * shape[1] * (16 * (1 + repeated) + 3)
    free = shutil.disk_usage(folder).free
    if need > free:
        raise OutputError(
            f"{photos} photos on {shape[1]} x {shape[0]} px need {need / 1e9:.1f} GB in {folder} and {free / 1e9:.1f} "
            "GB are free; free some space, or use fewer photos or a smaller lattice."
        )
    try:
        yield
    except OSError as error:
        if isinstance(error, OutputError) or error.errno not in FULL:
            raise
        raise OutputError(f"{folder} cannot be written ({error.strerror}); free some space on its disk.") from error


def _beside(path: Path) -> Path:
    return path.with_name(path.name.replace("points", "confidence"))
