"""One photo with the camera and the depth that another program found for it -> one view on its lattice."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from excavatwin.backbones.finished.lenses import Lens
from excavatwin.capture import read_photo
from excavatwin.scene.frames import unproject
from excavatwin.scene.observations import Lattice, View
from excavatwin.scene.photo import Photo
from excavatwin.scene.taxonomy import TASK_CLASSES

SURFACE = 0.02
"""Neighbouring depths belong to one surface when they differ by less than this share."""


@dataclass(frozen=True)
class DepthMap:
    """Depth as another program stored it."""

    depth: Float32[np.ndarray, "h w"]
    """Along the optical axis, NaN = none [su]."""
    lens: Lens
    """Of exactly this raster (its size is the raster's)."""
    confidence: Float32[np.ndarray, "h w"] | None = None
    """>= 0; None when the program tells none."""

    def turned(self, quarters: int) -> DepthMap:
        """The map as displayed, when its photo is turned clockwise by so many quarters."""
        confidence = None if self.confidence is None else np.rot90(self.confidence, -quarters)
        return DepthMap(np.rot90(self.depth, -quarters), replace(self.lens, turned=quarters), confidence)


@dataclass(frozen=True)
class PosedPhoto:
    """A photo with its lens and its pose, both of the photo as displayed."""

    photo: Photo
    lens: Lens
    T_R_cam: Float64[np.ndarray, "4 4"]
    """Camera-to-world, OpenCV axes [su]."""

    def shape(self, long_side: int, depth: DepthMap | None = None) -> tuple[int, int]:
        """(H, W) of its lattice: not finer than the photo, nor than its depth map."""
        width, height = self.lens.size
        factor = min(1.0, long_side / max(width, height))
        if depth is not None:
            factor = min(factor, float(depth.lens.K[0, 0] / self.lens.K[0, 0]))
        return max(2, round(height * factor)), max(2, round(width * factor))


def view_of(
    posed: PosedPhoto,
    lattice: Lattice,
    K_cam: Float64[np.ndarray, "3 3"],
    depth: Float32[np.ndarray, "H W"],
    confidence: Float32[np.ndarray, "H W"] | None = None,
) -> View:
    """The view, without evidence; where the lattice looks beyond the photo there is no point."""
    image, inside = resampled(posed.photo, posed.lens, K_cam, (depth.shape[0], depth.shape[1]))
    known = np.isfinite(depth) & (depth > 0) & inside
    confidence = np.ones(depth.shape, np.float32) if confidence is None else confidence
    return View(
        name=posed.photo.name,
        points=unproject(np.where(known, depth, np.float32(np.nan)), K_cam, posed.T_R_cam),
        confidence=np.where(known & np.isfinite(confidence), np.maximum(confidence, 0), 0).astype(np.float32),
        evidence=np.broadcast_to(np.float32(0), (*depth.shape, len(TASK_CLASSES))),  # one number in memory
        T_R_cam=posed.T_R_cam,
        K_cam=K_cam,
        image=image,
        lattice=lattice,
    )


def on_lattice(
    depth: DepthMap, K_cam: Float64[np.ndarray, "3 3"], shape: tuple[int, int]
) -> tuple[Float32[np.ndarray, "H W"], Float32[np.ndarray, "H W"] | None]:
    """Depth and confidence on the lattice (H, W), which has the same centre and axes as the depth map."""
    from excavatwin.kernels.splatting import sample_depth

    uv = np.ascontiguousarray(depth.lens.project(_rays(shape, K_cam)))
    found = sample_depth(np.ascontiguousarray(depth.depth, np.float32), uv, SURFACE).reshape(shape)
    if depth.confidence is None:
        return found, None
    height, width = depth.depth.shape
    with np.errstate(invalid="ignore"):
        col = np.clip(np.nan_to_num(uv[:, 0]), 0, width - 1).astype(int)
        row = np.clip(np.nan_to_num(uv[:, 1]), 0, height - 1).astype(int)
    return found, depth.confidence[row, col].reshape(shape).astype(np.float32)


def resampled(
    photo: Photo, lens: Lens, K_cam: Float64[np.ndarray, "3 3"], shape: tuple[int, int]
) -> tuple[UInt8[np.ndarray, "H W 3"], Bool[np.ndarray, "H W"]]:
    """The photo on its lattice, and where the lattice shows it. Lenses are undone at twice the size, then averaged.

    Raises:
        InputError: the photo can no longer be read.
    """
    import cv2

    H, W = shape
    if not lens.distorts:
        image = read_photo(photo, long_side=max(H, W))
        if image.shape[:2] != shape:
            image = cv2.resize(image, (W, H), interpolation=cv2.INTER_AREA)
        return image, np.ones(shape, bool)
    source = read_photo(photo, long_side=2 * max(H, W))
    fine = np.diag([2.0, 2.0, 1.0]) @ K_cam
    uv = lens.project(_rays((2 * H, 2 * W), fine)).reshape(2 * H, 2 * W, 2)
    with np.errstate(invalid="ignore"):
        inside: np.ndarray = np.asarray(((uv >= 0) & (uv <= lens.size)).all(axis=-1))
        inside[:, 1:] &= np.diff(uv[..., 0], axis=1) > 0  # beyond its range a polynomial folds back into the photo
        inside[1:] &= np.diff(uv[..., 1], axis=0) > 0
    at = uv * (source.shape[1] / lens.size[0], source.shape[0] / lens.size[1]) - 0.5  # OpenCV's centres lie at 0
    at = np.nan_to_num(at, nan=-1e6).clip(-1e6, 1e6).astype(np.float32)
    image = cv2.remap(source, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    image = cv2.resize(image, (W, H), interpolation=cv2.INTER_AREA)
    inside = np.asarray(inside.reshape(H, 2, W, 2).all(axis=(1, 3)))
    image[~inside] = 0
    return image, inside


def _rays(shape: tuple[int, ...], K_cam: Float64[np.ndarray, "3 3"]) -> Float64[np.ndarray, "n 2"]:
    """(x, y) at unit depth of the pixel centres of (H, W), row by row."""
    v, u = np.mgrid[: shape[0], : shape[1]] + 0.5
    return np.stack([(u.ravel() - K_cam[0, 2]) / K_cam[0, 0], (v.ravel() - K_cam[1, 2]) / K_cam[1, 1]], axis=1)
