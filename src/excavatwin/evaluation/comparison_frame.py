"""Bring map B into the frame of map A: by their georeferences, or by cameras of equal names.

The frame never comes from the compared cells. Both maps are upright, so a motion turns about the vertical alone: what
they disagree on about the vertical stays visible as a tilt. Scale is touched only where a map has none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64

from excavatwin.errors import InputError
from excavatwin.evaluation.comparison_site import ComparedSite
from excavatwin.scene.frames import umeyama
from excavatwin.scene.observations import Georeference

WAYS = ("auto", "declared", "cameras")
"""``declared``: georeferences; ``cameras``: photos of equal names; ``auto``: declared where both are, else cameras."""
FEWEST = 3
"""Shared cameras that a motion rests on."""
FLAT = 0.02
"""Cameras whose second largest extent is less than this share of the largest stand on a line: no similarity."""


@runtime_checkable
class Placement(Protocol):
    """Where B lies in A's frame."""

    @property
    def way(self) -> str:
        """``declared``, ``reprojected`` or ``cameras``."""

    @property
    def scale(self) -> float:
        """Lengths of A over lengths of B."""

    def to_a(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions of B's frame in A's [A's unit]."""

    def to_b(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions of A's frame in B's [B's unit]."""

    def height(self, z: Any) -> Any:
        """Heights of B's frame in A's [A's unit]."""


@dataclass(frozen=True)
class Motion:
    """p_A = scale · Rz(yaw) · p_B + shift."""

    way: str
    yaw: float
    """Counter-clockwise turn [rad]."""
    shift: Float64[np.ndarray, "3"]
    scale: float = 1.0
    """1 between metric maps."""

    def to_a(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions of B's frame in A's."""
        c, s = self.scale * np.cos(self.yaw), self.scale * np.sin(self.yaw)
        return c * x - s * y + self.shift[0], s * x + c * y + self.shift[1]

    def to_b(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions of A's frame in B's."""
        c, s = np.cos(self.yaw) / self.scale, np.sin(self.yaw) / self.scale
        x, y = x - self.shift[0], y - self.shift[1]
        return c * x + s * y, -s * x + c * y

    def height(self, z: Any) -> Any:
        """Heights of B's frame in A's."""
        return self.scale * z + self.shift[2]


@dataclass(frozen=True)
class Reprojection:
    """Both are georeferenced, in different projected CRS. Heights keep their datum."""

    a: Georeference
    b: Georeference
    way: str = "reprojected"
    scale: float = 1.0

    def to_a(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions of B's frame in A's [m]."""
        return _reprojected(self.b, self.a, x, y)

    def to_b(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions of A's frame in B's [m]."""
        return _reprojected(self.a, self.b, x, y)

    def height(self, z: Any) -> Any:
        """Heights of B's frame in A's [m]."""
        return z + (self.b.origin[2] - self.a.origin[2])


def _reprojected(source: Georeference, target: Georeference, x: Any, y: Any) -> tuple[np.ndarray, np.ndarray]:
    from pyproj import Transformer

    move = Transformer.from_crs(source.epsg, target.epsg, always_xy=True)
    east, north = move.transform(np.asarray(x, float) + source.origin[0], np.asarray(y, float) + source.origin[1])
    return np.asarray(east) - target.origin[0], np.asarray(north) - target.origin[1]


@dataclass(frozen=True)
class CameraFit:
    """What the shared cameras say about the two frames, beside the placement that is used."""

    cameras: int
    residual: float
    """RMS distance of B's cameras from A's under the placement [A's unit]."""
    similarity: tuple[float, Float64[np.ndarray, "3 3"], Float64[np.ndarray, "3"]] | None
    """Least-squares scale, rotation, shift from B's frame to A's; None where the cameras cannot tell it."""
    fitted: float = float("nan")
    """RMS distance under the similarity [A's unit]."""


def place(a: ComparedSite, b: ComparedSite, way: str = "auto") -> Placement:
    """Where B lies in A's frame.

    Raises:
        InputError: no such way, a CRS that is not projected in metres, or too few shared cameras where they decide.
    """
    if way not in WAYS:
        raise InputError(f"{way!r} is no way to align; use one of: {', '.join(WAYS)}.")
    here, there = a.map.georeference, b.map.georeference
    if way == "declared" and (here is None or there is None):
        without = " and ".join(str(site.folder) for site in (a, b) if site.map.georeference is None)
        raise InputError(f"{without} has no georeference to align by; use --align cameras.")
    if way == "cameras" or here is None or there is None:
        return by_cameras(a, b)
    if here.epsg == there.epsg:
        return Motion("declared", 0.0, np.subtract(there.origin, here.origin).astype(float))
    for site, place in ((a, here), (b, there)):
        _check_crs(site, place.epsg)
    return Reprojection(here, there)


def _check_crs(site: ComparedSite, epsg: int) -> None:
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        crs = CRS.from_epsg(epsg)
        fit = crs.is_projected and all(abs(axis.unit_conversion_factor - 1) < 1e-12 for axis in crs.axis_info[:2])
    except CRSError:
        fit = False
    if not fit:
        raise InputError(f"{site.folder} is in EPSG:{epsg}, which is no projected CRS in metres; reproject it first.")


def shared(a: ComparedSite, b: ComparedSite) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
    """Camera centres of the photos that both placed, by name: in A's frame and in B's."""
    names = sorted(a.cameras.keys() & b.cameras.keys())
    ours, theirs = ([cameras[name] for name in names] for cameras in (a.cameras, b.cameras))
    return np.array(ours, float).reshape(-1, 3), np.array(theirs, float).reshape(-1, 3)


def by_cameras(a: ComparedSite, b: ComparedSite) -> Motion:
    """Least-squares turn about the vertical and shift, and scale where a map has no metres.

    Raises:
        InputError: fewer than three shared cameras, or they stand in one place.
    """
    ours, theirs = shared(a, b)
    if len(ours) < FEWEST:
        raise InputError(
            f"{a.folder} and {b.folder} share {len(ours)} placed photos by name and are not both georeferenced; map "
            f"photos with GPS in both, or at least {FEWEST} photos of the same names, to bring them into one frame."
        )
    A, B = ours - ours.mean(0), theirs - theirs.mean(0)
    if min(np.ptp(A[:, :2], axis=0).max(), np.ptp(B[:, :2], axis=0).max()) <= 1e-6 * max(np.abs(ours).max(), 1.0):
        raise InputError(f"The {len(ours)} photos that both maps share were taken from one place; share more photos.")
    dot, cross = (A[:, :2] * B[:, :2]).sum(), (A[:, 1] * B[:, 0] - A[:, 0] * B[:, 1]).sum()
    yaw = float(np.arctan2(cross, dot))
    turn = Motion("cameras", yaw, np.zeros(3))
    turned = np.column_stack([*turn.to_a(B[:, 0], B[:, 1]), B[:, 2]])
    scale = 1.0 if a.map.metric and b.map.metric else float((A * turned).sum() / (turned**2).sum())
    if scale <= 0:
        raise InputError("The photos that both maps share stand in contradicting places; map one of the sites again.")
    x, y = Motion("cameras", yaw, np.zeros(3), scale).to_a(theirs[:, 0], theirs[:, 1])
    moved = np.column_stack([x, y, scale * theirs[:, 2]])
    return Motion("cameras", yaw, (ours - moved).mean(0), scale)


def fit_cameras(a: ComparedSite, b: ComparedSite, placement: Placement) -> CameraFit | None:
    """What the shared cameras say; None where there are fewer than three."""
    ours, theirs = shared(a, b)
    if len(ours) < FEWEST:
        return None
    x, y = placement.to_a(theirs[:, 0], theirs[:, 1])
    residual = _rms(np.column_stack([x, y, placement.height(theirs[:, 2])]) - ours)
    spread = [np.linalg.svd(side - side.mean(0), compute_uv=False) for side in (ours, theirs)]
    if any(extent[1] <= FLAT * extent[0] for extent in spread):
        return CameraFit(len(ours), residual, None)
    s, R, t = umeyama(theirs, ours, np.ones(len(ours)))
    return CameraFit(len(ours), residual, (s, R, t), _rms(s * theirs @ R.T + t - ours))


def _rms(apart: Float64[np.ndarray, "n 3"]) -> float:
    return float(np.sqrt((apart**2).sum(axis=1).mean()))
