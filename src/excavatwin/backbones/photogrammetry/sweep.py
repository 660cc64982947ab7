"""Depth of one view: a sweep of horizontal planes from coarse to fine, aggregated semi-globally."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float32, Float64

from excavatwin.backbones.photogrammetry.placement import PosedImage

if TYPE_CHECKING:
    from excavatwin.backbones.photogrammetry.dense import Dense


@dataclass(frozen=True)
class PlaneFamily:
    """Parallel planes below a camera. Plane w lies 1 / w from the camera centre, against ``normal``."""

    normal: Float64[np.ndarray, "3"]
    """Unit normal in frame R: +z, or tilted towards a camera that looks along the ground."""
    w_far: float
    """Inverse distance of the farthest (lowest) plane [1/su]."""
    w_near: float
    """Inverse distance of the nearest (highest) plane [1/su]."""


def plane_family(
    camera: PosedImage, xyz: Float64[np.ndarray, "n 3"], margin: float, grazing: float
) -> PlaneFamily | None:
    """Horizontal planes that enclose the points a camera sees; None when there are too few.

    Where more than a twentieth of the points is seen under less than ``grazing`` [deg] against the plane (hand-held
    photos of a heap), the normal tilts towards the camera until they are not; the limit is the fronto-parallel sweep.

    Args:
        xyz: sparse points that the camera sees [frame R].
        margin: the range of the points is widened on both sides by this share of it, and of the distance.
    """
    if len(xyz) < 8:
        return None
    rays = xyz - camera.T_R_cam[:3, 3]
    unit = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    back = -camera.T_R_cam[:3, 2]
    for tilt in (0.0, 0.15, 0.3, 0.5, 0.75, 1.0, 1.5, 2.5, 5.0, 1e6):
        normal = np.array([0, 0, 1.0]) + tilt * back
        normal = normal / np.linalg.norm(normal)
        if np.quantile(-unit @ normal, 0.05) > np.sin(np.radians(grazing)):
            break
    distance = -rays @ normal
    distance = distance[distance > 0]
    if len(distance) < 8:
        return None
    near, middle, far = np.quantile(distance, (0.01, 0.5, 0.99))
    widen = margin * (far - near) + 0.3 * margin * middle
    near = max(near - widen, 0.25 * middle, 0.5 * near)
    return PlaneFamily(normal, 1 / (far + widen), 1 / near)


@dataclass(frozen=True)
class Level:
    """Images and geometry of one view and its sources at one resolution; see ``kernels.plane_sweep.band_costs``."""

    reference: Float32[np.ndarray, "H W"]
    sources: Float32[np.ndarray, "S Hs Ws"]
    sizes: np.ndarray
    M: Float32[np.ndarray, "S 3 3"]
    t: Float32[np.ndarray, "S 3"]
    slope: Float32[np.ndarray, "H W"]


def grey_pyramid(image: PosedImage, levels: int) -> list[Float32[np.ndarray, "h w"]]:
    """Grey values of an image, finest first, each half the size of the one before; NaN where there is no photo."""
    import cv2

    grey: np.ndarray = cv2.cvtColor(image.image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    valid: np.ndarray | None = None if image.valid is None else (image.valid > 0).astype(np.float32)
    pyramid: list[np.ndarray] = []
    for level in range(levels):
        if level:
            size = (max(grey.shape[1] // 2, 2), max(grey.shape[0] // 2, 2))
            grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
            valid = None if valid is None else cv2.resize(valid, size, interpolation=cv2.INTER_AREA)
        masked = grey.copy()
        if valid is not None:
            masked[valid < 0.999] = np.nan
        pyramid.append(masked)
    return pyramid


def scaled_intrinsics(image: PosedImage, shape: tuple[int, ...]) -> Float64[np.ndarray, "3 3"]:
    """K of an image resized to ``shape``; pixel centres stay at +0.5."""
    h, w = image.image.shape[:2]
    return np.diag([shape[1] / w, shape[0] / h, 1.0]) @ image.K_cam


def rays(K: Float64[np.ndarray, "3 3"], T: Float64[np.ndarray, "4 4"], shape: tuple[int, int]) -> np.ndarray:
    """Direction (H, W, 3) in frame R of every pixel centre, of unit depth along the optical axis."""
    y, x = np.mgrid[: shape[0], : shape[1]] + 0.5
    return np.stack([x, y, np.ones_like(x)], -1) @ (T[:3, :3] @ np.linalg.inv(K)).T


def level_geometry(
    camera: PosedImage,
    others: Sequence[PosedImage],
    pyramids: Sequence[list[np.ndarray]],
    level: int,
    family: PlaneFamily,
) -> Level:
    """``pyramids`` holds the reference first, then its sources."""
    reference = pyramids[0][level]
    pictures = [pyramid[level] for pyramid in pyramids[1:]]
    shapes = np.array([picture.shape for picture in pictures], np.int64)
    sources = np.full((len(others), *shapes.max(0)), np.nan, np.float32)
    sizes = np.column_stack([shapes, np.full(len(others), sources.shape[2])])
    K_inv = np.linalg.inv(scaled_intrinsics(camera, reference.shape))
    M, t = np.empty((len(others), 3, 3)), np.empty((len(others), 3))
    for s, (other, picture) in enumerate(zip(others, pictures, strict=True)):
        sources[s, : picture.shape[0], : picture.shape[1]] = picture
        A = scaled_intrinsics(other, picture.shape) @ other.T_R_cam[:3, :3].T
        M[s] = A @ camera.T_R_cam[:3, :3] @ K_inv
        t[s] = A @ (camera.T_R_cam[:3, 3] - other.T_R_cam[:3, 3])
    K = scaled_intrinsics(camera, reference.shape)
    slope = -(rays(K, camera.T_R_cam, reference.shape) @ family.normal)
    return Level(
        reference,
        sources.reshape(len(others), -1),
        sizes,
        M.astype(np.float32),
        t.astype(np.float32),
        slope.astype(np.float32),
    )


def bilateral(gamma_tone: float, gamma_space: float) -> tuple[Float32[np.ndarray, "256"], Float32[np.ndarray, "5 5"]]:
    """Weights of a window's pixels by grey difference to the centre and by distance from it, both exponential."""
    offset = np.arange(-2, 3)
    distance = np.hypot(offset[:, None], offset)
    tone = np.exp(-np.arange(256) / gamma_tone)
    return tone.astype(np.float32), np.exp(-distance / gamma_space).astype(np.float32)


