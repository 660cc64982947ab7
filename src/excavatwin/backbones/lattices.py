"""From a photo to the pixels that a network wants, and the affine map between both (docs/conventions.md).

Networks are trained on images that were shrunk, cropped or padded in one particular way. Each way is an affine map of
the photo; whoever forgets it puts classes beside their points. Pixel centres lie at +0.5 on both sides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from excavatwin.errors import InputError

Mode = Literal["crop", "pad", "stretch"]


@dataclass(frozen=True)
class Fit:
    """How a photo of one size comes onto a lattice of another: resized to ``resized``, then moved by ``offset``."""

    size: tuple[int, int]
    """(width, height) of the photo [px]."""
    shape: tuple[int, int]
    """(H, W) of the lattice [px]."""
    resized: tuple[int, int]
    """(width, height) of the photo after resizing [px]."""
    offset: tuple[int, int]
    """(x, y) of the resized photo's upper left corner on the lattice; negative where it is cropped [px]."""

    @property
    def affine(self) -> Float64[np.ndarray, "2 3"]:
        """lattice = affine @ (x, y, 1) of the photo."""
        x, y = self.resized[0] / self.size[0], self.resized[1] / self.size[1]
        return np.array([[x, 0.0, self.offset[0]], [0.0, y, self.offset[1]]])

    def image(self, photo: UInt8[np.ndarray, "h w 3"], fill: int = 255) -> UInt8[np.ndarray, "H W 3"]:
        """The photo on the lattice, bicubic with antialiasing (as Pillow does, on which networks were trained)."""
        from PIL import Image

        small = np.asarray(Image.fromarray(photo).resize(self.resized, Image.Resampling.BICUBIC))
        lattice = np.full((*self.shape, 3), fill, np.uint8)
        rows, cols, from_rows, from_cols = self._overlap()
        lattice[rows, cols] = small[from_rows, from_cols]
        return lattice

    def inside(self) -> Bool[np.ndarray, "H W"]:
        """Lattice pixels that show the photo and not the padding."""
        mask = np.zeros(self.shape, bool)
        rows, cols, _, _ = self._overlap()
        mask[rows, cols] = True
        return mask

    def K_photo(self, K_cam: Float64[np.ndarray, "3 3"]) -> Float64[np.ndarray, "3 3"]:
        """Intrinsics of the photo from those on the lattice."""
        return np.linalg.inv(np.vstack([self.affine, [0.0, 0.0, 1.0]])) @ K_cam

    def _overlap(self) -> tuple[slice, slice, slice, slice]:
        (H, W), (w, h), (x, y) = self.shape, self.resized, self.offset
        top, left, bottom, right = max(y, 0), max(x, 0), min(y + h, H), min(x + w, W)
        return (
            slice(top, bottom),
            slice(left, right),
            slice(top - y, bottom - y),
            slice(left - x, right - x),
        )


def lattice_shape(size: tuple[int, int], long_side: int, multiple: int, mode: Mode = "crop") -> tuple[int, int]:
    """(H, W) of the lattice for photos of ``size`` (width, height): long side fixed, sides multiples of the patch size.

    With ``pad`` the lattice is square. ``long_side`` must be a multiple itself.
    """
    if long_side % multiple:
        raise InputError(
            f"a lattice of {long_side} px is not a multiple of the patch size {multiple}; "
            f"use {long_side // multiple * multiple} or {(long_side // multiple + 1) * multiple}."
        )
    if mode == "pad":
        return long_side, long_side
    short = max(1, round(long_side * min(size) / max(size) / multiple)) * multiple
    return (short, long_side) if size[0] >= size[1] else (long_side, short)


def fit(size: tuple[int, int], shape: tuple[int, int], mode: Mode = "crop") -> Fit:
    """How a photo of ``size`` (width, height) comes onto a lattice of ``shape`` (H, W).

    ``crop`` covers the lattice and cuts what juts out, ``pad`` shows the whole photo and leaves a border, both centred
    and of equal scale in x and y up to rounding; ``stretch`` fills the lattice with the whole photo.
    """
    (width, height), (H, W) = size, shape
    if mode == "stretch":
        return Fit(size, shape, (W, H), (0, 0))
    choose = max if mode == "crop" else min
    scale = choose(W / width, H / height)
    resized = (max(1, round(width * scale)), max(1, round(height * scale)))
    return Fit(size, shape, resized, ((W - resized[0]) // 2, (H - resized[1]) // 2))


def normalised(
    image: UInt8[np.ndarray, "H W 3"],
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0),
    std: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> Float32[np.ndarray, "3 H W"]:
    """RGB in 0..255 to (value / 255 - mean) / std, channels first and in the order red, green, blue."""
    scaled = (image.astype(np.float32) / 255 - np.asarray(mean, np.float32)) / np.asarray(std, np.float32)
    return np.ascontiguousarray(scaled.transpose(2, 0, 1))


#: Mean and standard deviation of ImageNet, which most networks were trained with (RGB, 0..1).
IMAGENET = ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))
