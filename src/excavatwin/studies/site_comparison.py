"""``excavatwin compare``: two SITE folders of one site, and the folder of what came out."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from excavatwin.evaluation.comparison import Comparison, compare
from excavatwin.evaluation.comparison_site import read_compared
from excavatwin.evaluation.comparison_tables import to_csv, to_json
from excavatwin.export.placement import crs_of, frame_sentence, origin_of
from excavatwin.scene.staging import whole_folder

MARK = "comparison.json"
"""The file by which the folder of a comparison is known."""
OURS = (MARK, "comparison.csv", "comparison.png", "difference.tif")


def compare_folders(a: Path, b: Path, way: str = "auto") -> Comparison:
    """Compare the map of SITE ``b`` with that of SITE ``a``.

    Raises:
        InputError: one is no SITE or damaged, or they cannot be brought into one frame, or lie apart.
    """
    return compare(read_compared(a), read_compared(b), way)


def write_comparison(c: Comparison, folder: Path) -> list[Path]:
    """Write the folder, whole or not at all, and name its files.

    Raises:
        OutputError: it cannot be written, or holds something that is no comparison.
    """
    from excavatwin.studies.comparison_picture import encode_comparison

    def stale(name: str) -> bool:
        return name in OURS or any(name.startswith(f"{ours}.") for ours in OURS)

    with whole_folder(folder, MARK, stale) as staged:
        (staged / "comparison.csv").write_text(to_csv(c), "utf-8")
        (staged / "difference.tif").write_bytes(encode_difference(c))
        (staged / "comparison.png").write_bytes(encode_comparison(c))
        (staged / MARK).write_text(to_json(c), "utf-8")
    return [folder / name for name in OURS]


def encode_difference(c: Comparison) -> bytes:
    """B minus A on A's own grid as a GeoTIFF: float32, NaN where one of them has no terrain height."""
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning
    from rasterio.io import MemoryFile
    from rasterio.transform import Affine

    m = c.a.map
    values, origin, crs = np.ascontiguousarray(c.difference[c.own]), origin_of(m), crs_of(m)
    profile: dict[str, Any] = {
        "driver": "GTiff", "count": 1, "dtype": "float32", "height": m.grid.rows, "width": m.grid.cols,
        "transform": Affine(m.grid.cell, 0.0, m.grid.west + origin[0], 0.0, -m.grid.cell, m.grid.north + origin[1]),
        "crs": None if crs is None else rasterio.crs.CRS.from_wkt(crs.to_wkt()),
        "nodata": np.nan, "compress": "DEFLATE", "predictor": 3,
    }  # fmt: skip
    with warnings.catch_warnings(), MemoryFile() as memory:
        warnings.simplefilter("ignore", NotGeoreferencedWarning)  # a map without a place says so in its tags
        with rasterio.Env(GDAL_PAM_ENABLED=False), memory.open(**profile) as raster:
            raster.write(values, 1)
            raster.set_band_description(1, "difference")
            raster.units = (c.unit,)
            raster.update_tags(
                meaning="terrain elevation, B minus A, as placed; NaN where one of them has none",
                a=str(c.a.folder), b=str(c.b.folder), placed_by=c.placement.way, frame=frame_sentence(m),
            )  # fmt: skip
        return bytes(memory.read())
