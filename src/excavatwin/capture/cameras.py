"""Focal length in pixels from what a camera wrote, checked against a small table of sensors (``cameras.toml``).

Three sources, none right for every file:

- **Table**: ``FocalLength`` [mm] over the sensor's width [mm]: good to about 1 %, where the camera is known.
- **Focal plane**: ``FocalPlaneXResolution`` counts pixels of the *original* photo. A program that shrinks a photo keeps
  it, with or without an updated ``PixelXDimension``; so the width it implies must be that of a sensor that exists.
- **35 mm equivalent**: CIPA DCG-001 relates the *diagonals*, so that f = f35 / 43.27 x diagonal. Rounded to full
  millimetres: 2 % at 24 mm. Dividing by 36 mm of width instead is 4 % short for a 4:3 sensor.
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

#: Diagonal of a 36 mm x 24 mm frame [mm].
FULL_FRAME_DIAGONAL = math.hypot(36.0, 24.0)
#: Long sides of the sensors that are made, 1/3.6" to medium format [mm].
SENSOR_WIDTHS = (
    4.0,
    4.54,
    4.8,
    5.0,
    5.37,
    5.76,
    6.17,
    6.4,
    7.18,
    7.44,
    8.8,
    9.6,
    9.9,
    13.2,
    17.3,
    22.3,
    23.6,
    36.0,
    44.0,
)
#: Relative difference up to which two statements about a focal length count as the same.
AGREES = 0.12


@dataclass(frozen=True)
class Lens:
    """What the metadata says about camera and optics."""

    make: str = ""
    model: str = ""
    focal_mm: float | None = None
    """Focal length [mm]."""
    focal_35mm: float | None = None
    """Equivalent focal length on a 36 mm x 24 mm frame, digital zoom included [mm]."""
    pitch_mm: float | None = None
    """Pixel pitch of the original photo, from the focal-plane resolution [mm]."""
    recorded: tuple[float, float] | None = None
    """(longer, shorter) side that the camera says it wrote [px]."""
    zoom: float = 1.0
    """Digital zoom, 1 = none."""


@dataclass(frozen=True)
class Sensor:
    """One line of the camera table."""

    model: str
    width_mm: float
    """Long side of the part of the sensor that a full photo shows [mm]."""
    source: str
    """Where the width comes from."""
    focal_mm: float | None = None
    """Focal length of a fixed lens [mm]; None for zooms and interchangeable lenses."""


def focal_pixels(lens: Lens, long_side: int, short_side: int) -> tuple[float | None, str]:
    """Focal length of a photo of ``long_side`` x ``short_side`` px [px], with its source (see ``Photo.focal_source``).

    Where the table and the 35 mm equivalent contradict each other, the exposure's own statement wins: the model may
    carry several lenses, or the photo may be a crop.
    """
    by_35mm = _from_35mm(lens, long_side, short_side)
    by_table = _from_table(lens, long_side)
    if by_table and (by_35mm is None or abs(by_table / by_35mm - 1) < AGREES):
        return by_table, "camera-table"
    by_plane = _from_focal_plane(lens, long_side, short_side)
    if by_plane and (by_35mm is None or abs(by_plane / by_35mm - 1) < AGREES):
        return by_plane, "exif-focal-plane"
    if by_35mm:
        return by_35mm, "exif-35mm"
    return None, "unknown"


@cache
def camera_table() -> tuple[Sensor, ...]:
    """The cameras that ``cameras.toml`` knows."""
    text = files("excavatwin.capture").joinpath("cameras.toml").read_text(encoding="utf-8")
    return tuple(Sensor(**entry) for entry in tomllib.loads(text)["camera"])


def _from_table(lens: Lens, long_side: int) -> float | None:
    model = lens.model.casefold()
    for sensor in camera_table():
        if sensor.model.casefold() != model or not model:
            continue
        if sensor.focal_mm and lens.focal_mm and abs(lens.focal_mm / sensor.focal_mm - 1) > 0.03:
            continue  # another lens of the same device
        focal_mm = lens.focal_mm or sensor.focal_mm
        return long_side * focal_mm / sensor.width_mm * lens.zoom if focal_mm else None
    return None


def _from_focal_plane(lens: Lens, long_side: int, short_side: int) -> float | None:
    if not lens.pitch_mm or not lens.focal_mm:
        return None
    # A stale size, or one of a crop, has another shape than the photo: then only the photo's own size is left to try.
    recorded, shape = lens.recorded, long_side / short_side
    full = recorded[0] if recorded and abs(recorded[0] / recorded[1] / shape - 1) < 0.02 else long_side
    width_mm = full * lens.pitch_mm
    if min(abs(width_mm / known - 1) for known in SENSOR_WIDTHS) > 0.04:
        return None
    return long_side * lens.focal_mm / width_mm * lens.zoom


def _from_35mm(lens: Lens, long_side: int, short_side: int) -> float | None:
    if not lens.focal_35mm:
        return None
    # 16:9 is the full width of a 4:3 or a 3:2 sensor, and the file does not tell which: 3:2 lies in the middle.
    diagonal = math.hypot(long_side, max(short_side, long_side / 1.5))
    return lens.focal_35mm / FULL_FRAME_DIAGONAL * diagonal
