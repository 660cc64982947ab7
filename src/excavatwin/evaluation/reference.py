"""Terrain heights from a scanner as a reference: an elevation raster in the place of an exact truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from excavatwin.errors import InputError
from excavatwin.scene.grid import Grid
from excavatwin.scene.observations import Georeference
from excavatwin.scene.taxonomy import TaskClass
from excavatwin.scene.truth import Truth


def terrain_truth(grid: Grid, height: Float32[np.ndarray, "Y X"], georeference: Georeference | None = None) -> Truth:
    """A truth that knows terrain heights and nothing else: where they are finite there is terrain on top."""
    terrain = np.where(np.isfinite(height), TaskClass.OTHER_TERRAIN, TaskClass.UNKNOWN).astype(np.uint8)
    return Truth(grid, height, height, terrain, np.zeros(grid.shape, np.uint8), georeference=georeference)


def load_elevation(path: str | Path) -> Truth:
    """A GeoTIFF of terrain heights in a projected CRS: square cells, north up, NaN or nodata where unknown.

    Raises:
        InputError: no such file, no GeoTIFF, whole numbers, no projected CRS in metres, or turned or oblong cells.
    """
    import rasterio

    try:
        with rasterio.open(path) as raster:
            height = raster.read(1, masked=True).filled(np.nan).astype(np.float64)
            at, crs = raster.transform, raster.crs
    except (rasterio.RasterioIOError, OSError) as error:
        raise InputError(f"{path} cannot be read as an elevation raster ({error}); expected a GeoTIFF.") from error
    except TypeError as error:  # whole numbers have no NaN
        raise InputError(
            f"{path} holds whole numbers; heights are expected as float32 (gdal_translate -ot Float32)."
        ) from error
    epsg = crs.to_epsg() if crs else None
    if epsg is None or not crs.is_projected:
        raise InputError(f"{path} says no projected CRS by EPSG code; write one into it (gdal_translate -a_srs).")
    if at.b or at.d or abs(at.a + at.e) > 1e-9 * at.a or at.a <= 0:
        raise InputError(f"{path} has turned or oblong cells; warp it to square cells, north up (gdalwarp -tr).")
    known = height[np.isfinite(height)]
    base = float(np.floor(known.min())) if len(known) else 0.0  # float32 keeps millimetres only of small heights
    grid = Grid(0.0, 0.0, float(at.a), *height.shape)
    return terrain_truth(grid, (height - base).astype(np.float32), Georeference(epsg, (at.c, at.f, base), 0.0))


def in_frame_of(reference: Truth, truth: Truth) -> Truth:
    """The reference's heights in the truth's frame, with the truth's photos (their pixel size) beside them.

    Raises:
        InputError: only one has a georeference, or they are in different CRS.
    """
    ours, theirs = reference.georeference, truth.georeference
    if (ours is None) != (theirs is None) or (ours and theirs and ours.epsg != theirs.epsg):
        names = [f"EPSG:{g.epsg}" if g else "no georeference" for g in (ours, theirs)]
        raise InputError(f"The elevation reference has {names[0]}, the truth {names[1]}; both must be in one CRS.")
    dx, dy, dz = np.subtract(ours.origin, theirs.origin) if ours and theirs else np.zeros(3)
    height = (reference.height + dz).astype(np.float32)
    grid = replace(reference.grid, west=reference.grid.west + float(dx), north=reference.grid.north + float(dy))
    return replace(reference, grid=grid, height=height, surface=height, views=truth.views, georeference=theirs)
