"""Where the photos stand: the result of structure from motion, before any dense depth."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64, Int64, UInt8

from excavatwin.scene.observations import Georeference, Unplaced


@dataclass(frozen=True)
class PosedImage:
    """An undistorted image on its lattice, with its camera: what dense matching works on."""

    name: str
    """File name of the photo."""
    image: UInt8[np.ndarray, "H W 3"]
    """RGB, free of distortion."""
    K_cam: Float64[np.ndarray, "3 3"]
    """Intrinsics on this lattice, pixel centres at +0.5 [px]."""
    T_R_cam: Float64[np.ndarray, "4 4"]
    """Camera-to-world pose, OpenCV axes [su, frame R]."""
    valid: UInt8[np.ndarray, "H W"] | None = None
    """0 where undistortion found no photo pixel; None when every pixel is real."""


@dataclass(frozen=True)
class SparsePoints:
    """The points that structure from motion triangulated, and which photo saw which."""

    xyz: Float64[np.ndarray, "n 3"]
    """[su, frame R]; R is upright, +z is up."""
    visible: tuple[Int64[np.ndarray, "m"], ...]
    """For each placed camera (same order): indices into ``xyz`` of the points that it observed."""
    error: Float64[np.ndarray, "n"] | None = None
    """Mean reprojection error of each point [px of the shrunk photo]; None when unknown."""


@dataclass(frozen=True)
class PlacedCamera:
    """One photo with its lens and its pose."""

    name: str
    """File name of the photo."""
    width: int
    """Width of the photo as displayed [px]."""
    height: int
    """Height of the photo as displayed [px]."""
    K_photo: Float64[np.ndarray, "3 3"]
    """Intrinsics of the full photo, pixel centres at +0.5 [px]."""
    distortion: tuple[float, float, float, float]
    """OpenCV k1, k2, p1, p2 of the full photo."""
    T_R_cam: Float64[np.ndarray, "4 4"]
    """Camera-to-world pose, OpenCV axes [su, frame R]."""
    n_points: int
    """Sparse points that the photo observes."""
    reprojection_error: float
    """Median distance of its sparse points from their features [px of the full photo]."""


@dataclass(frozen=True)
class Placement:
    """All placed photos in the upright frame R (+z up, origin near the scene: safe in float32).

    With ``georeference``, R is east, north, up in its projected CRS less its origin, in metres.
    """

    cameras: tuple[PlacedCamera, ...]
    points: SparsePoints
    unplaced: tuple[Unplaced, ...] = ()
    up_from: str = "unknown"
    """How +z was found: ``gps``, ``gimbal``, ``cameras`` or ``cameras and terrain``."""
    up_doubt: float | None = None
    """One standard deviation of the tilt of +z [deg], as far as it can be told."""
    metres_per_unit: float | None = None
    """Metric scale of R: 1 when GPS gave it, None when the unit is arbitrary."""
    georeference: Georeference | None = None
    doubts: tuple[str, ...] = ()
    """What the user should know about gravity, scale and calibration, one sentence each."""
    calibration: str = "unknown"
    """What was held and what was refined in the lens model, and why."""
    source: dict[str, str] = field(default_factory=dict)
    """Provenance: library versions and counts."""
