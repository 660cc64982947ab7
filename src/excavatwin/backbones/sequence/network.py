"""A feed-forward reconstruction network as the driver sees it: some images in, points and cameras out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float32, Float64, UInt8


@dataclass(frozen=True)
class Prediction:
    """What a network says about S images, in a frame of its own choice (one similarity for all of them)."""

    points: Float32[np.ndarray, "S H W 3"]
    """World point of every pixel [su]; NaN where there is none (sky mask of the network, padding)."""
    confidence: Float32[np.ndarray, "S H W"]
    """>= 0, larger is surer."""
    T_world_cam: Float64[np.ndarray, "S 4 4"]
    """Camera-to-world poses, OpenCV axes [su]."""
    K_cam: Float64[np.ndarray, "S 3 3"]
    """Intrinsics on the lattice, pixel centres at +0.5 [px]."""
    metric: bool = False
    """Whether su are metres."""


class Network(Protocol):
    """A loaded network."""

    def __call__(self, images: UInt8[np.ndarray, "S H W 3"]) -> Prediction:
        """Reconstruct these images together; raises whatever the model raises when memory runs out."""
        ...
