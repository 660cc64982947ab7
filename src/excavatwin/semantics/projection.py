"""Pixel-to-point projection by index: no nearest-neighbour association, no second projection."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from excavatwin.errors import InputError
from excavatwin.paper import equation
from excavatwin.scene.observations import Observations
from excavatwin.scene.points import Points
from excavatwin.scene.taxonomy import K


@dataclass(frozen=True)
class Correspondence:
    """Every valid pixel is a point with its confidence and its evidence."""

    max_footprint: float = 4.0
    """Pixels that cover more than this many times the scene's median footprint are too far away to be mapped."""

    def __call__(self, observations: Observations, T_M_R: Float64[np.ndarray, "4 4"]) -> Points:
        """All points that are near enough, in frame M."""
        return correspond(observations, T_M_R, self.max_footprint)


@equation("eq:gc_correspondence")
def correspond(observations: Observations, T_M_R: Float64[np.ndarray, "4 4"], max_footprint: float) -> Points:
    """(s, u) <-> (p_su, c_su, o_su) for every valid pixel, in frame M; o_s(u, k) becomes e_{i,s}(k).

    Args:
        observations: the views.
        T_M_R: similarity into the map frame.
        max_footprint: samples whose pixel covers more than this many times the scene's median footprint are too far
            away to be mapped (an oblique photo reaches to the horizon) and are left out.

    Raises:
        InputError: no pixel of any view has a point.
    """
    scale = np.cbrt(np.linalg.det(T_M_R[:3, :3]))
    xyz, footprint, valid, centres = [], [], [], []
    for view in observations.views:
        p = view.points.reshape(-1, 3)
        at = np.flatnonzero(np.isfinite(p).all(axis=1))
        p = p[at].astype(np.float64)
        footprint.append(scale * np.linalg.norm(p - view.centre, axis=1) / view.K_cam[0, 0])
        xyz.append((p @ T_M_R[:3, :3].T + T_M_R[:3, 3]).astype(np.float32))
        valid.append(at)
        centres.append(T_M_R[:3, :3] @ view.centre + T_M_R[:3, 3])
    if not sum(map(len, valid)):
        raise InputError("no pixel of any view has a reconstructed point; nothing can be mapped.")
    limit = max_footprint * np.median(np.concatenate(footprint))
    near = [f <= limit for f in footprint]
    valid = [v[n] for v, n in zip(valid, near, strict=True)]
    shapes = tuple(view.shape for view in observations.views)
    starts = np.cumsum([0, *(h * w for h, w in shapes)])[:-1]
    views = observations.views
    return Points(
        xyz=np.concatenate([p[n] for p, n in zip(xyz, near, strict=True)]),
        confidence=np.concatenate([v.confidence.ravel()[at] for v, at in zip(views, valid, strict=True)]),
        evidence=np.concatenate([v.evidence.reshape(-1, K)[at] for v, at in zip(views, valid, strict=True)]),
        view=np.repeat(np.arange(len(views), dtype=np.int32), [len(at) for at in valid]),
        pixel=np.concatenate([start + at for start, at in zip(starts, valid, strict=True)]),
        rgb=np.concatenate(
            [
                np.full((len(at), 3), 128, np.uint8) if v.image is None else v.image.reshape(-1, 3)[at]
                for v, at in zip(views, valid, strict=True)
            ]
        ),
        centres=np.array(centres),
        focal=np.array([view.K_cam[0, 0] for view in views]),
        shapes=shapes,
    )
