"""Where the map lies on the Earth, for every writer: the CRS, and the float64 origin that only writers add."""

from __future__ import annotations

import numpy as np
import pyproj
from jaxtyping import Float, Float64

from excavatwin.scene.elevation_map import ElevationMap

#: Engineering CRS of a map that no GPS ties to the Earth: x and y are right, north is not known.
LOCAL_WKT = 'LOCAL_CS["ExcavaTwin local frame",UNIT["metre",1],AXIS["x",EAST],AXIS["y",NORTH]]'
ARBITRARY = "arbitrary unit of the reconstruction: no metric scale is known; give a reference length"


def crs_of(elevation_map: ElevationMap) -> pyproj.CRS | None:
    """The projected CRS, the local frame in metres, or None where not even the unit is known."""
    if elevation_map.georeference is not None:
        return pyproj.CRS.from_epsg(elevation_map.georeference.epsg)
    return pyproj.CRS.from_wkt(LOCAL_WKT) if elevation_map.metric else None


def origin_of(elevation_map: ElevationMap) -> Float64[np.ndarray, "3"]:
    """Map coordinates of the origin of frame M, float64 [m]."""
    if elevation_map.georeference is None:
        return np.zeros(3)
    return np.array(elevation_map.georeference.origin, np.float64)


def placed(elevation_map: ElevationMap, p_M: Float[np.ndarray, "*n d"]) -> Float64[np.ndarray, "*n d"]:
    """Map coordinates of positions (x, y) or (x, y, z) of frame M, in float64."""
    return np.asarray(p_M, np.float64) + origin_of(elevation_map)[: np.shape(p_M)[-1]]


def frame_sentence(elevation_map: ElevationMap) -> str:
    """What x, y and z mean, for people."""
    g = elevation_map.georeference
    if g is not None:
        axes = f"x east, y north in EPSG:{g.epsg}, z up, metres"
        if np.isnan(g.residual):
            return f"{axes}; as in the files of the reconstruction; the photos carry no GPS to compare with"
        return (
            f"{axes}; tied by GPS with a residual of {g.residual:.2f} m; "
            "the vertical datum is that of the photos' GPS altitude"
        )
    unit = "metres" if elevation_map.metric else ARBITRARY
    return f"local frame: z up, origin and direction of x and y arbitrary, right-handed; {unit}"
