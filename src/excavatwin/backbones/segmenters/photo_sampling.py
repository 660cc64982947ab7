"""From label images that lie on a photo to the pixels of its lattice: what share of each pixel is which label."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float32, Float64, Integer

from excavatwin.scene.observations import Lattice

#: Most samples along each side of a lattice pixel.
FINEST = 4


def to_photo(lattice: Lattice, uv: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
    """Pixels of the photo, lens and all, that lattice coordinates show; the inverse of ``Lattice.from_photo``."""
    undistorted = np.linalg.solve(lattice.affine[:, :2], (np.asarray(uv, float) - lattice.affine[:, 2]).T).T
    if not any(lattice.distortion):
        return undistorted
    f = np.array([lattice.K_photo[0, 0], lattice.K_photo[1, 1]])
    x = (undistorted - lattice.K_photo[:2, 2]) / f
    k1, k2, p1, p2 = lattice.distortion
    r2, xy = (x**2).sum(-1, keepdims=True), x[:, :1] * x[:, 1:]
    tangential = np.concatenate(
        [2 * p1 * xy + p2 * (r2 + 2 * x[:, :1] ** 2), p1 * (r2 + 2 * x[:, 1:] ** 2) + 2 * p2 * xy], axis=-1
    )
    return (x * (1 + k1 * r2 + k2 * r2 * r2) + tangential) * f + lattice.K_photo[:2, 2]


def shares(
    index: Integer[np.ndarray, "h w"],
    table: Float32[np.ndarray, "n M"],
    lattice: Lattice | None,
    shape: tuple[int, int],
) -> Float32[np.ndarray, "H W M"]:
    """Mean of the table's rows over the area of each lattice pixel; what lies outside the photo counts as zero.

    A lattice pixel shows many pixels of a large photo. It is sampled at up to 4 x 4 places, the nearest label at each:
    classes are never mixed, their shares are.

    Args:
        index: row of the table for every pixel of an image that covers the photo, of whatever size.
        table: values of each label.
        lattice: where the lattice lies in the photo; None when the lattice is the photo.
        shape: (H, W) of the lattice.
    """
    (H, W), (h, w) = shape, index.shape
    size = (W, H) if lattice is None else (lattice.width, lattice.height)
    area = 1.0 if lattice is None else 1 / abs(np.linalg.det(lattice.affine[:, :2]))
    fine = min(max(math.ceil(math.sqrt(area * (w / size[0]) * (h / size[1])) - 1e-6), 1), FINEST)
    rows = np.concatenate([table, np.zeros((1, table.shape[1]), np.float32)])
    v, u = np.meshgrid(np.arange(H, dtype=float), np.arange(W, dtype=float), indexing="ij")
    total = np.zeros((H, W, table.shape[1]), np.float32)
    for place in range(fine * fine):
        at = np.stack([u + (place % fine + 0.5) / fine, v + (place // fine + 0.5) / fine], -1).reshape(-1, 2)
        at = at if lattice is None else to_photo(lattice, at)
        col, row = np.floor(at * (w / size[0], h / size[1])).astype(np.int64).T
        inside = (col >= 0) & (col < w) & (row >= 0) & (row < h)
        label = np.full(H * W, len(table), np.int64)
        label[inside] = index[row[inside], col[inside]]
        total += rows[label].reshape(H, W, -1)
    return total / np.float32(fine * fine)
