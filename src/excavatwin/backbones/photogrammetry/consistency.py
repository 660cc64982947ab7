"""Which depths to trust: those that other views find too, on surfaces of some size."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32, Float64

from excavatwin.backbones.photogrammetry.placement import PosedImage


def transfer(a: PosedImage, b: PosedImage) -> tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, "3"]]:
    """M, t such that pixel p of ``a`` at depth D lies at ``D M p + t`` (homogeneous pixel times depth) in ``b``."""
    A = b.K_cam @ b.T_R_cam[:3, :3].T
    M = A @ a.T_R_cam[:3, :3] @ np.linalg.inv(a.K_cam)
    return M, A @ (a.T_R_cam[:3, 3] - b.T_R_cam[:3, 3])


def agree(
    view: int,
    others: Sequence[int],
    images: Sequence[PosedImage],
    depths: Sequence[Float32[np.ndarray, "H W"]],
    pixels: float,
    relative: float,
) -> tuple[Float32[np.ndarray, "H W"], Float32[np.ndarray, "H W"]]:
    """Number of views that confirm each depth, and the depth that they and the view itself agree on.

    A view confirms a depth when its point, sent over to that view and back from the surface there, returns within
    ``pixels`` [px] and ``relative`` of its depth. The agreed depth is the harmonic mean of the depths at which the
    pixel's ray meets the surfaces that the views found: it is more precise than each of them.
    """
    from excavatwin.kernels import depth_maps

    depth = depths[view]
    votes = np.zeros(depth.shape, np.float32)
    with np.errstate(divide="ignore"):
        meeting = 1 / depth.astype(float)
    for other in others:
        M, t = transfer(images[view], images[other])
        N, n = transfer(images[other], images[view])
        depth_maps.add_agreement(depth, depths[other], M, t, N, n, pixels, relative, votes, meeting, 1.0)
    return votes, ((1 + votes) / meeting).astype(np.float32)


def drop_speckles(depth: Float32[np.ndarray, "H W"], relative: float, least: int) -> Float32[np.ndarray, "H W"]:
    """The depth map without connected surfaces of fewer than ``least`` pixels."""
    from excavatwin.kernels import depth_maps

    return np.where(depth_maps.surface_sizes(depth, relative) >= least, depth, np.nan).astype(np.float32)
