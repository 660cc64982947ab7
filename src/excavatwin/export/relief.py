"""The map as a picture: shaded relief in elevation colours, with what has no terrain elevation in class colours."""

from __future__ import annotations

import cmcrameri.cm
import numpy as np
from jaxtyping import Bool, Float32, Float64
from scipy.ndimage import distance_transform_edt, gaussian_filter

from excavatwin.scene.elevation_map import ElevationMap
from excavatwin.scene.taxonomy import NOT_OBSERVED, PALETTE

#: Azimuths of the lamps [deg clockwise from north] with their weights: one main light, two that fill its shadows.
_LAMPS = ((315.0, 0.6), (270.0, 0.2), (0.0, 0.2))
_ALTITUDE = np.deg2rad(45.0)


def hillshade(z: Float32[np.ndarray, "Y X"], cell: float) -> Float64[np.ndarray, "Y X"]:
    """Lambertian brightness 0..1 of a surface lit from the north-west (Horn's illumination model), gaps bridged."""
    gaps = ~np.isfinite(z)
    if gaps.all():
        return np.ones(z.shape)
    nearest = distance_transform_edt(gaps, return_distances=False, return_indices=True)
    filled = gaussian_filter(np.asarray(z, float)[tuple(nearest)], 0.7)
    if min(z.shape) < 2:
        return np.ones(z.shape)
    south, east = np.gradient(filled, cell)
    slope = np.hypot(east, south)
    normal = np.stack([-east, south, np.ones_like(slope)]) / np.sqrt(1 + slope**2)  # x east, y north, z up
    shade = np.zeros(z.shape)
    for azimuth, weight in _LAMPS:
        a = np.deg2rad(azimuth)
        lamp = np.array([np.sin(a) * np.cos(_ALTITUDE), np.cos(a) * np.cos(_ALTITUDE), np.sin(_ALTITUDE)])
        shade += weight * np.clip(np.tensordot(lamp, normal, 1), 0, 1)
    return shade


def elevation_limits(z: Float32[np.ndarray, "Y X"]) -> tuple[float, float]:
    """The range of the colours: the 1st to the 99th percentile, never empty."""
    finite = z[np.isfinite(z)]
    if not finite.size:
        return 0.0, 1.0
    low, high = (float(v) for v in np.percentile(finite, (1, 99)))
    return (low, high) if high - low > 1e-6 else (low - 0.5, high + 0.5)


def relief(m: ElevationMap, limits: tuple[float, float]) -> Float64[np.ndarray, "Y X 4"]:
    """RGBA of the map: terrain in batlow, objects in their class colour on their own tops, cover without terrain green.

    Transparent where nothing is observed.
    """
    surface = np.where(np.isfinite(m.object_top) & m.object, m.object_top, m.elevation)
    shade = hillshade(surface, m.grid.cell)
    low, high = limits
    rgb = cmcrameri.cm.batlow(np.clip((np.nan_to_num(m.elevation, nan=low) - low) / (high - low), 0, 1))[..., :3]
    classes = np.full((256, 3), 0.6)
    for k, colour in PALETTE.items():
        classes[int(k)] = np.array(colour) / 255
    by_class = m.object | ~np.isfinite(m.elevation)
    rgb = np.where(by_class[..., None], classes[m.label], rgb)
    light = 0.35 + 0.9 * shade
    seen: Bool[np.ndarray, "Y X"] = np.isfinite(m.elevation) | (m.label != NOT_OBSERVED) & m.observed.astype(bool)
    return np.concatenate([np.clip(rgb * light[..., None], 0, 1), seen[..., None].astype(float)], axis=-1)


def window(m: ElevationMap) -> tuple[slice, slice]:
    """Rows and columns that hold something, with a small margin."""
    seen = np.isfinite(m.elevation) | m.observed.astype(bool)
    if not seen.any():
        return slice(0, m.grid.rows), slice(0, m.grid.cols)

    def span(occupied: Bool[np.ndarray, "n"]) -> slice:
        index = np.flatnonzero(occupied)
        margin = max(1, round(0.02 * (index[-1] - index[0])))
        return slice(max(index[0] - margin, 0), min(index[-1] + margin + 1, len(occupied)))

    return span(seen.any(1)), span(seen.any(0))
