"""Depth maps as images (16-bit PNG or TIFF) and as arrays (NPY)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float32

from excavatwin.errors import InputError


def read_depth(path: Path, unit: float) -> Float32[np.ndarray, "h w"]:
    """Depth along the optical axis [su]; 0, negative and not finite values become NaN.

    Args:
        path: PNG or TIFF of one channel, or NPY.
        unit: what the values are multiplied by.

    Raises:
        InputError: the file is missing, damaged, or no map of depths.
    """
    try:
        values = np.load(path) if path.suffix.lower() == ".npy" else _pixels(path)
    except FileNotFoundError as error:
        raise InputError(f"{path} is missing; copy the whole folder.") from error
    except (OSError, ValueError, SyntaxError, EOFError) as error:
        raise InputError(f"{path} cannot be read as a depth map ({error}); copy it again.") from error
    values = np.squeeze(values)
    if values.ndim != 2 or values.dtype.kind not in "uif":
        raise InputError(f"{path} is {values.shape} of {values.dtype}; expected one depth for every pixel.")
    if values.dtype == np.uint8:
        raise InputError(f"{path} holds 8-bit values, a picture of depths; expected 16-bit or floating-point depths.")
    depth = values.astype(np.float32) * np.float32(unit)
    return np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(np.nan))


def image_size(path: Path) -> tuple[int, int]:
    """(width, height) of an image as stored [px].

    Raises:
        InputError: it cannot be read.
    """
    from PIL import Image

    try:
        with Image.open(path) as image:
            return image.size
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError(f"{path} cannot be read as an image ({error}); copy it again.") from error


def _pixels(path: Path) -> np.ndarray:
    from PIL import Image

    with Image.open(path) as image:
        return np.asarray(image)
