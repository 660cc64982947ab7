"""What a neighbourhood agrees on, as far as colour explains it: a guided filter over the terrain.

Within some metres the evidence of a class is fitted as a linear function of colour (the local linear model of He, Sun
and Tang, "Guided Image Filtering", PAMI 2013, with its coefficients on a coarser raster as in their fast variant), and
every voxel receives what the model says at its own colour. Errors of a segmenter come in patches smaller than the
fields of soil and grass, and what looks alike nearby is alike.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float32, Float64, Int64

BLOCKS = 4
"""Blocks of the coarser raster per radius."""


def agreed(
    xy: Float[np.ndarray, "n 2"],
    rgb: Float32[np.ndarray, "n 3"],
    evidence: Float32[np.ndarray, "n K"],
    radius: float,
    ridge: float,
) -> Float32[np.ndarray, "n K"]:
    """Evidence of every place as its neighbourhood and its colour let expect it.

    Args:
        xy: positions on the ground [m].
        rgb: colours, 0..255.
        evidence: evidence of the places; rows of zeros have no say but are given an answer.
        radius: standard deviation of the Gaussian neighbourhood [m].
        ridge: variance of colour, of 0..1, below which colour explains little.

    Returns:
        Expected evidence, >= 0; zero where nobody within three radii has a say.
    """
    from scipy.ndimage import gaussian_filter

    block = radius / BLOCKS
    cell = np.floor((xy - xy.min(axis=0)) / block).astype(np.int64) + 1
    shape = (int(cell[:, 0].max()) + 2, int(cell[:, 1].max()) + 2)
    c = rgb.astype(np.float64) / 255
    said = evidence.any(axis=1)
    columns = np.concatenate([np.ones((len(c), 1)), c, outer(c, c), evidence, outer(c, evidence)], axis=1)
    flat = cell[:, 0] * shape[1] + cell[:, 1]
    sums = block_sums(flat[said], columns[said], shape)
    moments = np.stack([gaussian_filter(m, BLOCKS, mode="constant", truncate=3.0) for m in sums], axis=-1)
    slope, offset = linear_model(moments, evidence.shape[1], ridge)
    at = ((xy - xy.min(axis=0)) / block + 0.5).T  # block centres lie at half a block
    expected = bilinear(offset, at)
    for i in range(3):
        expected += c[:, i : i + 1] * bilinear(slope[..., i, :], at)
    return np.maximum(expected, 0).astype(np.float32)


def outer(a: Float[np.ndarray, "n p"], b: Float[np.ndarray, "n q"]) -> Float64[np.ndarray, "n pq"]:
    """Products of all columns of a with all of b, row by row."""
    return (a[:, :, None] * b[:, None, :]).reshape(len(a), -1).astype(np.float64)


def block_sums(
    flat: Int64[np.ndarray, "m"], columns: Float64[np.ndarray, "m c"], shape: tuple[int, int]
) -> list[Float64[np.ndarray, "Y X"]]:
    """Sum of every column over the places of every block."""
    size = int(np.prod(shape))
    return [np.bincount(flat, column, size).reshape(shape) for column in columns.T]


def linear_model(
    moments: Float64[np.ndarray, "Y X c"], K: int, ridge: float
) -> tuple[Float64[np.ndarray, "Y X 3 K"], Float64[np.ndarray, "Y X K"]]:
    """(slope, offset) of evidence over colour in every block's neighbourhood; zeros where it is empty.

    Args:
        moments: sums of 1, c (3), c c^T (9), p (K), c p^T (3 K).
    """
    weight = moments[..., :1]
    m = np.divide(moments, weight, out=np.zeros_like(moments), where=weight > 1e-9)
    mean_c, mean_p = m[..., 1:4], m[..., 13 : 13 + K]
    grid = m.shape[:2]
    spread = m[..., 4:13].reshape(*grid, 3, 3) - mean_c[..., :, None] * mean_c[..., None, :]
    shared = m[..., 13 + K :].reshape(*grid, 3, K) - mean_c[..., :, None] * mean_p[..., None, :]
    slope = np.linalg.solve(spread + ridge * np.eye(3), shared)
    return slope, mean_p - (mean_c[..., None, :] @ slope)[..., 0, :]


def bilinear(raster: Float64[np.ndarray, "Y X K"], at: Float[np.ndarray, "2 n"]) -> Float64[np.ndarray, "n K"]:
    """Every channel of a raster at places between its cells."""
    from scipy.ndimage import map_coordinates

    channels = (raster[..., k] for k in range(raster.shape[-1]))
    return np.stack([map_coordinates(channel, at, order=1, mode="nearest") for channel in channels], axis=-1)
