"""``map.nc``: every layer in one CF-1.11 NetCDF4 file."""

from __future__ import annotations

from typing import Any

import numpy as np

from excavatwin import __version__
from excavatwin.export.placement import ARBITRARY, crs_of, frame_sentence
from excavatwin.export.run_record import to_json
from excavatwin.scene.elevation_map import LAYERS
from excavatwin.scene.site import Site

#: An HDF5 attribute holds less than 64 KiB; what is longer (hashes of thousands of photos) is in run.json only.
_LONGEST = 60_000


def encode_netcdf(site: Site) -> bytes:
    """The map as NetCDF4 bytes: integers keep their dtype on reading, NaN is the only missing value."""
    dataset = site.map.to_xarray()
    georeferenced = site.map.georeference is not None
    if georeferenced:
        crs = crs_of(site.map)
        assert crs is not None  # a georeference is an EPSG code
        dataset["crs"] = ((), np.int32(0), {**crs.to_cf(), "spatial_ref": crs.to_wkt("WKT1_GDAL")})
        for layer in LAYERS:
            dataset[layer.name].attrs["grid_mapping"] = "crs"
    for variable in dataset.variables.values():
        if variable.attrs.get("units") == "unit":  # not a unit that UDUNITS, hence CF, knows
            variable.attrs |= {"units": "1", "comment": ARBITRARY}
    dataset["elevation"].attrs["ancillary_variables"] = "elevation_std confidence observed"
    dataset.attrs = _attributes(site)
    encoding: dict[str, dict[str, Any]] = {
        layer.name: {"zlib": True, "complevel": 4, "shuffle": True, "_FillValue": np.nan if _is_float(layer) else None}
        for layer in LAYERS
    }
    encoding |= {name: {"_FillValue": None} for name in ("x", "y")}
    return bytes(dataset.to_netcdf(engine="h5netcdf", encoding=encoding))


def _is_float(layer: Any) -> bool:
    return np.dtype(layer.dtype).kind == "f"


def _attributes(site: Site) -> dict[str, Any]:
    """Global attributes: CF's own, the frame, the doubts, and the whole provenance (nested parts as JSON)."""
    attributes: dict[str, Any] = {
        "Conventions": "CF-1.11",
        "title": "Semantic elevation map",
        "source": f"ExcavaTwin {__version__}, from photos",
        "references": "eq:multilayer_map: terrain elevation, class and objects on one grid",
        "frame": frame_sentence(site.map),
        "metric": "true" if site.map.metric else "false",
        "doubts": "\n".join(site.map.doubts) or "none",
    }
    g = site.map.georeference
    if g is not None:
        attributes |= {"epsg": g.epsg, "origin": np.array(g.origin), "georeference_residual_m": g.residual}
    for key, value in {**site.map.provenance, **{f"run_{k}": v for k, v in site.run.items()}}.items():
        if value is None:
            continue
        plain = isinstance(value, (str, int, float)) and not isinstance(value, bool)  # NetCDF has no booleans
        text = value if plain else to_json(value)
        too_long = isinstance(text, str) and len(text.encode()) > _LONGEST
        attributes.setdefault(key, "too long for an attribute: see run.json" if too_long else text)
    return attributes
