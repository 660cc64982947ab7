"""Bring a map into the frame of its truth: by what both declare, or by cameras of equal names.

Never by the scored cells. The scale stays the one that the map declares. What a further vertical shift and tilt would
gain is a separate figure (``elevation_fitted_*``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from excavatwin.errors import InputError
from excavatwin.evaluation.frame import nearest, offset_to_truth
from excavatwin.evaluation.metric import Metric
from excavatwin.scene.elevation_map import ElevationMap, MapObject
from excavatwin.scene.frames import umeyama
from excavatwin.scene.grid import Grid
from excavatwin.scene.site import MappedView
from excavatwin.scene.truth import Truth

WAYS = ("auto", "declared", "cameras")
"""``declared``: georeferences, or one common frame; ``cameras``: see ``by_cameras``; ``auto``: either."""


@dataclass(frozen=True)
class Alignment:
    """Rigid motion about the vertical from the map's frame M into the truth's."""

    way: str
    """``declared`` or ``cameras``."""
    yaw: float
    """Counter-clockwise turn [rad]."""
    shift: Float64[np.ndarray, "3"]
    """Added after the turn [m]."""
    cameras: int = 0
    """Cameras that it rests on."""
    residual: float = float("nan")
    """RMS distance of those cameras from their true places after it [m]."""
    scale: float = float("nan")
    """What a similarity over the same cameras would scale by (protocol P1); *not* applied."""

    def to_truth(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions of the map in the truth's frame [m]."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return c * x - s * y + self.shift[0], s * x + c * y + self.shift[1]

    def to_map(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions of the truth in the map's frame [m]."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        x, y = x - self.shift[0], y - self.shift[1]
        return c * x + s * y, -s * x + c * y

    def moved(self, o: MapObject) -> MapObject:
        """An object of the map in the truth's frame."""
        x, y = self.to_truth(np.array(o.centre[0]), np.array(o.centre[1]))
        dz = float(self.shift[2])
        corners = np.stack(self.to_truth(o.footprint[:, 0], o.footprint[:, 1]), axis=-1)
        yaw = (o.yaw + np.rad2deg(self.yaw) + 90) % 180 - 90
        return replace(
            o, centre=(float(x), float(y), o.centre[2] + dz), yaw=float(yaw), footprint=corners,
            z_base=o.z_base + dz, z_top=o.z_top + dz,
        )  # fmt: skip


def cell_centres(grid: Grid, alignment: Alignment) -> tuple[np.ndarray, np.ndarray]:
    """x and y of a map's cell centres in the truth's frame, each (Y, X) [m]."""
    x, y = np.meshgrid(grid.x, grid.y)
    return alignment.to_truth(x, y)


def cell_at(m: ElevationMap, truth: Truth, alignment: Alignment) -> Int64[np.ndarray, "Y X"]:
    """Flat index of the map's cell at each of the truth's cell centres; -1 outside the map."""
    x, y = np.meshgrid(truth.grid.x, truth.grid.y)
    return nearest(m.grid, *alignment.to_map(x, y))


def shifted(offset: Sequence[float] | Float64[np.ndarray, "3"]) -> Alignment:
    """A given offset, without a turn."""
    return Alignment("declared", 0.0, np.asarray(offset, float))


def align(m: ElevationMap, views: Sequence[MappedView], truth: Truth, way: str = "auto") -> Alignment:
    """The alignment of a map with its truth.

    Args:
        views: placed photos with their poses in frame M.
        way: one of ``WAYS``. ``auto`` takes what is declared when both or neither have a georeference, else cameras.

    Raises:
        InputError: no such way, no metric scale, nothing declared in common, or fewer than three common cameras.
    """
    if way not in WAYS:
        raise InputError(f"{way!r} is no way to align; use one of: {', '.join(WAYS)}.")
    one_sided = (m.georeference is None) != (truth.georeference is None)
    if way == "cameras" or (way == "auto" and m.metric and one_sided and common_cameras(views, truth)):
        return by_cameras(m, views, truth)
    return shifted(offset_to_truth(m, truth))


def common_cameras(views: Sequence[MappedView], truth: Truth) -> list[tuple[np.ndarray, np.ndarray]]:
    """Camera centres in frame M and in the truth's, for photos of equal names whose true pose is known."""
    true = {view.name: view.T_M_cam[:3, 3] for view in truth.views if np.isfinite(view.T_M_cam).all()}
    return [(view.T_M_cam[:3, 3], true[view.name]) for view in views if view.name in true]


def by_cameras(m: ElevationMap, views: Sequence[MappedView], truth: Truth) -> Alignment:
    """Least-squares turn about the vertical and shift from camera centres to their true places.

    Raises:
        InputError: the map has no metric scale, or fewer than three photos are in both.
    """
    if not m.metric:
        raise InputError(
            "The map's unit is arbitrary, so it has no metres to compare; give it a reference length first."
        )
    pairs = common_cameras(views, truth)
    if len(pairs) < 3:
        raise InputError(
            f"Map and truth share {len(pairs)} photos by name; three are needed to bring them into one frame."
        )
    ours, theirs = (np.array(side, float) for side in zip(*pairs, strict=True))
    weight = np.ones(len(pairs))
    _, R, _ = umeyama(ours[:, :2], theirs[:, :2], weight)
    yaw = float(np.arctan2(R[1, 0], R[0, 0]))
    turned = np.concatenate([ours[:, :2] @ R.T, ours[:, 2:]], axis=1)
    shift = (theirs - turned).mean(axis=0)
    apart = np.linalg.norm(turned + shift - theirs, axis=1)
    scale = umeyama(ours, theirs, weight)[0]
    return Alignment("cameras", yaw, shift, len(pairs), float(np.sqrt((apart**2).mean())), scale)


def alignment_metrics(alignment: Alignment) -> tuple[Metric, ...]:
    """How well the cameras agree; nothing for a declared alignment."""
    if alignment.way != "cameras":
        return ()
    n = alignment.cameras
    return (
        Metric("alignment_residual", alignment.residual, "m", f"RMS distance of {n} cameras from their true places"),
        Metric(
            "alignment_scale_error", 100 * (1 / alignment.scale - 1), "%",
            "map's lengths against those between the cameras (P1); not corrected",
        ),
    )  # fmt: skip
