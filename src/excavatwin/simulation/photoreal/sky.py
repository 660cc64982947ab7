"""Daylight: the sun and a clear sky of Mitsuba's ``sunsky`` emitter, as numbers and one small table."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64

from excavatwin.simulation.photoreal.backend import backend, vectors

SUN_ANGLE = 0.5358
"""Diameter of the sun's disc [deg]."""
TABLE = (96, 256)
"""Rows (sine of the elevation, horizon to zenith) and columns (azimuth from +x towards +y) of the sky's table."""
NOON = 50.0
"""Elevation of the sun in whose light a grey card is grey [deg]."""
AUTOMATIC = 0.25
"""Share of a colour cast against noon that the camera takes away (as a power)."""


@dataclass(frozen=True, eq=False)
class Daylight:
    """Light from above, white-balanced for noon."""

    to_sun: Float64[np.ndarray, "3"]
    sun: Float64[np.ndarray, "3"]
    """Irradiance on a surface that faces the sun."""
    sky: Float32[np.ndarray, "96 256 3"]
    """Radiance of the sky."""
    skylight: Float64[np.ndarray, "3"]
    """Irradiance of the whole sky on a horizontal surface."""

    @property
    def on_the_ground(self) -> Float64[np.ndarray, "3"]:
        """Irradiance of sun and sky together on a horizontal surface."""
        return self.sun * self.to_sun[2] + self.skylight


@lru_cache(maxsize=8)
def daylight(azimuth: float, elevation: float, turbidity: float) -> Daylight:
    """Sun and sky (models of Hosek and Wilkie 2012, 2013, as Mitsuba ships them).

    Args:
        azimuth: of the sun, clockwise from north [deg].
        elevation: of the sun [deg].
        turbidity: 1.. 10; 2 is very clear, 6 is hazy.
    """
    to_sun, sun, sky, skylight = _raw(azimuth, elevation, turbidity)
    _, noon_sun, _, noon_sky = _raw(azimuth, NOON, turbidity)
    noon, now = noon_sun * np.sin(np.deg2rad(NOON)) + noon_sky, sun * to_sun[2] + skylight
    # The camera's daylight setting makes noon grey; its automatic takes a part of what is left, so evenings stay warm.
    cast = (now / now.mean()) / (noon / noon.mean())
    balance = noon.mean() / noon / cast**AUTOMATIC
    return Daylight(to_sun, sun * balance, (sky * balance).astype(np.float32), skylight * balance)


def _raw(
    azimuth: float, elevation: float, turbidity: float
) -> tuple[
    Float64[np.ndarray, "3"], Float64[np.ndarray, "3"], Float64[np.ndarray, "96 256 3"], Float64[np.ndarray, "3"]
]:
    """Direction to the sun, its irradiance, radiance and irradiance of the sky, as the emitter has them."""
    a, e = np.deg2rad(azimuth), np.deg2rad(elevation)
    to_sun = np.array([np.sin(a) * np.cos(e), np.cos(a) * np.cos(e), np.sin(e)])
    emitter = {"type": "sunsky", "sun_direction": to_sun.tolist(), "turbidity": turbidity}
    rows, cols = TABLE
    up = ((np.arange(rows) + 0.5) / rows)[:, None]
    turn = 2 * np.pi * (np.arange(cols) + 0.5) / cols
    across = np.sqrt(1 - up * up)
    directions = np.stack(np.broadcast_arrays(across * np.cos(turn), across * np.sin(turn), up), -1)
    sky = radiance(emitter | {"sun_scale": 0.0}, directions.reshape(-1, 3)).reshape(rows, cols, 3)
    disc = 2 * np.pi * (1 - np.cos(np.deg2rad(SUN_ANGLE / 2)))
    sun = radiance(emitter | {"sky_scale": 0.0}, to_sun[None])[0] * disc
    return to_sun, sun, sky, 2 * np.pi * (sky * up[..., None]).mean((0, 1))


def radiance(emitter: dict[str, Any], directions: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
    """What an emitter at infinity sends from the directions."""
    mi, dr = backend()
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = -vectors(directions)
    return np.array(mi.load_dict(emitter).eval(si), np.float64).T
