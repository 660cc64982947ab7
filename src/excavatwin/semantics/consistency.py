"""Spatial consistency: noise clusters dropped, gaps filled by foreground-background competition, terrain agreeing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32, Int64

from excavatwin.accumulation import accumulate
from excavatwin.errors import require
from excavatwin.scene.support import Terrain
from excavatwin.scene.taxonomy import TERRAIN_CLASSES, K
from excavatwin.scene.voxels import Voxels
from excavatwin.semantics.agreement import agreed
from excavatwin.topology import radius_clusters


@dataclass(frozen=True)
class Consistency:
    """Noise clusters dropped, gaps filled by foreground-background competition, terrain brought to agree.

    Background anchors (docs/decisions/background-anchors.md): for a class, the anchors of every other class; and the
    candidate's own support where it speaks against the class, at distance zero: terrain-supported candidates take
    terrain classes only, the others object and cover classes only.
    """

    e_label: float = 0.20
    """Least evidence with which a view sample counts as labelled."""
    epsilon: float = 2.0
    """Linkage distance of the clusters [voxels]."""
    min_cluster: int = 3
    """Smallest cluster that is not noise [voxels]."""
    reach: float = 25.0
    """Distance at which an anchor lends half of its evidence [voxels]. Terrain goes on beyond it, and so does what is
    lent; a body does not, and no anchor farther than this lends a class to it."""
    decay: float = 0.8
    """Share of the anchor's evidence that a candidate receives next to it."""
    agreement: float = 0.8
    """Share of a terrain voxel's evidence that is what its neighbourhood and its colour let expect; without photos
    there is no colour, and this step does nothing (docs/decisions/agreement.md)."""
    radius: float = 40.0
    """Standard deviation of that neighbourhood [voxels]."""
    ridge: float = 0.0005
    """Variance of colour, of 0..1, below which colour explains little."""

    def __post_init__(self) -> None:
        require(self, "epsilon", 0.0, open_low=True)
        require(self, "reach", 0.0, open_low=True)
        require(self, "decay", 0.0, 1.0)
        require(self, "agreement", 0.0, 1.0)
        require(self, "radius", 0.0, open_low=True)
        require(self, "ridge", 0.0, open_low=True)

    def __call__(
        self, voxels: Voxels, evidence: Float32[np.ndarray, "M K"], terrain: Terrain
    ) -> Float32[np.ndarray, "M K"]:
        """Filtered and completed evidence of the view samples."""
        evidence = self.without_noise(voxels, evidence)
        evidence = self.propagated(voxels, evidence, terrain)
        return self.agreeing(voxels, evidence, terrain)

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
        e, _ = accumulate(voxels, evidence)
        compatible = plausible(terrain.member)
        anchor = sample_labels(e * compatible, self.e_label)
        added = np.zeros_like(e)
        for on_terrain, reach in ((True, np.inf), (False, self.reach * voxels.size)):
            here = terrain.member == on_terrain
            candidate, anchors = np.flatnonzero(here & (anchor == 0)), np.flatnonzero(here & (anchor > 0))
            if len(candidate) == 0 or len(anchors) == 0:
                continue
            distance, lender = nearest_anchors(voxels.centre, candidate, anchors, anchor[anchors], reach)
            winner = compete(distance)
            rows, column = np.flatnonzero(winner > 0), winner[winner > 0] - 1
            near = 1 / (1 + (distance[rows, column] / (self.reach * voxels.size)) ** 2)
            added[candidate[rows], column] = self.decay * near * e[lender[rows, column], column]
        return evidence + added[voxels.voxel]

    def agreeing(
        self, voxels: Voxels, evidence: Float32[np.ndarray, "M K"], terrain: Terrain
    ) -> Float32[np.ndarray, "M K"]:
        """Evidence of the terrain drawn towards what its neighbourhood agrees on."""
        rows = np.flatnonzero(terrain.member)
        if self.agreement == 0 or not evidence.any() or (voxels.rgb[rows] == voxels.rgb[rows[:1]]).all():
            return evidence  # nothing to agree on, or no colour to be guided by
        e, _ = accumulate(voxels, evidence)
        expected = np.zeros_like(e)
        expected[rows] = agreed(
            voxels.centre[rows, :2], voxels.rgb[rows], e[rows], self.radius * voxels.size, self.ridge
        )
        spoke = terrain.member[voxels.voxel] & evidence.any(axis=1)
        drawn = evidence.copy()
        share = np.float32(self.agreement)
        drawn[spoke] = (1 - share) * evidence[spoke] + share * expected[voxels.voxel[spoke]]
        return drawn


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


def plausible(on_terrain: Bool[np.ndarray, "n"]) -> Bool[np.ndarray, "n K"]:
    """Classes that a place's own support does not speak against: terrain classes on terrain, the others off it."""
    terrain_class = np.isin(np.arange(1, K + 1), TERRAIN_CLASSES)
    return on_terrain[:, None] == terrain_class[None, :]


def nearest_anchors(
    xyz: Float32[np.ndarray, "J 3"],
    candidate: Int64[np.ndarray, "n"],
    anchors: Int64[np.ndarray, "a"],
    of_class: Int32[np.ndarray, "a"],
    reach: float,
) -> tuple[Float64[np.ndarray, "n K"], Int64[np.ndarray, "n K"]]:
    """Distance of every candidate to the nearest anchor of every class within ``reach``, and which anchor it is; inf
    where there is none."""
    from scipy.spatial import cKDTree

    distance = np.full((len(candidate), K), np.inf)
    lender = np.zeros((len(candidate), K), np.int64)
    for k in np.unique(of_class):
        at = anchors[of_class == k]
        found, who = cKDTree(xyz[at]).query(xyz[candidate], distance_upper_bound=reach, workers=-1)
        distance[:, k - 1] = found
        lender[:, k - 1] = at[np.minimum(who, len(at) - 1)]
    return distance, lender


def compete(distance: Float64[np.ndarray, "n K"]) -> Int32[np.ndarray, "n"]:
    """Foreground-background competition: the class whose anchor is strictly nearer than every background anchor.

    Args:
        distance: of every candidate to the nearest anchor of every class; inf = none in reach.

    Returns:
        Class 1..K, 0 where there is none.
    """
    ordered = np.sort(distance, axis=1)
    wins = np.isfinite(ordered[:, 0]) & (ordered[:, 0] < ordered[:, 1])
    return np.where(wins, distance.argmin(axis=1) + 1, 0).astype(np.int32)
