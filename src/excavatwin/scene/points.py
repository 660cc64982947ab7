"""Points: the valid samples of all views in one table, each with the way back to its pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int32, Int64, UInt8


@dataclass(frozen=True)
class Points:
    """N samples, ordered by view and then by pixel, in frame M (local origin, z up)."""

    xyz: Float32[np.ndarray, "N 3"]
    """p_su [m]."""
    confidence: Float32[np.ndarray, "N"]
    """c_su as the backbone gave it."""
    evidence: Float32[np.ndarray, "N K"]
    """o_su: evidence of the sample's own pixel."""
    view: Int32[np.ndarray, "N"]
    """s."""
    pixel: Int64[np.ndarray, "N"]
    """Flat index of the pixel in the concatenation of all lattices (row-major, view after view)."""
    rgb: UInt8[np.ndarray, "N 3"]
    """Colour; grey where the view carries no image."""
    centres: Float64[np.ndarray, "S 3"]
    """Camera centres [m]."""
    footprint: Float32[np.ndarray, "N"]
    """Extent of every sample's pixel at its point, distance / focal length [m]."""
    shapes: tuple[tuple[int, int], ...]
    """(H, W) of every view's lattice."""

    def __len__(self) -> int:
        return len(self.xyz)

    def unflatten(self, values: np.ndarray, fill: float | int) -> list[np.ndarray]:
        """Per-sample values (N, ...) as one (H, W, ...) image a view; ``fill`` where a pixel has no sample."""
        total = sum(h * w for h, w in self.shapes)
        flat = np.full((total, *values.shape[1:]), fill, values.dtype)
        flat[self.pixel] = values
        images, start = [], 0
        for h, w in self.shapes:
            images.append(flat[start : start + h * w].reshape(h, w, *values.shape[1:]))
            start += h * w
        return images
