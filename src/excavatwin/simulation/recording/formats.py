"""The files of an epoch as bytes: label images, depth, elevation, laser cloud."""

from __future__ import annotations

import io
import warnings
from typing import Any

import numpy as np
from jaxtyping import Float32, Int32, UInt8
from PIL import Image

from excavatwin.scene.grid import Grid
from excavatwin.scene.observations import Georeference
from excavatwin.scene.taxonomy import TaskClass
from excavatwin.simulation.recording.laser_scan import Scan

ASPRS_GROUND, ASPRS_OTHER = 2, 64
"""Classification of terrain; of everything else, plus its task class."""


def png(values: UInt8[np.ndarray, "H W"] | Int32[np.ndarray, "H W"]) -> bytes:
    """A label image: 8 bits for classes, 16 for object ids."""
    stream = io.BytesIO()
    wide = values.dtype != np.uint8
    Image.fromarray(values.astype(np.uint16) if wide else values).save(stream, format="PNG", optimize=True)
    return stream.getvalue()


def depth_tiff(depth: Float32[np.ndarray, "H W"]) -> bytes:
    """Metres along the optical axis, NaN in the sky."""
    return _geotiff(depth, None, None)


def elevation_tiff(grid: Grid, height: Float32[np.ndarray, "Y X"], place: Georeference) -> bytes:
    """Terrain heights with the origin added, NaN where nothing was measured."""
    return _geotiff((height + place.origin[2]).astype(np.float32), grid, place)


def _geotiff(values: Float32[np.ndarray, "Y X"], grid: Grid | None, place: Georeference | None) -> bytes:
    from rasterio.crs import CRS
    from rasterio.errors import NotGeoreferencedWarning
    from rasterio.io import MemoryFile
    from rasterio.transform import Affine

    profile: dict[str, Any] = {
        "driver": "GTiff",
        "count": 1,
        "dtype": "float32",
        "height": values.shape[0],
        "width": values.shape[1],
        "nodata": np.nan,
        "compress": "DEFLATE",
        "predictor": 3,
    }
    if grid is not None and place is not None:
        west, north = grid.west + place.origin[0], grid.north + place.origin[1]
        profile |= {"transform": Affine(grid.cell, 0, west, 0, -grid.cell, north), "crs": CRS.from_epsg(place.epsg)}
    with warnings.catch_warnings(), MemoryFile() as memory:
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with memory.open(**profile) as raster:
            raster.write(values, 1)
            raster.units = ("m",)
        return bytes(memory.read())


def laz(scan: Scan, place: Georeference) -> bytes:
    """LAS 1.4, point format 6, to the millimetre; class 2 is ground, 64 + task class the rest, true classes both."""
    import laspy
    import pyproj
    from laspy.vlrs.known import WktCoordinateSystemVlr

    header = laspy.LasHeader(point_format=6, version="1.4")
    header.generating_software = "ExcavaTwin simulation"
    header.offsets = np.floor(place.origin)
    header.scales = np.full(3, 0.001)
    header.add_extra_dims(
        [
            laspy.ExtraBytesParams("task_class", "uint8", "ExcavaTwin class id 0..5"),
            laspy.ExtraBytesParams("object_id", "int32", "id in objects.json, 0 none"),
        ]
    )
    header.vlrs.append(WktCoordinateSystemVlr(pyproj.CRS.from_epsg(place.epsg).to_wkt("WKT1_GDAL")))
    header.global_encoding.wkt = True
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = (scan.xyz.astype(float) + place.origin).T
    terrain = (scan.label == TaskClass.CONSTRUCTION_TERRAIN) | (scan.label == TaskClass.OTHER_TERRAIN)
    cloud.classification = np.where(terrain, ASPRS_GROUND, ASPRS_OTHER + scan.label).astype(np.uint8)
    cloud.return_number = cloud.number_of_returns = np.ones(len(scan.xyz), np.uint8)
    cloud.task_class, cloud.object_id = scan.label, scan.instance
    stream = io.BytesIO()
    cloud.write(stream, do_compress=True, laz_backend=laspy.LazBackend.Lazrs)
    return stream.getvalue()
