"""A point cloud as the photos see it: a disc for every point, so large that no hidden point shows between them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64

from excavatwin.backbones.finished.clouds import CloudFile, thinned
from excavatwin.errors import InputError
from excavatwin.scene.frames import invert_rigid
from excavatwin.topology import nearest_neighbours

NEIGHBOURS = 8
"""A disc reaches to this neighbour of its point. Among points scattered at random at the same density, one disc in
3000 leaves its middle open (exp(-8)); on a grid it reaches over the diagonal."""
SHARE = 0.75
"""A pixel is covered when its ray passes a point within this share of the disc: about one point spacing."""
LEAST = 0.75
"""Discs of a cloud that is finer than the pixels grow to this radius [px]."""
FINE = 0.5
"""The cloud is thinned to this share of the finest pixel on it: denser points change nothing."""


@dataclass(frozen=True)
class Camera:
    """A pinhole camera on its lattice."""

    K_cam: Float64[np.ndarray, "3 3"]
    T_R_cam: Float64[np.ndarray, "4 4"]
    shape: tuple[int, int]
    """(H, W)."""


@dataclass(frozen=True)
class Surfels:
    """A cloud as discs, in frame R."""

    xyz: Float32[np.ndarray, "n 3"]
    normal: Float32[np.ndarray, "n 3"]
    """Of the plane through the point's neighbours, upward."""
    radius: Float32[np.ndarray, "n"]
    """Distance of the last neighbour [su]."""

    def depth(self, camera: Camera) -> Float32[np.ndarray, "H W"]:
        """Depth along the optical axis of the first surface on every pixel's ray; NaN where the cloud has none."""
        from excavatwin.kernels import splatting

        T = invert_rigid(camera.T_R_cam)
        R, t = np.ascontiguousarray(T[:3, :3]), np.ascontiguousarray(T[:3, 3])
        discs = (self.xyz, self.normal, self.radius, R, t, np.ascontiguousarray(camera.K_cam), LEAST)
        nearest = np.full(camera.shape, np.inf, np.float32)
        splatting.nearest_discs(*discs, nearest)
        total, weight = np.zeros(camera.shape), np.zeros(camera.shape)
        covered = np.zeros(camera.shape, bool)
        splatting.blend_discs(*discs, SHARE, nearest, total, weight, covered)
        with np.errstate(invalid="ignore"):
            return np.where(covered, total / weight, np.nan).astype(np.float32)


def surfels(file: CloudFile, origin: Float64[np.ndarray, "3"], cameras: Iterable[Camera]) -> Surfels:
    """The discs of a cloud, thinned to what the finest pixel of ``cameras`` resolves.

    Raises:
        InputError: no point lies before any camera, or there are too few.
    """
    from excavatwin.kernels.covariance import local_features

    sample = file.sample() - origin
    footprints = [footprint for camera in cameras if (footprint := finest_pixel(sample, camera)) is not None]
    if not footprints:
        raise InputError(
            f"no point of {file.path} lies in any of the photos; the cloud and the cameras are in different frames, or "
            "the poses are world-to-camera where camera-to-world was expected."
        )
    edge = FINE * float(np.percentile(footprints, 5))
    xyz = _without_strays(thinned(file, origin, edge))
    if len(xyz) <= NEIGHBOURS:
        raise InputError(f"{file.path} holds {len(xyz)} points only; give the dense point cloud.")
    spacing = max(edge, typical_spacing(xyz))
    neighbour, distance = nearest_neighbours(xyz, NEIGHBOURS, spacing)
    normal, *_ = local_features(xyz, neighbour)
    return Surfels(xyz, normal, np.ascontiguousarray(distance[:, -1]))


def finest_pixel(xyz: Float64[np.ndarray, "n 3"], camera: Camera) -> float | None:
    """Edge of a pixel on the nearest of the points that it sees (all but 2 % are farther) [su]; None when none is."""
    T = invert_rigid(camera.T_R_cam)
    p = xyz @ T[:3, :3].T + T[:3, 3]
    p = p[p[:, 2] > 0]
    (H, W), K = camera.shape, camera.K_cam
    u, v = K[0, 0] * p[:, 0] / p[:, 2] + K[0, 2], K[1, 1] * p[:, 1] / p[:, 2] + K[1, 2]
    z = p[(u >= 0) & (u < W) & (v >= 0) & (v < H), 2]
    return float(np.percentile(z, 2) / K[0, 0]) if len(z) else None


def typical_spacing(xyz: Float32[np.ndarray, "n 3"], samples: int = 500) -> float:
    """Median distance to the nearest other point, of some points."""
    from scipy.spatial import cKDTree

    tree = cKDTree(xyz, balanced_tree=False, compact_nodes=False)
    distance, _ = tree.query(xyz[:: max(1, len(xyz) // samples)], 2)
    return float(np.median(distance[:, 1]))


def _without_strays(xyz: Float32[np.ndarray, "n 3"]) -> Float32[np.ndarray, "m 3"]:
    """Points at most a hundred times as far from the middle as half of them: a stray would stretch every grid."""
    if not len(xyz):
        return xyz
    distance = np.abs(xyz - np.median(xyz, axis=0)).max(axis=1)
    return xyz[distance <= 100 * np.median(distance)]
