"""A photo and what its file says about the camera, before anything is computed from its pixels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class GpsFix:
    """Position of the camera in WGS84."""

    latitude: float
    """[deg]"""
    longitude: float
    """[deg]"""
    altitude: float | None
    """As written by the camera; its datum varies between makers [m]."""
    sigma_horizontal: float | None = None
    """Standard deviation that the camera reports (DJI XMP RtkStdLat/Lon), None when it reports none [m]."""
    sigma_vertical: float | None = None


@dataclass(frozen=True)
class Gimbal:
    """Attitude of the camera (DJI XMP): yaw clockwise from north, pitch -90 = nadir, roll [deg]."""

    yaw: float
    pitch: float
    roll: float


@dataclass(frozen=True)
class Photo:
    """One photo on disk. Sizes and focal length are of the photo as displayed, after its EXIF orientation."""

    name: str
    """File name; unique in a project."""
    path: Path
    width: int
    height: int
    camera: str
    """Photos of equal ``camera`` share intrinsics: make, model, size, focal length and zoom."""
    focal: float | None = None
    """Focal length [px of the displayed photo], None when the file does not tell."""
    focal_source: str = "unknown"
    """``exif-35mm``, ``exif-focal-plane``, ``camera-table`` or ``unknown``."""
    gps: GpsFix | None = None
    gimbal: Gimbal | None = None
    time: float | None = None
    """Seconds since the epoch as the camera's clock says (no time zone), for ordering."""
