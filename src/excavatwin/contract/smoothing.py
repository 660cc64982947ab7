"""Slow changes of a picture, cheaply."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32


def slow(image: Float32[np.ndarray, "H W"], sigma: float) -> Float32[np.ndarray, "H W"]:
    """The picture blurred widely (standard deviation of ``sigma`` pixels), worked out on a coarser one."""
    import cv2

    H, W = image.shape
    step = max(1.0, sigma / 4)
    size = (max(2, round(W / step)), max(2, round(H / step)))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.resize(cv2.GaussianBlur(small, (0, 0), 4.0), (W, H), interpolation=cv2.INTER_LINEAR))
