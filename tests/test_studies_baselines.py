"""The fusions that everybody knows, against transcriptions of their papers voxel by voxel."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from excavatwin.errors import InputError
from excavatwin.scene.taxonomy import K, Reason
from excavatwin.semantics.vote import Vote
from excavatwin.studies.baselines import (
    BestView,
    DirichletCounts,
    FixedLikelihood,
    MostVoted,
    PlainVote,
    RecursiveBayes,
    baselines,
)
from hand_built import voxels_at

S, J = 4, 9


def plain(samples: np.ndarray) -> np.ndarray:
    total = np.zeros(K)
    for sample in samples:
        total = total + sample
    return total / total.sum()


def best(samples: np.ndarray) -> np.ndarray:
    chosen = samples[0]
    for sample in samples[1:]:
        if sample.max() > chosen.max():
            chosen = sample
    return chosen / chosen.sum()


def bayes(samples: np.ndarray) -> np.ndarray:
    p = np.full(K, 1 / K)
    for sample in samples:
        if sample.any():
            p = p * (0.01 + (1 - 0.01 * K) * sample / sample.sum())
            p = p / p.sum()
    return p


def kimera(samples: np.ndarray) -> np.ndarray:
    p = np.full(K, 1 / K)
    for sample in samples:
        if sample.any():
            likelihood = np.full(K, 0.1 / (K - 1))
            likelihood[sample.argmax()] = 0.9
            p = p * likelihood
            p = p / p.sum()
    return p


def dirichlet(samples: np.ndarray) -> np.ndarray:
    alpha = np.full(K, DirichletCounts().prior)
    for sample in samples:
        alpha = alpha + sample
    return alpha / alpha.sum()


VOTES = [
    (PlainVote(), plain), (BestView(), best), (RecursiveBayes(), bayes), (FixedLikelihood(), kimera),
    (DirichletCounts(), dirichlet),
]  # fmt: skip


@pytest.mark.parametrize(("vote", "naive"), VOTES, ids=lambda v: getattr(v, "__name__", type(v).__name__))
@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 10**6))
def test_a_vote_is_what_its_paper_says(vote: Vote, naive: Callable[[np.ndarray], np.ndarray], seed: int) -> None:
    rng = np.random.default_rng(seed)
    evidence = (rng.random((S, J, K)) * (rng.random((S, J, 1)) < 0.7)).astype(np.float32)
    voxels = voxels_at(rng.random((J, 3)), 0.1, S, evidence.reshape(-1, K))
    v = vote(voxels, voxels.evidence, rng.random(S * J).astype(np.float32))
    for j in range(J):
        samples = evidence[:, j].astype(float)
        expected = naive(samples) if samples.any() else np.zeros(K)
        np.testing.assert_allclose(v[j], expected, atol=2e-5)


def test_the_class_with_most_votes_wins_and_silence_is_unknown() -> None:
    v = np.zeros((3, K), np.float32)
    v[0, 3], v[1] = 0.21, [0.19, 0.2, 0.21, 0.2, 0.2]
    labels = MostVoted()(v, np.ones_like(v))
    assert labels.label.tolist() == [4, 3, 0]
    assert labels.reason.tolist() == [Reason.CLASSIFIED, Reason.CLASSIFIED, Reason.INSUFFICIENT]


@pytest.mark.parametrize(
    "wrong", [lambda: RecursiveBayes(least=0.0), lambda: FixedLikelihood(hit=1.0), lambda: DirichletCounts(prior=0.0)]
)
def test_parameters_that_make_no_probability_are_refused(wrong: Callable[[], Vote]) -> None:
    with pytest.raises(InputError):
        wrong()


def test_baselines_differ_only_in_their_vote() -> None:
    plain_one = baselines()["plain 3D voting"]
    for name, mapper in baselines().items():
        different = [f for f in vars(mapper) if getattr(mapper, f) != getattr(plain_one, f)]
        assert different == ([] if name == "plain 3D voting" else ["vote"])
