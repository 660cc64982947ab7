"""Fusions that everybody knows, as other parts in the mapper's places: they share points, voxels and raster with ours.

Each is another form of the vote; none has spatial consistency, reliability, object support or geometric admissibility,
and a voxel that no view said anything about stays unknown.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32

from excavatwin.accumulation import per_voxel
from excavatwin.errors import require
from excavatwin.geometry.objects import NoObjects
from excavatwin.mapper import Mapper
from excavatwin.mapping.instances import Instances
from excavatwin.scene.labels import Labels
from excavatwin.scene.support import LocalGeometry, Terrain
from excavatwin.scene.taxonomy import K, Reason
from excavatwin.scene.voxels import Voxels
from excavatwin.semantics.admissibility import AdmitAll
from excavatwin.semantics.certainty import KeepScore
from excavatwin.semantics.consistency import KeepEvidence
from excavatwin.semantics.decision import Decision
from excavatwin.semantics.reliability import Uniform
from excavatwin.semantics.vote import Vote


@dataclass(frozen=True)
class PlainVote(Vote):
    """Plain 3D voting: the sum of what the views say, normalised."""

    def __call__(
        self, voxels: Voxels, evidence: Float32[np.ndarray, "M K"], weight: Float32[np.ndarray, "M"]
    ) -> Float32[np.ndarray, "J K"]:
        """Shares of the votes; all zero where nobody voted."""
        return normalised(per_voxel(voxels, evidence))


@dataclass(frozen=True)
class BestView(Vote):
    """Best single view: the most certain view of a voxel decides alone; of equally certain ones the first."""

    def __call__(
        self, voxels: Voxels, evidence: Float32[np.ndarray, "M K"], weight: Float32[np.ndarray, "M"]
    ) -> Float32[np.ndarray, "J K"]:
        """Shares of that view's evidence; all zero where no view has any."""
        order = np.lexsort((np.arange(len(evidence)), -evidence.max(axis=1), voxels.voxel))
        first = np.unique(voxels.voxel[order], return_index=True)[1]
        v = np.zeros((len(voxels), K))
        v[voxels.voxel[order[first]]] = evidence[order[first]]
        return normalised(v)


@dataclass(frozen=True)
class RecursiveBayes(Vote):
    """SemanticFusion (McCormac et al., 2017): the product of the views' class distributions, renormalised."""

    least: float = 0.01
    """Probability that a view leaves to every class: a single zero must not veto all other views."""

    def __post_init__(self) -> None:
        require(self, "least", 0.0, 1.0 / K, open_low=True)

    def __call__(
        self, voxels: Voxels, evidence: Float32[np.ndarray, "M K"], weight: Float32[np.ndarray, "M"]
    ) -> Float32[np.ndarray, "J K"]:
        """Posterior under a flat prior; all zero where nobody voted."""
        p = self.least + (1 - K * self.least) * normalised(evidence)
        spoke = np.any(evidence, axis=1)
        return posterior(per_voxel(voxels, np.where(spoke[:, None], np.log(p), 0.0)), heard(voxels, spoke))


@dataclass(frozen=True)
class FixedLikelihood(Vote):
    """Kimera-Semantics (Rosinol et al., 2020): a view's label is right with a fixed probability, wrong ones alike."""

    hit: float = 0.9
    """Probability that a view's label is the true one."""

    def __post_init__(self) -> None:
        require(self, "hit", 1.0 / K, 1.0 - 1e-6, open_low=True)

    def __call__(
        self, voxels: Voxels, evidence: Float32[np.ndarray, "M K"], weight: Float32[np.ndarray, "M"]
    ) -> Float32[np.ndarray, "J K"]:
        """Posterior under a flat prior; all zero where nobody voted."""
        spoke = np.any(evidence, axis=1)
        label = np.zeros_like(evidence, dtype=np.float64)
        label[np.arange(len(label)), evidence.argmax(axis=1)] = np.log(self.hit) - np.log((1 - self.hit) / (K - 1))
        return posterior(per_voxel(voxels, label * spoke[:, None]), heard(voxels, spoke))


