"""Observations: what frozen models deliver, view by view, on one image lattice each (eq:gc_correspondence)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float32, Float64, UInt8


@dataclass(frozen=True)
class Lattice:
    """Where a view's lattice lies in its photo.

    The lattice is an affine image of the *undistorted* photo: a photo pixel is undistorted with ``K_photo`` and
    ``distortion``, then mapped by ``affine``.
    """

    width: int
    """Width of the photo as displayed (after its EXIF orientation) [px]."""
    height: int
    """Height of the photo as displayed [px]."""
    affine: Float64[np.ndarray, "2 3"]
    """lattice = affine @ (x, y, 1) of the undistorted photo; pixel centres at +0.5 in both."""
    K_photo: Float64[np.ndarray, "3 3"]
    """Intrinsics of the full photo [px]."""
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """OpenCV k1, k2, p1, p2 of the full photo; all zero when the photo is already free of distortion."""

    def from_photo(self, uv: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
        """Lattice coordinates of photo pixels, by fixed-point inversion of the lens model."""
        f = np.array([self.K_photo[0, 0], self.K_photo[1, 1]])
        distorted = (np.asarray(uv, float) - self.K_photo[:2, 2]) / f
        k1, k2, p1, p2 = self.distortion
        x = distorted.copy()
        for _ in range(20):
            r2 = (x**2).sum(-1, keepdims=True)
            xy = x[:, :1] * x[:, 1:]
            tangential = np.concatenate(
                [2 * p1 * xy + p2 * (r2 + 2 * x[:, :1] ** 2), p1 * (r2 + 2 * x[:, 1:] ** 2) + 2 * p2 * xy],
                axis=-1,
            )
            x = (distorted - tangential) / (1 + k1 * r2 + k2 * r2**2)
        undistorted = x * f + self.K_photo[:2, 2]
        return undistorted @ self.affine[:, :2].T + self.affine[:, 2]


@dataclass(frozen=True)
class View:
    """One photo as the frozen models saw it."""

    name: str
    """File name of the photo, or any name that is unique in its observations."""
    points: Float32[np.ndarray, "H W 3"]
    """P_s: the reconstructed world point of every pixel [su, frame R]; NaN where the backbone abstains."""
    confidence: Float32[np.ndarray, "H W"]
    """C_s: reconstruction confidence, >= 0; only its order matters across backbones."""
    evidence: Float32[np.ndarray, "H W K"]
    """o_s: non-negative semantic evidence for the task classes 1..K; all zero where the segmenter abstains."""
    T_R_cam: Float64[np.ndarray, "4 4"]
    """Camera-to-world pose, OpenCV axes [su]."""
    K_cam: Float64[np.ndarray, "3 3"]
    """Intrinsics on this lattice [px]."""
    image: UInt8[np.ndarray, "H W 3"] | None = None
    """RGB on this lattice, for colours and pictures only."""
    lattice: Lattice | None = None
    """Where the lattice lies in the photo; None when the lattice *is* the photo."""

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of the lattice."""
        return self.points.shape[0], self.points.shape[1]

    @property
    def centre(self) -> Float64[np.ndarray, "3"]:
        """Camera centre [su, frame R]."""
        return self.T_R_cam[:3, 3]


@dataclass(frozen=True)
class Georeference:
    """Frame R is east, north, up in a projected CRS, less an origin. Implies up = +z and one metre per unit."""

    epsg: int
    """EPSG code of the projected CRS (UTM zone)."""
    origin: tuple[float, float, float]
    """Easting, northing and elevation of R's origin [m], float64: added only in writers."""
    residual: float
    """RMS of the camera positions against their GPS positions, NaN where the photos carry none [m]."""


@dataclass(frozen=True)
class Unplaced:
    """A photo that is not part of the reconstruction."""

    name: str
    reason: str


@dataclass(frozen=True)
class Observations:
    """Everything that the method is given: I -> {(p_su, c_su, o_su)} with the cameras."""

    views: tuple[View, ...]
    up: Float64[np.ndarray, "3"] | None = None
    """Unit vector against gravity in frame R; None when the backbone does not know."""
    metres_per_unit: float | None = None
    """Metric scale of R; None when the backbone does not know."""
    georeference: Georeference | None = None
    unplaced: tuple[Unplaced, ...] = ()
    doubts: tuple[str, ...] = ()
    """What the backbone wants the user to know about gravity, scale and calibration, one sentence each."""
    source: dict[str, str] = field(default_factory=dict)
    """Provenance: reconstructor, segmenter, versions, class mapping."""

    def __repr__(self) -> str:
        scale = f"{self.metres_per_unit:g} m a unit" if self.metres_per_unit is not None else "no scale"
        return f"Observations({len(self.views)} views, {scale}, {'up known' if self.up is not None else 'up unknown'})"

    def view(self, name: str) -> View | None:
        """The view of that name, or None."""
        return next((view for view in self.views if view.name == name), None)
