"""Two maps on one grid: A's, carried on by whole cells until it holds B as well.

Nothing is invented: a height of B between its cell centres is bilinear, and unknown where one of the cells that count
has none; a class is that of the cell of B in which the position lies.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from excavatwin.errors import InputError
from excavatwin.evaluation.comparison_frame import Placement
from excavatwin.evaluation.comparison_site import ComparedSite
from excavatwin.evaluation.frame import bilinear
from excavatwin.scene.elevation_map import ElevationMap
from excavatwin.scene.grid import Grid
from excavatwin.scene.taxonomy import NOT_OBSERVED

BLOCK = 1_000_000
"""Cells that are looked up at once, so that a large map needs little more memory than its layers."""
SNAP = 1e-4
"""A position nearer to a cell centre than this share of a cell lies on it: coordinates of 1e6 m carry rounding."""
MAX_CELLS = 60_000_000
"""Largest common grid; beyond it the maps do not belong together."""
ROUNDS, CLOSE = 30, 0.01
"""Rounds of the search for the cell that a turned surface brings to a position, and how near it must come [cells]."""


@dataclass(frozen=True, eq=False)
class Layers:
    """One of the two maps on the common grid."""

    elevation: Float32[np.ndarray, "Y X"]
    """Terrain height in A's frame [A's unit]; NaN where there is none."""
    label: UInt8[np.ndarray, "Y X"]
    """Task class; 255 where nothing is observed, and outside the map."""
    terrain: Bool[np.ndarray, "Y X"]
    """Where the map's own cell has a height: the rim of a gap has one here though nothing is interpolated there."""

    @property
    def observed(self) -> Bool[np.ndarray, "Y X"]:
        """Where the map has something."""
        return self.label != NOT_OBSERVED


def common_grid(a: ComparedSite, b: ComparedSite, placement: Placement) -> tuple[Grid, tuple[slice, slice]]:
    """A's grid carried on over B, and the rows and columns of it that are A's own.

    Raises:
        InputError: the two maps lie apart, or so wide around each other that no grid holds both.
    """
    g, west, east, south, north = a.map.grid, *_extent(b.map.grid, placement)
    if not np.isfinite([west, east, south, north]).all():
        raise InputError(f"{b.folder} cannot be brought into the CRS of {a.folder}; reproject one of them.")
    apart = west >= g.west + g.cols * g.cell or east <= g.west or south >= g.north or north <= g.north - g.rows * g.cell
    if apart:
        raise InputError(
            f"{a.folder} and {b.folder} do not overlap: their middles lie "
            f"{_distance(g, west, east, south, north):.4g} {a.map.unit} apart; give two maps of one site."
        )
    hair = 1e-6  # cells: the same edge, written by two runs, is no further cell
    left, right = _beyond((g.west - west) / g.cell, hair), _beyond((east - g.west) / g.cell - g.cols, hair)
    up, down = _beyond((north - g.north) / g.cell, hair), _beyond((g.north - south) / g.cell - g.rows, hair)
    rows, cols = g.rows + up + down, g.cols + left + right
    if rows * cols > MAX_CELLS:
        raise InputError(f"A grid over both maps would have {rows} x {cols} cells; give two maps of one site.")
    grid = Grid(g.west - left * g.cell, g.north + up * g.cell, g.cell, rows, cols)
    return grid, (slice(up, up + g.rows), slice(left, left + g.cols))


def _beyond(cells: float, hair: float) -> int:
    return max(0, int(np.ceil(cells - hair)))


def _extent(grid: Grid, placement: Placement) -> tuple[float, float, float, float]:
    """West, east, south, north of B in A's frame; along its edges, which a reprojection bends."""
    share = np.linspace(0, 1, 11)
    x, y = grid.west + grid.cols * grid.cell * share, grid.north - grid.rows * grid.cell * share
    edges_x = np.concatenate([x, x, np.full(11, x[0]), np.full(11, x[-1])])
    edges_y = np.concatenate([np.full(11, y[0]), np.full(11, y[-1]), y, y])
    u, v = placement.to_a(edges_x, edges_y)
    return float(u.min()), float(u.max()), float(v.min()), float(v.max())


def _distance(g: Grid, west: float, east: float, south: float, north: float) -> float:
    x, y = g.west + g.cols * g.cell / 2, g.north - g.rows * g.cell / 2
    return float(np.hypot((west + east) / 2 - x, (south + north) / 2 - y))


