"""Point clouds on disk: LAS, LAZ and PLY, read piece by piece and thinned to what the photos can show."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64

from excavatwin.backbones.finished.ply import ply_vertices
from excavatwin.errors import InputError

SUFFIXES = (".las", ".laz", ".ply")
#: Points read at once.
CHUNK = 1_000_000


@dataclass(frozen=True)
class CloudFile:
    """A point cloud that has not been read yet."""

    path: Path
    shift: Float64[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    """Added to its coordinates to bring them into the frame of the cameras."""

    def chunks(self) -> Iterator[Float64[np.ndarray, "n 3"]]:
        """Finite positions in the frame of the cameras, a million at a time.

        Raises:
            InputError: the file cannot be read.
        """
        for xyz in _ply(self.path) if self.path.suffix.lower() == ".ply" else _las(self.path):
            finite = np.isfinite(xyz).all(axis=1)
            yield (xyz if finite.all() else xyz[finite]) + self.shift

    def sample(self, most: int = 200_000) -> Float64[np.ndarray, "n 3"]:
        """Every so many-th point.

        Raises:
            InputError: the file holds no point.
        """
        step = max(1, self.count() // most)
        found, passed = [], 0
        for xyz in self.chunks():
            found.append(xyz[(-passed) % step :: step])
            passed += len(xyz)
        if not passed:
            raise InputError(f"{self.path} holds no points; give the dense point cloud.")
        return np.concatenate(found)

    def count(self) -> int:
        """Number of points that the header promises."""
        if self.path.suffix.lower() == ".ply":
            return ply_vertices(self.path).count
        with _opened(self.path) as reader:
            return int(reader.header.point_count)

    def epsg(self) -> int | None:
        """Code of its projected CRS in metres; None when the file does not tell.

        Raises:
            InputError: its coordinates are degrees, or not metres.
        """
        if self.path.suffix.lower() == ".ply":
            return None
        with _opened(self.path) as reader:
            crs = reader.header.parse_crs()
        return None if crs is None else projected(crs, str(self.path))


def projected(crs: object, where: str) -> int | None:
    """EPSG code of a projected CRS in metres (the horizontal part of a compound one), None for a local one.

    Raises:
        InputError: it is geographic, or its unit is not the metre.
    """
    import pyproj

    crs = pyproj.CRS.from_user_input(crs)
    horizontal = crs.sub_crs_list[0] if crs.is_compound else crs
    if horizontal.is_geographic or horizontal.is_geocentric:
        raise InputError(f"{where} is in {horizontal.name}, not in a projected CRS; convert it to UTM first.")
    units = {axis.unit_name for axis in horizontal.axis_info if axis.unit_name}
    if units and units != {"metre"}:
        raise InputError(f"{where} counts in {' and '.join(sorted(units))}; convert it to metres first.")
    code = horizontal.to_epsg(min_confidence=60)
    return int(code) if code else None


def thinned(file: CloudFile, origin: Float64[np.ndarray, "3"], edge: float) -> Float32[np.ndarray, "n 3"]:
    """The first point of every cube of ``edge``, less ``origin``; 0 keeps all."""
    parts: list[Float32[np.ndarray, "n 3"]] = []
    for xyz in file.chunks():
        parts.append(_one_each((xyz - origin).astype(np.float32), edge))
        if sum(map(len, parts[1:])) > max(CHUNK, len(parts[0])):  # doubling keeps the work linear
            parts = [_one_each(np.concatenate(parts), edge)]
    if not parts:
        return np.zeros((0, 3), np.float32)
    return _one_each(np.concatenate(parts), edge) if len(parts) > 1 else parts[0]


def _one_each(xyz: Float32[np.ndarray, "n 3"], edge: float) -> Float32[np.ndarray, "m 3"]:
    if edge <= 0 or not len(xyz):
        return xyz
    cell = np.floor(xyz / np.float32(edge)).astype(np.int64)
    near = (np.abs(cell) < 1 << 20).all(axis=1)  # 21 bits each; what lies a million cubes away shows in no photo
    cell, xyz = cell[near] + (1 << 20), xyz[near]
    _, first = np.unique(cell[:, 0] << 42 | cell[:, 1] << 21 | cell[:, 2], return_index=True)
    return xyz[np.sort(first)]


def _ply(path: Path) -> Iterator[Float64[np.ndarray, "n 3"]]:
    return ply_vertices(path).chunks(CHUNK)


def _las(path: Path) -> Iterator[Float64[np.ndarray, "n 3"]]:
    with _opened(path) as reader:
        chunks = reader.chunk_iterator(CHUNK)
        while True:
            try:
                points = next(chunks)
            except StopIteration:
                return
            except Exception as error:
                raise _damaged(path, error) from error
            yield np.stack([np.asarray(points.x), np.asarray(points.y), np.asarray(points.z)], axis=1)


def _opened(path: Path):  # type: ignore[no-untyped-def]  # laspy has no types
    import laspy

    try:
        return laspy.open(path)
    except Exception as error:
        raise _damaged(path, error) from error


def _damaged(path: Path, error: Exception) -> InputError:
    """Laspy, lazrs and struct raise half a dozen types on damaged files, when they open them and when they read on."""
    return InputError(f"{path} cannot be read as LAS or LAZ ({error}); copy it again or export it anew.")
