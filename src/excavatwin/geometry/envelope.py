"""Raster steps of the terrain envelope: progressive filter, boundaries of regions, ground under objects."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32

from excavatwin.paper import equation
from excavatwin.scene.grid import Grid


def progressive_filter(
    H: Float32[np.ndarray, "Y X"], cell: float, window: float, step: float, aspect: float
) -> Bool[np.ndarray, "Y X"]:
    """Cells of what stands on the ground, by openings with a window that grows step by step (after Zhang et al., 2003).

    The opening that is just wider than a body lowers it by its whole height at once, so a body is what falls by more
    than ``aspect`` times the half-width of the window (the threshold of Pingel et al., 2013, on a square window).
    A cone of the same inclination falls by little with every step, whatever its size: only the tip of a steep heap,
    a few cells wide, is taken along. Openings never touch what lies *below* its surroundings: pits and trenches stay.

    Args:
        H: reference elevation, NaN = none [m].
        cell: edge of a cell [m].
        window: width of the widest body that must be found [m].
        step: height that is noise [m].
        aspect: lowest height of a body over its half-width.
    """
    from excavatwin.kernels.morphology import opening

    raised = np.zeros(H.shape, bool)
    last = max(1, int(np.ceil(window / cell / 2)))
    surface, radius = H, 0
    while radius < last:
        radius = min(last, radius + max(1, radius // 6))  # large windows may grow faster: large bodies are high
        opened = opening(surface, radius)
        with np.errstate(invalid="ignore"):
            raised |= surface - opened > max(step, aspect * radius * cell)
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


def steep_rims(
    H: Float32[np.ndarray, "Y X"], blob: Int32[np.ndarray, "Y X"], reach: int, allowed: float
) -> Float32[np.ndarray, "R"]:
    """Share of every blob's rim (ids from 0, -1 = outside all) that drops by more than ``allowed`` within ``reach``
    cells outside all blobs. Stereo smears a sharp step over two or three cells, so neighbours alone do not tell.
    Rims at the edge of the map tell nothing and count as level."""
    from excavatwin.kernels.morphology import disc_drop, windowed_extreme

    n = int(blob.max(initial=-1)) + 1
    inside = np.pad(blob >= 0, 1).astype(np.float32)
    border = (blob >= 0) & (windowed_extreme(inside, 1, False)[1:-1, 1:-1] == 0)
    around = np.isfinite(H) & (blob < 0)
    rim = border & (windowed_extreme(around.astype(np.float32), 1, True) > 0)
    steep = rim & (disc_drop(H, around, reach) > allowed)
    return (np.bincount(blob[steep], minlength=n) / np.maximum(np.bincount(blob[border], minlength=n), 1)).astype(
        np.float32
    )


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


def ground_range(
    grid: Grid, ground: Float32[np.ndarray, "Y X"], xyz: Float[np.ndarray, "N 3"], reach: int
) -> tuple[Float32[np.ndarray, "N"], Float32[np.ndarray, "N"]]:
    """Lowest and highest ground within ``reach`` cells of every point, bilinear between the cells' centres [m]."""
    from scipy.ndimage import map_coordinates

    from excavatwin.kernels.morphology import windowed_extreme

    place = np.stack([(grid.north - xyz[:, 1]) / grid.cell - 0.5, (xyz[:, 0] - grid.west) / grid.cell - 0.5])
    low, high = (
        map_coordinates(windowed_extreme(ground, reach, highest), place, order=1, mode="nearest")
        for highest in (False, True)
    )
    return low, high


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
