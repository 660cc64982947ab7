"""``elevation.tif`` and ``label.tif``: cloud-optimised GeoTIFFs, the files that QGIS opens by double click."""

from __future__ import annotations

import warnings
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
import rasterio
from rasterio.crs import CRS
from rasterio.errors import NotGeoreferencedWarning
from rasterio.io import MemoryFile
from rasterio.transform import Affine

from excavatwin.export.placement import LOCAL_WKT, frame_sentence, origin_of
from excavatwin.scene.elevation_map import LAYERS, ElevationMap, Layer
from excavatwin.scene.taxonomy import PALETTE

_LAYERS = {layer.name: layer for layer in LAYERS}


def encode_geotiff(elevation_map: ElevationMap, name: str) -> bytes:
    """One layer of the map as a cloud-optimised GeoTIFF with nodata, overviews, unit, and classes where it has them.

    Heights are map coordinates: the origin's elevation is added.
    """
    layer = _LAYERS[name]
    is_float = np.dtype(layer.dtype).kind == "f"
    values = getattr(elevation_map, name)
    origin = origin_of(elevation_map)
    if name in ("elevation", "object_top", "object_base"):
        values = (values + origin[2]).astype(np.float32)
    grid = elevation_map.grid
    profile: dict[str, Any] = {
        "driver": "COG",
        "count": 1,
        "dtype": layer.dtype,
        "height": grid.rows,
        "width": grid.cols,
        "transform": Affine(grid.cell, 0.0, grid.west + origin[0], 0.0, -grid.cell, grid.north + origin[1]),
        "crs": _crs(elevation_map),
        "nodata": layer.fill,
        "compress": "DEFLATE",
        "predictor": "YES" if is_float else "NO",
        "overview_resampling": "AVERAGE" if is_float else "MODE",
        "blocksize": 256,
        "num_threads": 1,
    }
    with warnings.catch_warnings(), MemoryFile() as memory:
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.Env(GDAL_PAM_ENABLED=False), memory.open(**profile) as raster:
            raster.write(values, 1)
            raster.set_band_description(1, name)
            raster.units = (elevation_map.unit if layer.unit == "m" else "",)
            raster.update_tags(frame=frame_sentence(elevation_map), doubts="\n".join(elevation_map.doubts) or "none")
            _describe(raster, layer)
        return bytes(memory.read())


def _describe(raster: Any, layer: Layer) -> None:
    """Meaning, class names as band tags ``class_<id>``, and the colour table."""
    names = layer.categories
    raster.update_tags(1, meaning=layer.meaning, **{f"class_{value}": name for value, name in names.items()})
    if layer.name == "label":
        opaque = {int(k): (*rgb, 0 if int(k) == layer.fill else 255) for k, rgb in PALETTE.items()}
        raster.write_colormap(1, opaque)


def category_sidecar(name: str) -> str:
    """``<layer>.tif.aux.xml``: class names where GDAL and QGIS look for them when they draw a legend."""
    names = _LAYERS[name].categories
    last = max(value for value in names if value != _LAYERS[name].fill)
    rows = "".join(f"      <Category>{escape(names.get(value, ''))}</Category>\n" for value in range(last + 1))
    return (
        '<PAMDataset>\n  <PAMRasterBand band="1">\n    <CategoryNames>\n'
        f"{rows}    </CategoryNames>\n  </PAMRasterBand>\n</PAMDataset>\n"
    )


def _crs(elevation_map: ElevationMap) -> CRS | None:
    if elevation_map.georeference is not None:
        return CRS.from_epsg(elevation_map.georeference.epsg)
    return CRS.from_wkt(LOCAL_WKT) if elevation_map.metric else None
