"""The frame of the observations: what the files tell about it, else what GPS, gimbal tags and cameras tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from excavatwin.backbones.finished.found import Scene
from excavatwin.backbones.finished.verdict import gps_residual
from excavatwin.scene.observations import Georeference, View
from excavatwin.scene.photo import Photo

SPARSE = 20_000
"""Points of all views from which the vertical and the position are found."""


@dataclass(frozen=True)
class Frame:
    """Views in their final frame, and what is known about it."""

    views: tuple[View, ...]
    up: Float64[np.ndarray, "3"] | None
    metres_per_unit: float | None
    georeference: Georeference | None
    up_from: str
    doubts: tuple[str, ...] = ()


def as_found(
    scene: Scene, views: Sequence[View], photos: Sequence[Photo], origin: Float64[np.ndarray, "3"]
) -> Frame | None:
    """The frame of the files less ``origin``; None when the files do not say which way is up."""
    if scene.epsg is not None:
        centres = {view.name: view.centre + origin for view in views}
        at = (float(origin[0]), float(origin[1]), float(origin[2]))
        tie = Georeference(scene.epsg, at, gps_residual(scene.epsg, centres, photos))
        return Frame(tuple(views), np.array([0.0, 0.0, 1.0]), 1.0, tie, "the reconstruction's files")
    if scene.up is None:
        return None
    return Frame(tuple(views), scene.up, scene.metres_per_unit, None, "the reconstruction's files")


def by_photos(scene: Scene, views: Sequence[View], photos: Sequence[Photo]) -> Frame:
    """The upright frame by the photos' GPS positions, gimbal tags, else cameras and terrain; points move in place."""
    from excavatwin.backbones.sequence.similarities import moved_pose
    from excavatwin.backbones.sequence.uprighting import Standing, uprighted

    of_name = {photo.name: photo for photo in photos}
    each = max(20, min(400, SPARSE // len(views)))
    metres = scene.metres_per_unit
    unit = np.diag([metres or 1.0] * 3 + [1.0])
    standing = []
    for view in views:
        flat = view.points.reshape(-1, 3)
        known = np.flatnonzero(~np.isnan(flat[:, 0]))
        if view.lattice is not None and len(known):
            some = flat[known[:: max(1, len(known) // each)]].astype(float)
            standing.append(Standing(of_name[view.name], view.lattice, view.T_R_cam, some).moved(unit))
    if not standing:
        return Frame(tuple(views), None, metres, None, "nothing")
    found = uprighted(standing, metres is not None)
    S = found.S_M_F @ unit
    moved = []
    for view in views:
        np.copyto(view.points, (view.points.astype(float) @ S[:3, :3].T + S[:3, 3]).astype(np.float32))
        moved.append(replace(view, T_R_cam=moved_pose(S, view.T_R_cam)))
    up = np.array([0.0, 0.0, 1.0])
    return Frame(tuple(moved), up, found.metres_per_unit, found.georeference, found.up_from, found.doubts)
