"""Procedural noise: the same everywhere, for ever, from integers alone, so that a texture never repeats."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32, Float64
from numba import njit, prange


@njit(cache=True, inline="always")
def hash_unit(i, j, k, seed):
    """A number in [0, 1) that looks random, from three lattice indices and a seed."""
    h = (i * 374761393 + j * 668265263 + k * 987643207 + seed * 144269504) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 1274126177) & 0xFFFFFFFF
    h = ((h ^ (h >> 15)) * 1103515245) & 0xFFFFFFFF
    return (h ^ (h >> 16)) * (1.0 / 4294967296.0)


@njit(cache=True)
def noise3(x, y, z, seed):
    """Value noise in [-1, 1]: smooth interpolation of random numbers on the integer lattice (Perlin 1985)."""
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    u, v, w = x - i, y - j, z - k
    u, v, w = u * u * (3 - 2 * u), v * v * (3 - 2 * v), w * w * (3 - 2 * w)
    low = (
        (hash_unit(i, j, k, seed) * (1 - u) + hash_unit(i + 1, j, k, seed) * u) * (1 - v)
        + (hash_unit(i, j + 1, k, seed) * (1 - u) + hash_unit(i + 1, j + 1, k, seed) * u) * v
    )  # fmt: skip
    high = (
        (hash_unit(i, j, k + 1, seed) * (1 - u) + hash_unit(i + 1, j, k + 1, seed) * u) * (1 - v)
        + (hash_unit(i, j + 1, k + 1, seed) * (1 - u) + hash_unit(i + 1, j + 1, k + 1, seed) * u) * v
    )  # fmt: skip
    return 2 * (low * (1 - w) + high * w) - 1


@njit(cache=True)
def octaves(x, y, z, longest, ratio, gain, count, footprint, seed):
    """Sum of noises of shrinking wavelength, each turned against the last so that no lattice shows.

    Args:
        longest: wavelength of the first octave [m].
        ratio: wavelength of an octave over that of the next.
        gain: amplitude of an octave over that of the one before.
        footprint: edge of the area that a ray stands for [m]; octaves that it cannot resolve fade out.
    """
    total, amplitude, wavelength = 0.0, 1.0, longest
    for octave in range(count):
        visible = min(1.0, wavelength / max(footprint, 1e-9) - 1.0)
        if visible <= 0:
            break
        total += amplitude * visible * noise3(x / wavelength, y / wavelength, z / wavelength, seed + 101 * octave)
        x, y, z = 0.8 * x - 0.6 * y + 0.37, 0.6 * x + 0.8 * y - 0.91, z + 0.53  # 3-4-5 turn: exact, never periodic
        amplitude *= gain
        wavelength /= ratio
    return total


@njit(cache=True, parallel=True)
def noise_raster(
    x: Float64[np.ndarray, "X"],
    y: Float64[np.ndarray, "Y"],
    longest: float,
    ratio: float,
    gain: float,
    count: int,
    seed: int,
) -> Float32[np.ndarray, "Y X"]:
    """The octave sum on a raster of ground positions."""
    out = np.empty((y.size, x.size), np.float32)
    for row in prange(y.size):
        for col in range(x.size):
            out[row, col] = octaves(x[col], y[row], 0.0, longest, ratio, gain, count, 0.0, seed)
    return out


@njit(cache=True, parallel=True)
def noise_points(
    points: Float32[np.ndarray, "n 3"], longest: float, ratio: float, gain: float, count: int, seed: int
) -> Float32[np.ndarray, "n"]:
    """The octave sum at points of space; 0 where a point is NaN."""
    out = np.zeros(len(points), np.float32)
    for i in prange(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if np.isfinite(x + y + z):
            out[i] = octaves(x, y, z, longest, ratio, gain, count, 0.0, seed)
    return out
