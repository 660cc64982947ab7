"""gamma_i, how sure a label is (docs/decisions/unknown-and-votes.md)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from excavatwin.errors import require
from excavatwin.scene.labels import Labels
from excavatwin.scene.voxels import Voxels


@dataclass(frozen=True)
class Certainty:
    """The winning score, tempered by how many of the neighbours N_j have the same label: errors sit among others."""

    neighbours: float = 0.5
    """Exponent of the share of the neighbours with the same label; the score has the rest."""

    def __post_init__(self) -> None:
        require(self, "neighbours", 0.0, 1.0)

    def __call__(self, voxels: Voxels, labels: Labels) -> Labels:
        """The labels with gamma_i = q^(1 - a) share^a as their confidence, in [0, 1]."""
        alike = (labels.label[voxels.neighbours] == labels.label[:, None]).mean(axis=1)
        gamma = labels.confidence ** (1 - self.neighbours) * alike**self.neighbours
        return replace(labels, confidence=gamma.astype(np.float32))


@dataclass(frozen=True)
class KeepScore:
    """Identity twin: the winning score of eq:score is the confidence."""

    def __call__(self, voxels: Voxels, labels: Labels) -> Labels:
        """The labels as they are."""
        return labels
