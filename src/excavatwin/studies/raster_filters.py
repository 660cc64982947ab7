"""Our transcriptions, from the publications, of two filters that work on a raster: PMF and SMRF."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64


@dataclass(frozen=True)
class Pmf:
    """Progressive morphological filter (Zhang et al., 2003), windows growing exponentially, tested point by point."""

    cell: float = 1.0
    """[m]"""
    slope: float = 1.0
    """Steepest terrain (tangent)."""
    initial: float = 0.15
    """dh_0: height threshold of the smallest window [m]."""
    highest: float = 2.5
    """dh_max: no threshold is higher [m]."""
    window: float = 33.0
    """Widest window [cells]."""

    name = "PMF (our raster transcription)"

    def __call__(self, xyz: Float64[np.ndarray, "N 3"]) -> Bool[np.ndarray, "N"]:
        """Points that no opening leaves more than its threshold below them."""
        from excavatwin.kernels.morphology import opening

        H, place = lowest(xyz, self.cell)
        H, flat = nearest_filled(H), tuple(place)
        ground = np.ones(len(xyz), bool)
        last, radius = 1, 1
        while 2 * radius + 1 <= self.window:
            width = 2 * radius + 1
            grown = self.slope * (width - last) * self.cell if width > 3 else 0.0
            H = opening(H, radius)
            ground &= xyz[:, 2] - H[flat] <= min(self.initial + grown, self.highest)
            last, radius = width, 2 * radius
        return ground


@dataclass(frozen=True)
class Smrf:
    """Simple morphological filter (Pingel, Clarke and McBride, 2013). Where the paper inpaints with a spring metaphor,
    holes are filled here with the surface whose Laplacian is zero."""

    cell: float = 1.0
    """[m]"""
    slope: float = 0.15
    """Steepest terrain (tangent)."""
    window: float = 18.0
    """Largest radius of the window [m]."""
    threshold: float = 0.5
    """Height above the ground within which a point belongs to it [m]."""
    scaling: float = 1.25
    """What the ground's slope (tangent) adds to the threshold [m]."""

    name = "SMRF (our transcription)"

    def __call__(self, xyz: Float64[np.ndarray, "N 3"]) -> Bool[np.ndarray, "N"]:
        """Points near the surface that is left without low outliers and objects."""
        from scipy.ndimage import map_coordinates

        H, _ = lowest(xyz, self.cell)
        empty, H = np.isnan(H), laplace_filled(H)
        low = self.raised(-H, 5.0, self.cell)
        H = laplace_filled(np.where(low, np.nan, H))
        bare = laplace_filled(np.where(self.raised(H, self.slope, self.window) | empty | low, np.nan, H))
        steep = np.hypot(*np.gradient(bare, self.cell)) if min(bare.shape) > 1 else np.zeros(bare.shape)
        at = ((xyz[:, :2] - origin(xyz, self.cell)) / self.cell - 0.5)[:, ::-1].T
        z, s = (map_coordinates(A, at, order=1, mode="nearest") for A in (bare, steep))
        return np.abs(xyz[:, 2] - z) <= self.threshold + self.scaling * s

    def raised(self, H: Float64[np.ndarray, "Y X"], slope: float, window: float) -> Bool[np.ndarray, "Y X"]:
        """Cells that an opening by a growing disc lowers by more than ``slope`` times its radius."""
        from scipy.ndimage import grey_opening

        raised, last = np.zeros(H.shape, bool), H
        for radius in range(1, int(np.ceil(window / self.cell)) + 1):
            y, x = np.ogrid[-radius : radius + 1, -radius : radius + 1]
            padded = np.pad(last, radius, mode="edge")
            opened = grey_opening(padded, footprint=x * x + y * y <= radius * radius)[radius:-radius, radius:-radius]
            raised |= last - opened > slope * radius * self.cell
            last = opened
        return raised


def origin(xyz: Float64[np.ndarray, "N 3"], cell: float) -> Float64[np.ndarray, "2"]:
    """South-west corner of the raster, at a multiple of the cell [m]."""
    return np.floor(xyz[:, :2].min(axis=0) / cell) * cell


def lowest(xyz: Float64[np.ndarray, "N 3"], cell: float) -> tuple[Float64[np.ndarray, "Y X"], np.ndarray]:
    """Lowest height of every cell (NaN = none; row 0 south), and the row and column of every point, (2, N)."""
    place = ((xyz[:, :2] - origin(xyz, cell)) / cell).astype(int)[:, ::-1].T
    H = np.full(tuple(place.max(axis=1) + 1), np.inf)
    np.minimum.at(H, tuple(place), xyz[:, 2])
    H[np.isinf(H)] = np.nan
    return H, place


def nearest_filled(H: Float64[np.ndarray, "Y X"]) -> Float64[np.ndarray, "Y X"]:
    """Empty cells take the height of the nearest known one."""
    from scipy.ndimage import distance_transform_edt

    return H[tuple(distance_transform_edt(np.isnan(H), return_distances=False, return_indices=True))]


def laplace_filled(H: Float64[np.ndarray, "Y X"]) -> Float64[np.ndarray, "Y X"]:
    """Empty cells become the mean of their edge neighbours, all at once; the border reflects."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.linalg import spsolve

    hole = np.isnan(H)
    n = int(hole.sum())
    if n == 0 or n == H.size:
        return H
    number = np.full(H.shape, -1)
    number[hole] = np.arange(n)
    rows, cols, known = [], [], np.zeros(n)
    degree = np.zeros(n)
    here, column = np.nonzero(hole)
    for dy, dx in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        y, x = here + dy, column + dx
        own = np.flatnonzero((y >= 0) & (y < H.shape[0]) & (x >= 0) & (x < H.shape[1]))
        degree[own] += 1
        other = number[y[own], x[own]]
        known[own[other < 0]] += H[y[own], x[own]][other < 0]
        rows.append(own[other >= 0])
        cols.append(other[other >= 0])
    row, col = np.concatenate([*rows, np.arange(n)]), np.concatenate([*cols, np.arange(n)])
    value = np.concatenate([-np.ones(len(row) - n), degree])
    filled = H.copy()
    filled[hole] = spsolve(coo_matrix((value, (row, col)), shape=(n, n)).tocsc(), known)
    return filled
