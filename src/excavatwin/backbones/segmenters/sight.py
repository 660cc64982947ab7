"""A picture as a network sees it, and its answers back on the pixels of the picture; one ``Fit`` says both ways.

``Fit.size`` is the picture, ``Fit.shape`` the network's input. Pixel centres lie at +0.5 on both sides and on the
coarser grids of masks, whose outline is that of the input.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float, Float32, Float64, UInt8

from excavatwin.backbones.lattices import Fit
from excavatwin.backbones.segmenters.resampling import neighbours
from excavatwin.errors import InputError


def checked(image: UInt8[np.ndarray, "H W 3"], name: str) -> tuple[int, int]:
    """(width, height) of an image that a segmenter can take.

    Raises:
        InputError: it is not (H, W, 3) uint8.
    """
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or not image.size:
        raise InputError(f"segmenter {name} needs an RGB image (H, W, 3) uint8, not {image.shape} {image.dtype}.")
    return image.shape[1], image.shape[0]


def letterbox(size: tuple[int, int], long_side: int, multiple: int) -> Fit:
    """The long side at ``long_side``, sides padded on both ends to multiples (as Ultralytics does)."""
    width, height = size
    scale = long_side / max(size)
    resized = (max(1, round(width * scale)), max(1, round(height * scale)))
    shape = (math.ceil(resized[1] / multiple) * multiple, math.ceil(resized[0] / multiple) * multiple)
    return Fit(size, shape, resized, ((shape[1] - resized[0]) // 2, (shape[0] - resized[1]) // 2))


def cornered(size: tuple[int, int], side: int) -> Fit:
    """The long side at ``side``, padded at the right or at the bottom to a square (as SAM 1 does)."""
    scale = side / max(size)
    resized = (int(size[0] * scale + 0.5), int(size[1] * scale + 0.5))
    return Fit(size, (side, side), (max(1, resized[0]), max(1, resized[1])), (0, 0))


def bounded(size: tuple[int, int], short: int, long: int) -> Fit:
    """The short side at ``short`` unless the long one would exceed ``long`` (as detection transformers do)."""
    least, most = min(size), max(size)
    fits = most / least * short <= long
    low, high = (short, int(short * most / least)) if fits else (round(long * least / most), long)  # rounded as they do
    sides = max(1, low), max(1, high)
    resized = sides if size[0] <= size[1] else sides[::-1]
    return Fit(size, (resized[1], resized[0]), resized, (0, 0))


def shown(
    image: UInt8[np.ndarray, "h w 3"], fit: Fit, fill: int = 0, smooth: bool = True
) -> UInt8[np.ndarray, "H W 3"]:
    """The picture as the network's input, bilinear.

    Args:
        image: RGB.
        fit: from the picture to the input.
        fill: value of the padding.
        smooth: antialiased when shrunk, as torchvision and Pillow do; OpenCV, and Ultralytics with it, does not.
    """
    if smooth:
        from PIL import Image

        small = np.asarray(Image.fromarray(image).resize(fit.resized, Image.Resampling.BILINEAR))
    else:
        import cv2

        small = np.asarray(cv2.resize(image, fit.resized, interpolation=cv2.INTER_LINEAR))
    canvas = np.full((*fit.shape, 3), fill, np.uint8)
    x, y = fit.offset
    canvas[y : y + fit.resized[1], x : x + fit.resized[0]] = small
    return canvas


def returned(grid: Float[np.ndarray, "h w"], fit: Fit) -> Float32[np.ndarray, "H W"]:
    """A map that covers the network's input, at the pixel centres of the picture, bilinear."""
    (width, height), (x0, y0) = fit.size, fit.offset
    x = (np.arange(width) + 0.5) * (fit.resized[0] / width) + x0
    y = (np.arange(height) + 0.5) * (fit.resized[1] / height) + y0
    rows = neighbours(y * (grid.shape[0] / fit.shape[0]), grid.shape[0])
    cols = neighbours(x * (grid.shape[1] / fit.shape[1]), grid.shape[1])
    grid = np.asarray(grid, np.float32)
    first, second, part = rows
    grid = grid[first] * (1 - part[:, None]) + grid[second] * part[:, None]
    first, second, part = cols
    return np.asarray(grid[:, first] * (1 - part) + grid[:, second] * part, np.float32)


def to_input(boxes: Float[np.ndarray, "n 4"], fit: Fit) -> Float64[np.ndarray, "n 4"]:
    """Boxes x0, y0, x1, y1 of the picture [px] on the network's input [px]."""
    scale, offset = _scale_offset(fit)
    return np.asarray(boxes, float) * scale + offset


def from_input(boxes: Float[np.ndarray, "n 4"], fit: Fit) -> Float64[np.ndarray, "n 4"]:
    """Boxes x0, y0, x1, y1 of the network's input [px] on the picture [px]."""
    scale, offset = _scale_offset(fit)
    return (np.asarray(boxes, float) - offset) / scale


def _scale_offset(fit: Fit) -> tuple[Float64[np.ndarray, "4"], Float64[np.ndarray, "4"]]:
    affine = fit.affine
    return np.tile(np.diag(affine[:, :2]), 2), np.tile(affine[:, 2], 2)
