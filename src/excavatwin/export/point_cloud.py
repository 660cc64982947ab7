"""``points.laz``: the fused cloud, LAS 1.4 point format 7, compressed."""

from __future__ import annotations

import io
from typing import Any

import laspy
import numpy as np
from laspy.vlrs.known import ClassificationLookupVlr, WktCoordinateSystemVlr

from excavatwin import __version__
from excavatwin.export.placement import crs_of, origin_of, placed
from excavatwin.scene.elevation_map import ElevationMap
from excavatwin.scene.site import FusedPoints
from excavatwin.scene.taxonomy import TaskClass

#: Task class -> ASPRS classification code. ASPRS has codes for "unclassified" and "ground"; for a cover that may be
#: grass, snow or debris, for a machine and for an obstacle it has none, so they go to its user-definable range as
#: 64 + task id. The exact task id is in the extra dimension ``task_class``.
ASPRS = {
    TaskClass.UNKNOWN: 1,
    TaskClass.CONSTRUCTION_TERRAIN: 2,
    TaskClass.OTHER_TERRAIN: 2,
    TaskClass.REMOVABLE_COVER: 64 + TaskClass.REMOVABLE_COVER,
    TaskClass.EXCAVATOR: 64 + TaskClass.EXCAVATOR,
    TaskClass.OBSTACLE: 64 + TaskClass.OBSTACLE,
}
_LOOKUP = {
    1: "Unclassified",
    2: "Ground",
    **{64 + k: k.name.replace("_", " ").capitalize() for k in TaskClass if ASPRS[k] > 64},
}
#: Extra dimension -> dtype, description (at most 32 bytes in the file).
_EXTRA = {
    "task_class": ("uint8", "ExcavaTwin class id 0..5"),
    "confidence": ("float32", "share of votes, 0..1"),
    "object_id": ("int32", "id in objects.geojson, 0 none"),
    "support": ("uint8", "1 terrain, 2 off terrain"),
}


def encode_laz(points: FusedPoints, elevation_map: ElevationMap) -> bytes:
    """The cloud as LAZ bytes in map coordinates, to the millimetre, with colour, class, confidence and object."""
    xyz = placed(elevation_map, points.xyz)
    header = laspy.LasHeader(point_format=7, version="1.4")
    header.generating_software = f"ExcavaTwin {__version__}"
    header.offsets = np.floor(origin_of(elevation_map))
    header.scales = np.full(3, _scale(elevation_map, xyz - header.offsets))
    header.add_extra_dims([laspy.ExtraBytesParams(name, dtype, text) for name, (dtype, text) in _EXTRA.items()])
    _add_records(header, elevation_map)
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = xyz.T
    cloud.red, cloud.green, cloud.blue = (points.rgb.astype(np.uint16) * 257).T
    codes = np.array([ASPRS[k] for k in TaskClass], np.uint8)
    cloud.classification = codes[points.label]
    cloud.return_number = cloud.number_of_returns = np.ones(len(xyz), np.uint8)
    cloud.task_class = points.label
    cloud.confidence = points.confidence
    cloud.object_id = points.object_id
    cloud.support = points.support
    stream = io.BytesIO()
    cloud.write(stream, do_compress=True, laz_backend=laspy.LazBackend.Lazrs)
    return stream.getvalue()


def _scale(elevation_map: ElevationMap, local: np.ndarray) -> float:
    """1 mm; of an arbitrary unit, what resolves the cloud to 1e-6 of its extent. Always fits 32 bits."""
    extent = float(np.abs(local).max(initial=0.0))
    fine = 0.001 if elevation_map.metric else max(extent, 1e-6) * 1e-6
    return max(fine, extent / 2**31 * 1.01)


def _add_records(header: Any, elevation_map: ElevationMap) -> None:
    """The CRS, as the OGC WKT 1 that LAS 1.4 asks for, and the names of the classes."""
    crs = crs_of(elevation_map)
    if crs is not None:
        header.vlrs.append(WktCoordinateSystemVlr(crs.to_wkt("WKT1_GDAL")))
    header.global_encoding.wkt = True
    lookup = ClassificationLookupVlr()
    lookup.lookups = dict(_LOOKUP)
    header.vlrs.append(lookup)
