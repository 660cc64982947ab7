"""The horizontal grid of the map: row 0 is the north edge, as in GeoTIFF."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64, Int32

#: Rounding that a position on the border of a grid may carry [cells].
HAIR = 1e-6


@dataclass(frozen=True)
class Grid:
    """Square cells in frame M."""

    west: float
    """x of the left edge of column 0 [m]."""
    north: float
    """y of the top edge of row 0 [m]."""
    cell: float
    """Edge length of a cell [m]."""
    rows: int
    cols: int

    @property
    def shape(self) -> tuple[int, int]:
        """(Y, X)."""
        return self.rows, self.cols

    @property
    def x(self) -> Float64[np.ndarray, "X"]:
        """Easting-like coordinate of the cell centres, ascending [m]."""
        return self.west + (np.arange(self.cols) + 0.5) * self.cell

    @property
    def y(self) -> Float64[np.ndarray, "Y"]:
        """Northing-like coordinate of the cell centres, descending [m]."""
        return self.north - (np.arange(self.rows) + 0.5) * self.cell

    def flat_index(self, xy: Float[np.ndarray, "n 2"]) -> Int32[np.ndarray, "n"]:
        """Row-major cell index of horizontal positions; -1 outside the grid. Its border, to a hair, is inside."""
        col = (np.asarray(xy[:, 0], float) - self.west) / self.cell
        row = (self.north - np.asarray(xy[:, 1], float)) / self.cell
        inside = (col >= -HAIR) & (col <= self.cols + HAIR) & (row >= -HAIR) & (row <= self.rows + HAIR)
        col, row = np.clip(np.floor(col), 0, self.cols - 1), np.clip(np.floor(row), 0, self.rows - 1)
        return np.where(inside, row * self.cols + col, -1).astype(np.int32)
