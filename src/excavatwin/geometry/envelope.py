"""Raster steps of the terrain envelope: progressive filter, boundaries of regions, ground under objects."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float32, Int32

from excavatwin.paper import equation


def progressive_filter(
    H: Float32[np.ndarray, "Y X"], cell: float, window: float, step: float, slope: float, smear: int
) -> tuple[Bool[np.ndarray, "Y X"], Float32[np.ndarray, "Y X"]]:
    """Cells that stand off the ground, by openings with a window that grows step by step (after Zhang et al., 2003).

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
        smear: width of a step in the reference surface [cells]: a body may fall over that many openings.

    Returns:
        (raised cells, what the last opening left).
    """
    from excavatwin.kernels.morphology import opening

    raised = np.zeros(H.shape, bool)
    last = max(1, int(np.ceil(window / cell / 2)))
    surfaces, radii = [H], [0]
    while radii[-1] < last:
        radius = min(last, radii[-1] + max(1, radii[-1] // 6))  # large windows may grow faster: large bodies are high
        opened = opening(surfaces[-1], radius)
        for lag in {1, min(smear, len(surfaces))}:
            growth = radius - radii[-lag]
            with np.errstate(invalid="ignore"):
                raised |= surfaces[-lag] - opened > step + slope * np.sqrt(2) * growth * cell
        surfaces, radii = [*surfaces, opened][-smear:], [*radii, radius][-smear:]
    return raised, surfaces[-1]


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


def steep_rims(
    H: Float32[np.ndarray, "Y X"], blob: Int32[np.ndarray, "Y X"], reach: int, allowed: float
) -> Float32[np.ndarray, "R"]:
    """Share of every blob's rim (ids from 0, -1 = outside all) that drops by more than ``allowed`` within ``reach``
    cells outside all blobs. Stereo smears a sharp step over two or three cells, so neighbours alone do not tell.
    Rims at the edge of the map may be steep or not: they count by one half."""
    from excavatwin.kernels.morphology import disc_drop, windowed_extreme

    n = int(blob.max(initial=-1)) + 1
    inside = np.pad(blob >= 0, 1).astype(np.float32)
    border = (blob >= 0) & (windowed_extreme(inside, 1, False)[1:-1, 1:-1] == 0)
    around = np.isfinite(H) & (blob < 0)
    rim = border & (windowed_extreme(around.astype(np.float32), 1, True) > 0)
    steep = rim & (disc_drop(H, around, reach) > allowed)
    rims = np.bincount(blob[rim], minlength=n) + 0.5 * np.bincount(blob[border & ~rim], minlength=n)
    return (np.bincount(blob[steep], minlength=n) / np.maximum(rims, 1)).astype(np.float32)


def raised_rims(
    H: Float32[np.ndarray, "Y X"], region: Int32[np.ndarray, "Y X"], reach: int, step: float
) -> Float32[np.ndarray, "R"]:
    """Of the rim of every region (ids from 0) that faces another region across a step, the share that looks down.

    1 for the top of a body, 0 for the floor of a pit, about one half for a terrace. Rims without a step do not count.
    """
    from excavatwin.kernels.morphology import step_across

    n = int(region.max(initial=-1)) + 1
    across = step_across(H, region, reach)
    with np.errstate(invalid="ignore"):
        up, down = across > step, across < -step
    ups, downs = np.bincount(region[up], minlength=n), np.bincount(region[down], minlength=n)
    return (ups / np.maximum(ups + downs, 1)).astype(np.float32)


def bridge_gaps(H: Float32[np.ndarray, "Y X"], gap: float) -> Float32[np.ndarray, "Y X"]:
    """``H`` with empty cells at most ``gap`` cells away from an observed one filled from the nearest."""
    from scipy.ndimage import distance_transform_edt

    empty = ~np.isfinite(H)
    if gap <= 0 or empty.all():
        return H
    distance, nearest = distance_transform_edt(empty, return_indices=True)
    return np.where(distance <= gap, H[tuple(nearest)], np.nan).astype(np.float32)


def fill_ground(
    H: Float32[np.ndarray, "Y X"], terrain: Bool[np.ndarray, "Y X"], smear: int = 0
) -> Float32[np.ndarray, "Y X"]:
    """The terrain surface carried on below objects and over gaps: nearest terrain cell, then relaxed to a membrane.

    Terrain within ``smear`` cells of a body may be the smeared foot of its side; it keeps its own height, but is not
    carried on below the body.
    """
    from scipy.ndimage import binary_dilation, distance_transform_edt, uniform_filter

    if not terrain.any():
        level = np.nanmedian(H) if np.isfinite(H).any() else 0.0
        return np.full(H.shape, level, np.float32)
    source = terrain
    if smear > 0:
        bodies = np.isfinite(H) & ~terrain
        source = terrain & ~binary_dilation(bodies, np.ones((3, 3)), iterations=smear)
        source = source if source.any() else terrain
    nearest = distance_transform_edt(~source, return_distances=False, return_indices=True)
    filled = H[tuple(nearest)].astype(np.float32)
    for size in (15, 9, 5, 3, 3, 3):
        filled = np.where(source, H, uniform_filter(filled, size, mode="nearest")).astype(np.float32)
    return np.where(terrain, H, filled).astype(np.float32)
