"""Arrays from the files of data sets, checked as they are read. Each raises ``InputError`` naming the file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64, UInt8, UInt16

from excavatwin.errors import InputError
from excavatwin.scene.grid import Grid
from excavatwin.scene.recording import ElevationReference, PointCloud

#: Returns nearer than this are "no return", written as zeros [m].
NO_RANGE = 1e-3


def read_rgb(path: Path) -> UInt8[np.ndarray, "H W 3"]:
    """An image file as 8-bit RGB."""
    return np.array(_image(path).convert("RGB"))


def read_ids(path: Path) -> UInt8[np.ndarray, "H W"]:
    """A label image of class ids (mode L, or indices of a palette)."""
    ids = np.array(_image(path))
    if ids.ndim != 2 or ids.dtype != np.uint8:
        raise InputError(f"{path} is no label image: {ids.dtype} {ids.shape}; expected one channel of 8-bit class ids.")
    return ids


def read_wide_ids(path: Path) -> UInt16[np.ndarray, "H W"]:
    """A label image of object ids, 8 or 16 bits."""
    ids = np.array(_image(path))
    if ids.ndim != 2 or ids.dtype.kind not in "iu" or ids.min() < 0 or ids.max() > 65535:
        raise InputError(f"{path} is no image of object ids: {ids.dtype} {ids.shape}; expected one 16-bit channel.")
    return ids.astype(np.uint16)


def read_depth_256(path: Path) -> Float32[np.ndarray, "H W"]:
    """A depth image of 16 bits, metres times 256, 0 = none (the convention of KITTI)."""
    raw = np.array(_image(path))
    if raw.ndim != 2 or raw.dtype.kind not in "iu" or raw.dtype == np.uint8:
        raise InputError(
            f"{path} is no depth image: {raw.dtype} {raw.shape}; expected one 16-bit channel, metres * 256."
        )
    return np.where(raw > 0, raw / np.float32(256), np.nan).astype(np.float32)


def read_depth_metres(path: Path) -> Float32[np.ndarray, "H W"]:
    """A float32 TIFF of metres along the optical axis, NaN = none."""
    import warnings

    import rasterio
    from rasterio.errors import NotGeoreferencedWarning, RasterioError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(path) as file:
                depth: np.ndarray = file.read(1)
    except (RasterioError, OSError) as error:
        raise InputError(f"{path} cannot be read as a depth image ({error}).") from error
    return depth.astype(np.float32)


def read_elevation(path: Path, origin: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> ElevationReference:
    """A one-band GeoTIFF of terrain heights, less the origin of the map frame."""
    import warnings

    import rasterio
    from rasterio.errors import NotGeoreferencedWarning, RasterioError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(path) as file:
                height, where, nodata = file.read(1).astype(np.float64), file.transform, file.nodata
    except (RasterioError, OSError) as error:
        raise InputError(f"{path} cannot be read as an elevation raster ({error}).") from error
    if where.b or where.d or where.a <= 0 or abs(where.a + where.e) > 1e-9 * where.a:
        raise InputError(f"{path} is not north-up with square cells; expected an unrotated GeoTIFF.")
    if nodata is not None and np.isfinite(nodata):
        height[height == nodata] = np.nan
    rows, cols = height.shape
    grid = Grid(where.c - origin[0], where.f - origin[1], where.a, rows, cols)
    return ElevationReference(grid, (height - origin[2]).astype(np.float32))


def read_scan(path: Path, labels: Path | None = None, columns: int = 4, highest: int | None = None) -> PointCloud:
    """A ``.bin`` of float32 rows (x, y, z, intensity, ...) with its SemanticKITTI ``.label``.

    Rows without a return are dropped together with their labels.

    Args:
        columns: numbers in a row.
        highest: greatest class id of the vocabulary.
    """
    raw = _numbers(path, np.dtype("<f4"))
    if raw.size % columns:
        raise InputError(f"{path} holds {raw.size} numbers, not rows of {columns}; copy it again.")
    rows = raw.reshape(-1, columns)
    seen = np.isfinite(rows[:, :3]).all(1) & (np.linalg.norm(rows[:, :3], axis=1) >= NO_RANGE)
    xyz, intensity = rows[seen, :3].copy(), rows[seen, 3].copy() if columns > 3 else None
    if labels is None:
        return PointCloud(xyz, intensity=intensity)
    ids = _numbers(labels, np.dtype("<u4"))
    if len(ids) != len(rows):
        raise InputError(f"{labels} holds {len(ids)} labels for the {len(rows)} rows of {path.name}; copy it again.")
    label, instance = (ids & 0xFFFF).astype(np.uint16)[seen], (ids >> 16).astype(np.uint16)[seen]
    if highest is not None and len(label) and label.max() > highest:
        raise InputError(f"{labels} holds class id {label.max()}, but ids end at {highest}: the file is corrupted.")
    return PointCloud(xyz, label, instance, intensity=intensity)


def read_laz(path: Path, origin: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> PointCloud:
    """A LAS or LAZ cloud, less the origin of the map frame; class 2 of the ASPRS is ground.

    Extra dimensions ``task_class`` and ``object_id``, as our simulation writes them, become labels and instances.
    """
    import laspy

    try:
        cloud = laspy.read(path)
    except (OSError, ValueError, RuntimeError, laspy.errors.LaspyException) as error:  # of lazrs: RuntimeError
        raise InputError(f"{path} cannot be read as a LAS or LAZ cloud ({error}).") from error
    xyz = np.stack([np.asarray(axis, np.float64) for axis in (cloud.x, cloud.y, cloud.z)], -1) - origin
    extra = {name: np.asarray(cloud[name], np.uint16) for name in cloud.point_format.extra_dimension_names}
    ground = np.asarray(cloud.classification) == 2
    return PointCloud(xyz.astype(np.float32), extra.get("task_class"), extra.get("object_id"), ground)


def read_matrix(path: Path, columns: int) -> Float64[np.ndarray, "n c"]:
    """A text file of rows of numbers."""
    try:
        rows = [[float(word) for word in line.split()] for line in path.read_text("utf-8").splitlines() if line.strip()]
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read as rows of numbers ({error}).") from error
    wrong = next((i for i, row in enumerate(rows) if len(row) != columns), None)
    if wrong is not None:
        raise InputError(f"{path}: row {wrong} has {len(rows[wrong])} numbers; expected {columns}.")
    return np.array(rows, float).reshape(-1, columns)


def read_json(path: Path) -> Any:
    """A JSON file."""
    try:
        return json.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read as JSON ({error}).") from error


def _image(path: Path) -> Any:
    from PIL import Image

    try:
        with Image.open(path) as image:
            image.load()
            return image.copy()
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError(f"{path} cannot be decoded ({error}); copy it again.") from error


def _numbers(path: Path, kind: np.dtype[Any]) -> np.ndarray:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}).") from error
    if len(content) % kind.itemsize:
        raise InputError(f"{path} has {len(content)} bytes, not a multiple of {kind.itemsize}; copy it again.")
    return np.frombuffer(content, kind)
