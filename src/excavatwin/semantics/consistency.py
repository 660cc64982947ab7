"""Spatial consistency: noise clusters dropped, gaps filled by foreground-background competition."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int32

from excavatwin.accumulation import accumulate
from excavatwin.errors import require
from excavatwin.scene.support import Terrain
from excavatwin.scene.taxonomy import TERRAIN_CLASSES, K
from excavatwin.scene.voxels import Voxels
from excavatwin.topology import radius_clusters


@dataclass(frozen=True)
class Consistency:
    """Per-class single-linkage clusters give anchors; unlabelled voxels take the class of the anchor that wins.

    Background anchors (docs/decisions/background-anchors.md): for a class, the anchors of every other class; and the
    candidate's own support where it speaks against the class, at distance zero: terrain-supported candidates take
    terrain classes only, the others object and cover classes only.
    """

    e_label: float = 0.20
    """Least evidence with which a view sample counts as labelled."""
    epsilon: float = 2.0
    """Linkage distance of the clusters [voxels]."""
    min_cluster: int = 10
    """Smallest cluster that is not noise [voxels]."""
    reach: float = 25.0
    """Farthest anchor that may lend its class [voxels]."""
    decay: float = 0.8
    """Share of the anchor's evidence that a candidate receives next to it; falls linearly to zero at ``reach``."""

    def __post_init__(self) -> None:
        require(self, "epsilon", 0.0, open_low=True)
        require(self, "reach", 0.0, open_low=True)
        require(self, "decay", 0.0, 1.0)

    def __call__(
        self, voxels: Voxels, evidence: Float32[np.ndarray, "M K"], terrain: Terrain
    ) -> Float32[np.ndarray, "M K"]:
        """Filtered and completed evidence of the view samples."""
        evidence = self.without_noise(voxels, evidence)
        return self.propagated(voxels, evidence, terrain)

    def without_noise(self, voxels: Voxels, evidence: Float32[np.ndarray, "M K"]) -> Float32[np.ndarray, "M K"]:
        """Evidence of a class is struck out where its labelled samples form a cluster below the minimum size."""
        label = sample_labels(evidence, self.e_label)
        kept = evidence.copy()
        for k in range(1, K + 1):
            of_class = np.flatnonzero(label == k)
            if len(of_class) == 0:
                continue
            occupied, at = np.unique(voxels.voxel[of_class], return_inverse=True)
            cluster, size = radius_clusters(voxels.centre[occupied], self.epsilon * voxels.size)
            noise = size[cluster] < self.min_cluster
            kept[of_class[noise[at]], k - 1] = 0.0
        return kept

    def propagated(
        self, voxels: Voxels, evidence: Float32[np.ndarray, "M K"], terrain: Terrain
    ) -> Float32[np.ndarray, "M K"]:
        """Evidence with the gaps filled: a candidate receives the class whose anchor is nearer than any background."""
        from scipy.spatial import cKDTree

        e, _ = accumulate(voxels, evidence)
        anchor = sample_labels(e, self.e_label)
        candidate = np.flatnonzero(anchor == 0)
        if len(candidate) == 0 or len(candidate) == len(anchor):
            return evidence
        reach = self.reach * voxels.size
        distance = np.full((len(candidate), K), np.inf)
        lender = np.zeros((len(candidate), K), np.int64)
        for k in range(1, K + 1):
            at = np.flatnonzero(anchor == k)
            if len(at):
                tree = cKDTree(voxels.centre[at])
                d, who = tree.query(voxels.centre[candidate], distance_upper_bound=reach, workers=-1)
                distance[:, k - 1] = d
                lender[:, k - 1] = at[np.minimum(who, len(at) - 1)]
        winner = compete(distance, terrain.member[candidate])
        won = winner > 0
        rows, column = np.flatnonzero(won), winner[won] - 1
        lent = self.decay * (1 - distance[rows, column] / reach) * e[lender[rows, column], column]
        added = np.zeros_like(e)
        added[candidate[rows], column] = lent
        return evidence + added[voxels.voxel]


@dataclass(frozen=True)
class KeepEvidence:
    """Identity twin ("w/o Spatial consistency")."""

    def __call__(
        self, voxels: Voxels, evidence: Float32[np.ndarray, "M K"], terrain: Terrain
    ) -> Float32[np.ndarray, "M K"]:
        """The evidence as the segmenter gave it."""
        return evidence


def sample_labels(evidence: Float32[np.ndarray, "n K"], least: float) -> Int32[np.ndarray, "n"]:
    """Class of the strongest evidence, 0 where it is below ``least``."""
    best = evidence.argmax(axis=1)
    strong = evidence[np.arange(len(evidence)), best] >= least
    return np.where(strong, best + 1, 0).astype(np.int32)


def compete(distance: np.ndarray, on_terrain: np.ndarray) -> Int32[np.ndarray, "n"]:
    """Foreground-background competition.

    Args:
        distance: (n, K) distance of every candidate to the nearest anchor of every class; inf = none in reach.
        on_terrain: (n,) terrain support of the candidates.

    Returns:
        The class whose anchor is strictly nearer than every background anchor, 0 where none is.
    """
    terrain_class = np.isin(np.arange(1, K + 1), TERRAIN_CLASSES)
    compatible = on_terrain[:, None] == terrain_class[None, :]
    ordered = np.sort(distance, axis=1)
    best = distance.argmin(axis=1)
    rows = np.arange(len(distance))
    wins = np.isfinite(ordered[:, 0]) & (ordered[:, 0] < ordered[:, 1]) & compatible[rows, best]
    return np.where(wins, best + 1, 0).astype(np.int32)
