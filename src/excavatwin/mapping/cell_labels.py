"""Class, confidence and reason of every cell (eq:grid_semantics)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Float64, Int32, Integer, UInt8

from excavatwin.errors import require
from excavatwin.mapping.raster import Cells
from excavatwin.paper import equation
from excavatwin.scene.labels import Labels
from excavatwin.scene.taxonomy import NOT_OBSERVED, Reason
from excavatwin.scene.voxels import Voxels


@dataclass(frozen=True)
class CellLabels:
    """Confidence-weighted vote of the points of a cell; unknown votes too."""

    gamma_min: float = 0.1
    """Minimum voting weight."""

    def __post_init__(self) -> None:
        require(self, "gamma_min", 0.0, 1.0)

    def __call__(
        self, cells: Cells, voxels: Voxels, labels: Labels
    ) -> tuple[UInt8[np.ndarray, "Y X"], Float32[np.ndarray, "Y X"], UInt8[np.ndarray, "Y X"]]:
        """(L_c, share of the votes that L_c won, reason), 255 and UNOBSERVED where a cell has no point."""
        n_cells = cells.grid.rows * cells.grid.cols
        j = voxels.voxel
        votes = grid_votes(labels.label[j], labels.confidence[j], cells.of_sample, n_cells, self.gamma_min)
        total = votes.sum(axis=1)
        seen = total > 0
        label = np.where(seen, votes.argmax(axis=1), NOT_OBSERVED).astype(np.uint8)
        share = np.divide(votes.max(axis=1), total, out=np.zeros(n_cells), where=seen).astype(np.float32)
        reasons = grid_votes(labels.reason[j], labels.confidence[j], cells.of_sample, n_cells, self.gamma_min)
        reasons[:, Reason.CLASSIFIED] = 0.0
        reason = np.where(label > 0, Reason.CLASSIFIED, reasons.argmax(axis=1))
        reason = np.where(seen, reason, Reason.UNOBSERVED).astype(np.uint8)
        shape = cells.grid.shape
        return label.reshape(shape), share.reshape(shape), reason.reshape(shape)


@equation("eq:grid_semantics")
def grid_votes(
    label: Integer[np.ndarray, "n"],
    gamma: Float[np.ndarray, "n"],
    cell: Int32[np.ndarray, "n"],
    n_cells: int,
    gamma_min: float,
) -> Float64[np.ndarray, "cells K1"]:
    """sum over P_c of alpha_i [label_i = k], alpha_i = max(gamma_i, gamma_min), for k = 0 (unknown) .. K.

    L_c is the arg-max of a row. Points of cell -1 are left out.
    """
    from excavatwin.kernels.cells import weighted_votes
    from excavatwin.scene.taxonomy import K

    alpha = np.maximum(gamma, gamma_min).astype(np.float64)
    return weighted_votes(cell, label.astype(np.int64), alpha, n_cells, K + 1)
