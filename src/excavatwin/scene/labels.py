"""Semantic state: votes, geometric admissibility and the decision, per voxel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, UInt8


@dataclass(frozen=True)
class Labels:
    """The fused semantic state of every voxel."""

    vote: Float32[np.ndarray, "J K"]
    """v_j(k) (eq:vote)."""
    support: Float32[np.ndarray, "J K"]
    """g_j(k), geometric admissibility in [0, 1]."""
    score: Float32[np.ndarray, "J K"]
    """q_j(k) (eq:score); all zero where no class is admissible."""
    label: UInt8[np.ndarray, "J"]
    """k_hat_j (eq:semantic_decision), 0 = unknown."""
    confidence: Float32[np.ndarray, "J"]
    """gamma_j in [0, 1]."""
    reason: UInt8[np.ndarray, "J"]
    """Why a voxel is unknown."""
