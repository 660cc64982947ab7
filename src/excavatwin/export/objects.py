"""``objects.geojson``: footprints and boxes of excavators and obstacles; a WGS84 twin where GPS gave a place."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyproj
from jaxtyping import Float64

from excavatwin.export.placement import frame_sentence, placed
from excavatwin.scene.elevation_map import ElevationMap, MapObject
from excavatwin.scene.taxonomy import class_name


def objects_table(elevation_map: ElevationMap) -> dict[str, Any]:
    """FeatureCollection in map coordinates. The ``crs`` member of GeoJSON 2008 tells GIS programs which those are."""
    g = elevation_map.georeference
    named = {"type": "name", "properties": {"name": f"urn:ogc:def:crs:EPSG::{g.epsg}"}} if g else None
    return {
        "type": "FeatureCollection",
        "name": "objects",
        "crs": named,
        "frame": frame_sentence(elevation_map),
        "unit": elevation_map.unit,
        "features": [_feature(o, placed(elevation_map, o.footprint), elevation_map) for o in elevation_map.objects],
    }


def objects_wgs84_table(elevation_map: ElevationMap) -> dict[str, Any] | None:
    """The same footprints as RFC 7946 wants them: longitude and latitude in WGS84; None without a georeference.

    Only the geometry is geographic; the properties are those of ``objects.geojson``.
    """
    g = elevation_map.georeference
    if g is None:
        return None
    to_wgs84 = pyproj.Transformer.from_crs(g.epsg, 4326, always_xy=True)
    features = []
    for o in elevation_map.objects:
        corners = placed(elevation_map, o.footprint)
        degrees = np.stack(to_wgs84.transform(corners[:, 0], corners[:, 1]), axis=-1)
        features.append(_feature(o, degrees, elevation_map, decimals=9))
    return {"type": "FeatureCollection", "name": "objects_wgs84", "features": features}


def _feature(
    o: MapObject, corners: Float64[np.ndarray, "n 2"], elevation_map: ElevationMap, decimals: int = 3
) -> dict[str, Any]:
    """One object. Lengths to the millimetre (to 6 digits where the unit is arbitrary)."""
    if not elevation_map.metric:
        decimals = 6
    lengths = 3 if elevation_map.metric else 6
    ring = np.round(_counter_clockwise(corners), decimals).tolist()
    z = placed(elevation_map, np.array([[0.0, 0.0, o.z_base], [0.0, 0.0, o.z_top]]))[:, 2]
    centre = placed(elevation_map, np.array(o.centre))
    return {
        "type": "Feature",
        "id": o.object_id,
        "geometry": {"type": "Polygon", "coordinates": [[*ring, ring[0]]]},
        "properties": {
            "object_id": o.object_id,
            "class": class_name(o.task_class),
            "centre": np.round(centre, lengths),
            "size": np.round(np.array(o.size, float), lengths),
            "yaw_deg": round(float(o.yaw), 2),
            "z_base": round(float(z[0]), lengths),
            "z_top": round(float(z[1]), lengths),
            "confidence": round(float(o.confidence), 4),
        },
    }


def _counter_clockwise(corners: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
    x, y = (corners - corners.mean(0)).T
    area = float(x @ np.roll(y, -1) - y @ np.roll(x, -1))
    return corners if area >= 0 else corners[::-1]
