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

    max_footprint: float = 2.5
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
    from excavatwin.kernels.lattice import valid_points

    views = observations.views
    centres = np.array([T_M_R[:3, :3] @ view.centre + T_M_R[:3, 3] for view in views])
    A = np.ascontiguousarray(T_M_R[:3])
    parts = [
        valid_points(view.points.reshape(-1, 3), A, centre, float(view.K_cam[0, 0]))
        for view, centre in zip(views, centres, strict=True)
    ]
    footprint = np.concatenate([part[2] for part in parts])
    if len(footprint) == 0:
        raise InputError("no pixel of any view has a reconstructed point; nothing can be mapped.")
    near = footprint <= max_footprint * np.median(footprint)
    counts = np.array([len(part[0]) for part in parts])
    near_by_view = np.split(near, np.cumsum(counts)[:-1])
    valid = [part[0][n] for part, n in zip(parts, near_by_view, strict=True)]
    shapes = tuple(view.shape for view in views)
    starts = np.cumsum([0, *(h * w for h, w in shapes)])[:-1]
    grey = np.full((1, 3), 128, np.uint8)
    return Points(
        xyz=np.concatenate([part[1] for part in parts])[near],
        confidence=np.concatenate([v.confidence.ravel()[at] for v, at in zip(views, valid, strict=True)]),
        evidence=np.concatenate([v.evidence.reshape(-1, K)[at] for v, at in zip(views, valid, strict=True)]),
        view=np.repeat(np.arange(len(views), dtype=np.int32), [len(at) for at in valid]),
        pixel=np.concatenate([start + at for start, at in zip(starts, valid, strict=True)]),
        rgb=np.concatenate(
            [
                grey.repeat(len(at), axis=0) if v.image is None else v.image.reshape(-1, 3)[at]
                for v, at in zip(views, valid, strict=True)
            ]
        ),
        footprint=footprint[near],
        centres=centres,
        shapes=shapes,
    )