@dataclass(frozen=True)
class DirichletCounts(Vote):
    """MEM (Erni et al., 2023): class probabilities are counted into a Dirichlet distribution; its mean decides."""

    prior: float = 0.2
    """Pseudo-count of every class."""

    def __post_init__(self) -> None:
        require(self, "prior", 0.0, open_low=True)

    def __call__(
        self, voxels: Voxels, evidence: Float32[np.ndarray, "M K"], weight: Float32[np.ndarray, "M"]
    ) -> Float32[np.ndarray, "J K"]:
        """Mean of the Dirichlet distribution; all zero where nobody voted."""
        alpha = self.prior + per_voxel(voxels, evidence)
        return (normalised(alpha) * heard(voxels, np.any(evidence, axis=1))[:, None]).astype(np.float32)


@dataclass(frozen=True)
class MostVoted(Decision):
    """The class with most votes, whatever its share; unknown where nobody voted."""

    def __call__(self, v: Float32[np.ndarray, "J K"], g: Float32[np.ndarray, "J K"]) -> Labels:
        """Label, confidence and reason of every voxel."""
        best = v.max(axis=1)
        label = np.where(best > 0, v.argmax(axis=1) + 1, 0).astype(np.uint8)
        reason = np.where(best > 0, Reason.CLASSIFIED, Reason.INSUFFICIENT).astype(np.uint8)
        return Labels(v, g, v, label, best, reason)


@dataclass(frozen=True)
class KeepLabels(Instances):
    """Bodies are formed but lend their class to nothing."""

    def __call__(
        self, voxels: Voxels, local: LocalGeometry, labels: Labels, terrain: Terrain, metric: bool
    ) -> tuple[Int32[np.ndarray, "J"], Labels]:
        """(object of every voxel, the labels as they are)."""
        instance, _ = super().__call__(voxels, local, labels, terrain, metric)
        return instance, labels


def baseline(vote: Vote) -> Mapper:
    """The mapper with a baseline's vote and without everything that the method adds to voting."""
    return replace(
        Mapper(), consistency=KeepEvidence(), objects=NoObjects(), reliability=Uniform(), vote=vote,
        admissibility=AdmitAll(), decision=MostVoted(), certainty=KeepScore(), instances=KeepLabels(),
    )  # fmt: skip


def baselines() -> dict[str, Mapper]:
    """The fusions that everybody knows, by name."""
    return {
        "best single view": baseline(BestView()),
        "plain 3D voting": baseline(PlainVote()),
        "recursive Bayes (SemanticFusion)": baseline(RecursiveBayes()),
        "fixed likelihood 0.9 (Kimera)": baseline(FixedLikelihood()),
        "Dirichlet counts (MEM)": baseline(DirichletCounts()),
    }


def normalised(v: np.ndarray) -> Float32[np.ndarray, "n K"]:
    """Rows that sum to 1; rows of zeros stay."""
    total = v.sum(axis=1, keepdims=True)
    return np.divide(v, total, out=np.zeros(v.shape), where=total > 0).astype(np.float32)


def heard(voxels: Voxels, spoke: Bool[np.ndarray, "M"]) -> Bool[np.ndarray, "J"]:
    """Voxels about which at least one view said something."""
    return np.bincount(voxels.voxel[spoke], minlength=len(voxels)) > 0


def posterior(logarithm: Float64[np.ndarray, "J K"], known: Bool[np.ndarray, "J"]) -> Float32[np.ndarray, "J K"]:
    """Normalised exponentials of the rows; zero where nothing is known."""
    p = np.exp(logarithm - logarithm.max(axis=1, keepdims=True))
    return np.where(known[:, None], normalised(p), 0).astype(np.float32)