def layers_of_a(m: ElevationMap, grid: Grid, own: tuple[slice, slice]) -> Layers:
    """Map A on the common grid: its own cells, and nothing around them."""
    elevation, label = np.full(grid.shape, np.nan, np.float32), np.full(grid.shape, NOT_OBSERVED, np.uint8)
    elevation[own], label[own] = m.elevation, _labels(m)
    return Layers(elevation, label, np.isfinite(elevation))


def layers_of_b(m: ElevationMap, grid: Grid, placement: Placement) -> Layers:
    """Map B looked up at the centres of the common grid's cells."""
    elevation, label = np.full(grid.shape, np.nan, np.float32), np.full(grid.shape, NOT_OBSERVED, np.uint8)
    terrain = np.zeros(grid.shape, bool)
    known, labels = np.isfinite(m.elevation).ravel(), _labels(m).ravel()
    for rows, x, y in blocks(grid):
        u, v = cells(m.grid, *placement.to_b(x, y))
        elevation[rows] = placement.height(between(m, u, v))
        col, row = np.floor(u + 0.5).astype(np.int64), np.floor(v + 0.5).astype(np.int64)
        inside = (col >= 0) & (col < m.grid.cols) & (row >= 0) & (row < m.grid.rows)
        at = np.where(inside, row * m.grid.cols + col, 0)
        label[rows] = np.where(inside, labels[at], NOT_OBSERVED)
        terrain[rows] = inside & known[at]
    return Layers(elevation, label, terrain)


def _labels(m: ElevationMap) -> UInt8[np.ndarray, "Y X"]:
    return np.where(m.observed.astype(bool), m.label, NOT_OBSERVED).astype(np.uint8)


def blocks(grid: Grid) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
    """Rows of a grid, a million cells at a time, with x and y of their cell centres, each (rows, X)."""
    step = max(1, BLOCK // grid.cols)
    for first in range(0, grid.rows, step):
        rows = slice(first, min(first + step, grid.rows))
        yield rows, *np.meshgrid(grid.x, grid.y[rows])


def cells(grid: Grid, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Column and row of positions, counted from cell centres; on a centre or an edge where that is a hair away."""
    halves = 2 * (np.asarray(x) - grid.west) / grid.cell - 1, 2 * (grid.north - np.asarray(y)) / grid.cell - 1
    u, v = (0.5 * np.where(np.abs(h - np.round(h)) < 2 * SNAP, np.round(h), h) for h in halves)
    return u, v


def between(m: ElevationMap, u: np.ndarray, v: np.ndarray) -> Float64[np.ndarray, "*n"]:
    """Bilinear heights of a map at columns and rows counted from its cell centres; NaN where one that counts is."""
    index = Grid(-0.5, 0.5, 1.0, m.grid.rows, m.grid.cols)  # x is the column, y is minus the row: no rounding
    return bilinear(index, m.elevation, u, -v)


def heights_by_similarity(
    m: ElevationMap, grid: Grid, similarity: tuple[float, Float64[np.ndarray, "3 3"], Float64[np.ndarray, "3"]]
) -> Float32[np.ndarray, "Y X"]:
    """Heights of B's surface after a similarity in space, at the cells of A; NaN where none is found.

    Where a turned surface crosses a vertical is searched step by step: the height found moves the place that it is
    looked up at. Walls on which that does not settle stay unknown.
    """
    s, R, t = similarity
    heights = np.full(grid.shape, np.nan, np.float32)
    middle = float(np.nanmedian(m.elevation)) if np.isfinite(m.elevation).any() else 0.0
    for rows, x, y in blocks(grid):
        # The height that a horizontal plane through B's middle height would have here.
        z = t[2] + (s * middle - (x - t[0]) * R[0, 2] - (y - t[1]) * R[1, 2]) / R[2, 2]
        found, near = np.full(x.shape, np.nan), np.zeros(x.shape, bool)
        last = np.full((2, *x.shape), np.inf)
        for _ in range(ROUNDS):
            p = np.stack([x - t[0], y - t[1], z - t[2]], axis=-1) @ R / s
            u, v = cells(m.grid, p[..., 0], p[..., 1])
            level = between(m, u, v)
            near = np.hypot(u - last[0], v - last[1]) < CLOSE
            last = np.stack([u, v])
            found = z + s * (level - p[..., 2]) / R[2, 2]  # along A's vertical to B's level
            z = np.where(np.isfinite(found), found, z)
            if (near | ~np.isfinite(level)).all():
                break
        heights[rows] = np.where(near, found, np.nan)
    return heights
