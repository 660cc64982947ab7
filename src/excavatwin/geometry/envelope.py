"""Raster steps of the terrain envelope: progressive filter, boundaries of regions, ground under objects."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float32, Int32

from excavatwin.paper import equation

#: Half of the 8-neighbourhood: every pair of adjacent cells once, as (row step, column step).
_PAIRS = ((0, 1), (1, -1), (1, 0), (1, 1))


def progressive_filter(
    H: Float32[np.ndarray, "Y X"], cell: float, window: float, step: float, slope: float
) -> Bool[np.ndarray, "Y X"]:
    """Cells that stand off the ground, by openings with a window that grows cell by cell (after Zhang et al., 2003).

    Each opening lowers a ridge of inclination ``slope`` by about slope times half the growth of the window (sqrt(2)
    times that for a cone under a square window), so heaps at their angle of repose pass whatever their size; a body
    with steep sides falls by its whole height at once.
    Openings never touch what lies *below* its surroundings: pits and trenches stay.

    Args:
        H: reference elevation, NaN = none [m].
        cell: edge of a cell [m].
        window: width of the widest body that must be removed [m].
        step: height that is noise [m].
        slope: steepest inclination of terrain that stands up (tangent).
    """
    from excavatwin.kernels.morphology import opening

    raised = np.zeros(H.shape, bool)
    surface = H
    for radius in range(1, max(1, int(np.ceil(window / cell / 2))) + 1):
        opened = opening(surface, radius)
        with np.errstate(invalid="ignore"):
            raised |= surface - opened > step + slope * np.sqrt(2) * cell
        surface = opened
    return raised


@equation("eq:gc_continuity")
def continuity_regions(
    H: Float32[np.ndarray, "Y X"], member: Bool[np.ndarray, "Y X"], delta_h: float, L: float, delta_s: float, d: float
) -> Int32[np.ndarray, "Y X"]:
    """Regions of adjacent member cells with |H(a) - H(b)| <= delta_h L + delta_s d(a, b).

    Args:
        H: reference elevation [m].
        member: cells that take part.
        delta_h: height tolerance in units of L.
        L: reference length [m].
        delta_s: slope tolerance (tangent).
        d: spacing of edge-adjacent cells [m]; diagonal ones are sqrt(2) d apart.

    Returns:
        Region ids from 0 in row-major order of their first cell, -1 elsewhere.
    """
    from excavatwin.kernels.union_find import continuous_cells

    return continuous_cells(H, member & np.isfinite(H), delta_h * L, delta_s, d)


def boundary_steps(
    H: Float32[np.ndarray, "Y X"], region: Int32[np.ndarray, "Y X"], tolerance: float, slope: float, cell: float
) -> tuple[Float32[np.ndarray, "R"], Float32[np.ndarray, "R"]]:
    """How every region (ids from 0, -1 = outside all) meets the observed cells around it.

    Returns:
        (share of adjacent pairs across its boundary where it stands higher by more than ``tolerance + slope * d``;
        share where it passes continuously). Zero for a region without observed surroundings.
    """
    n = int(region.max(initial=-1)) + 1
    up, level, pairs = np.zeros(n), np.zeros(n), np.zeros(n)
    rows, cols = H.shape
    for dy, dx in _PAIRS:
        a = (slice(0, rows - dy), slice(max(0, -dx), cols - max(0, dx)))
        b = (slice(dy, rows), slice(max(0, dx), cols - max(0, -dx)))
        allowed = tolerance + slope * cell * np.hypot(dy, dx)
        for own, other in ((a, b), (b, a)):
            r = region[own]
            across = (r >= 0) & (r != region[other]) & np.isfinite(H[own]) & np.isfinite(H[other])
            difference = (H[own] - H[other])[across]
            pairs += np.bincount(r[across], minlength=n)
            up += np.bincount(r[across], weights=difference > allowed, minlength=n)
            level += np.bincount(r[across], weights=np.abs(difference) <= allowed, minlength=n)
    some = np.maximum(pairs, 1)
    return (up / some).astype(np.float32), (level / some).astype(np.float32)


def bridge_gaps(H: Float32[np.ndarray, "Y X"], gap: float) -> Float32[np.ndarray, "Y X"]:
    """``H`` with empty cells at most ``gap`` cells away from an observed one filled from the nearest."""
    from scipy.ndimage import distance_transform_edt

    empty = ~np.isfinite(H)
    if gap <= 0 or empty.all():
        return H
    distance, nearest = distance_transform_edt(empty, return_indices=True)
    return np.where(distance <= gap, H[tuple(nearest)], np.nan).astype(np.float32)


def fill_ground(H: Float32[np.ndarray, "Y X"], terrain: Bool[np.ndarray, "Y X"]) -> Float32[np.ndarray, "Y X"]:
    """The terrain surface carried on below objects and over gaps: nearest terrain cell, then relaxed to a membrane."""
    from scipy.ndimage import distance_transform_edt, uniform_filter

    if not terrain.any():
        level = np.nanmedian(H) if np.isfinite(H).any() else 0.0
        return np.full(H.shape, level, np.float32)
    nearest = distance_transform_edt(~terrain, return_distances=False, return_indices=True)
    filled = H[tuple(nearest)].astype(np.float32)
    for size in (15, 9, 5, 3, 3, 3):
        filled = np.where(terrain, H, uniform_filter(filled, size, mode="nearest")).astype(np.float32)
    return filled
