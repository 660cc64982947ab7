"""From the frame of a network, which knows neither gravity nor metres, to an upright one by what the photos tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float64

from excavatwin.backbones.sequence.similarities import Matrix, moved_pose, scale_of, similarity
from excavatwin.scene.frames import invert_rigid
from excavatwin.scene.observations import Georeference, Lattice
from excavatwin.scene.photo import Photo

CONTRADICTED = 0.05
"""GPS and a metric network that differ by more than this are reported (relative)."""


@dataclass(frozen=True)
class Standing:
    """One view in the frame of the sequence, with some of its points."""

    photo: Photo
    lattice: Lattice
    T_R_cam: Matrix
    points: Float64[np.ndarray, "n 3"]

    def moved(self, S_a_R: Matrix) -> Standing:
        """The same in another frame."""
        points = self.points @ S_a_R[:3, :3].T + S_a_R[:3, 3]
        return replace(self, T_R_cam=moved_pose(S_a_R, self.T_R_cam), points=points)


@dataclass(frozen=True)
class Upright:
    """The upright frame and how it was found."""

    S_M_F: Matrix
    """From the frame of the sequence into the upright one."""
    up_from: str
    """``gps``, ``gimbal``, ``cameras`` or ``cameras and terrain``."""
    metres_per_unit: float | None
    georeference: Georeference | None
    doubts: tuple[str, ...]


def canonical(first: Standing, metric: bool) -> Matrix:
    """The frame of the first camera, in which its points lie at a median distance of 1 unless it is in metres.

    Networks choose their frames; this one does not depend on what they chose.
    """
    distance = float(np.median(np.linalg.norm(first.points - first.T_R_cam[:3, 3], axis=1)))
    unit = 1.0 if metric else 1 / max(distance, 1e-300)
    return similarity(unit, np.eye(3), np.zeros(3)) @ invert_rigid(first.T_R_cam)


def uprighted(views: Sequence[Standing], metric: bool) -> Upright:
    """The upright frame by GPS positions, gimbal tags, else cameras and terrain, as photogrammetry finds it.

    Args:
        views: at least one, with points.
        metric: the views are in metres, says the network.
    """
    from excavatwin.backbones.photogrammetry.georeference import uprighting
    from excavatwin.backbones.photogrammetry.placement import PlacedCamera, Placement, SparsePoints

    cameras = []
    for view in views:
        lattice = view.lattice
        placed = PlacedCamera(
            view.photo.name, lattice.width, lattice.height, lattice.K_photo, lattice.distortion, view.T_R_cam,
            n_points=len(view.points), reprojection_error=float("nan"),
        )  # fmt: skip
        cameras.append(placed)
    ends = np.cumsum([0, *(len(view.points) for view in views)])
    visible = tuple(np.arange(start, end) for start, end in pairwise(ends))
    points = SparsePoints(np.concatenate([view.points for view in views]), visible)
    placement, S_M_F = uprighting(Placement(tuple(cameras), points), [view.photo for view in views])
    doubts = list(placement.doubts)
    scale = placement.metres_per_unit
    if metric and scale is None:
        scale = 1.0
    elif metric and abs(np.log(scale_of(S_M_F))) > CONTRADICTED:
        doubts.append(
            f"GPS positions make the scene {scale_of(S_M_F):.3g} times as large as the network, which claims metres: "
            "GPS was believed."
        )
    return Upright(S_M_F, placement.up_from, scale, placement.georeference, tuple(doubts))