def plane_spacing(level: Level, family: PlaneFamily, step: float) -> float:
    """Change of w that moves a pixel by ``step`` px in its sources: upper quartile of pixels, mean of sources."""
    h, w = level.slope.shape
    y, x = np.mgrid[h // 16 : h : max(h // 8, 1), w // 16 : w : max(w // 8, 1)]
    slope = level.slope[y, x].ravel().astype(float)
    p = np.stack([x.ravel() + 0.5, y.ravel() + 0.5, np.ones(x.size)], -1)[slope > 0]
    slope = slope[slope > 0]
    middle = 0.5 * (family.w_far + family.w_near)
    small = 1e-3 * middle
    rates = []
    for s in range(len(level.M)):
        a, b = (
            p @ level.M[s].astype(float).T + (w_ * slope)[:, None] * level.t[s].astype(float)
            for w_ in (middle - small, middle + small)
        )
        front = (a[:, 2] > 0) & (b[:, 2] > 0)
        if front.any():
            shift = b[front, :2] / b[front, 2:] - a[front, :2] / a[front, 2:]
            rates.append(np.quantile(np.linalg.norm(shift, axis=1) / (2 * small), 0.75))
    return step / float(np.mean(rates))


def sweep_view(
    camera: PosedImage,
    others: Sequence[PosedImage],
    pyramids: Sequence[list[np.ndarray]],
    family: PlaneFamily,
    dense: Dense,
) -> tuple[Float32[np.ndarray, "H W"], Float32[np.ndarray, "H W"]]:
    """Depth along the optical axis [su], NaN = none, and 1 - ZNCC of its windows, of one view against its sources."""
    from excavatwin.kernels import plane_sweep, semi_global

    plane: np.ndarray | None = None
    spacing = spacing_before = 0.0
    steps = dense.steps
    for level in reversed(range(len(steps))):
        geometry = level_geometry(camera, others, pyramids, level, family)
        spacing = plane_spacing(geometry, family, steps[level])
        rows, cols = geometry.reference.shape
        far, near = family.w_far, family.w_near
        count = int(np.ceil((near - far) / spacing)) + 1
        ray_length = np.linalg.norm(
            rays(scaled_intrinsics(camera, (rows, cols)), camera.T_R_cam, (rows, cols)), axis=-1
        )
        allowed = (geometry.slope > np.sin(np.radians(dense.horizon)) * ray_length) & np.isfinite(geometry.reference)
        if plane is None:
            start = np.concatenate([[0], np.cumsum(np.where(allowed.ravel(), count, 0))]).astype(np.int64)
            first = np.zeros(rows * cols, np.int32)
        else:
            start, first = semi_global.narrow_bands(
                plane, spacing_before / spacing, rows, cols, dense.margins[level], dense.widest, count, allowed
            )
        reference = np.where(np.isfinite(geometry.reference), geometry.reference, 0).astype(np.float32)
        costs = plane_sweep.band_costs(
            plane_sweep.pad_to_tiles(reference), geometry.sources, geometry.sizes, geometry.M, geometry.t,
            plane_sweep.pad_to_tiles(geometry.slope), far, spacing, start, first.reshape(rows, cols),
            *bilateral(dense.gamma_tone, dense.gamma_space), np.float32(dense.noise**2), min(dense.keep, len(others)),
        )  # fmt: skip
        total = semi_global.aggregate(
            costs, start, first, reference, dense.P1, dense.P2, dense.P2_least, dense.contrast
        )
        index, cost = semi_global.winners(total, costs, start, first)
        plane = index.reshape(rows, cols)
        spacing_before = spacing
    assert plane is not None
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = 1 / ((family.w_far + plane.astype(float) * spacing) * geometry.slope)
    return depth.astype(np.float32), cost.reshape(rows, cols) / plane_sweep.WORST
