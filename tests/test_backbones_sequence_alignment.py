"""Similarities as a group, their robust measurement, and the graph that spreads drift."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from emulated_network import random_similarity
from excavatwin.backbones.sequence.alignment import Pairs, align, joined
from excavatwin.backbones.sequence.chunking import Chunking, owners
from excavatwin.backbones.sequence.pose_graph import Edge, chained, cost, optimised
from excavatwin.backbones.sequence.similarities import exp, inverse, log, moved_pose, scale_of, similarity
from excavatwin.errors import InputError

SEEDS = st.integers(0, 100_000)
FAST = settings(deadline=None, max_examples=40)


def tangent(rng: np.random.Generator, size: float = 1.0) -> np.ndarray:
    return size * np.concatenate([rng.normal(size=3), rng.uniform(-1.7, 1.7, 3), rng.normal(size=1)])


@FAST
@given(seed=SEEDS, size=st.sampled_from([1.0, 1e-3, 1e-9, 0.0]))
def test_exp_is_the_matrix_exponential(seed: int, size: float) -> None:
    xi = tangent(np.random.default_rng(seed), size)
    v, w, scale = xi[:3], xi[3:6], xi[6]
    algebra = np.zeros((4, 4))
    algebra[:3, :3] = [[scale, -w[2], w[1]], [w[2], scale, -w[0]], [-w[1], w[0], scale]]
    algebra[:3, 3] = v
    np.testing.assert_allclose(exp(xi), expm(algebra), atol=1e-12, rtol=1e-12)


@FAST
@given(seed=SEEDS, size=st.sampled_from([1.0, 1e-4]))
def test_log_undoes_exp(seed: int, size: float) -> None:
    xi = tangent(np.random.default_rng(seed), size)
    np.testing.assert_allclose(log(exp(xi)), xi, atol=1e-10 * size)


@FAST
@given(seed=SEEDS)
def test_inverse_and_poses(seed: int) -> None:
    rng = np.random.default_rng(seed)
    S = random_similarity(rng)
    np.testing.assert_allclose(S @ inverse(S), np.eye(4), atol=1e-9)
    T = similarity(1.0, random_similarity(rng)[:3, :3], rng.normal(size=3))
    T[:3, :3] /= scale_of(T)
    moved = moved_pose(S, T)
    np.testing.assert_allclose(moved[:3, :3] @ moved[:3, :3].T, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(moved[:3, 3], (S @ T)[:3, 3])


def pairs(rng: np.random.Generator, S: np.ndarray, n: int = 600) -> Pairs:
    """Ground seen from some 20 m."""
    b = rng.normal(size=(n, 3)) * (10, 8, 1)
    a = b @ S[:3, :3].T + S[:3, 3]
    return Pairs(a, b, np.full(n, 20 * scale_of(S)) * rng.uniform(0.8, 1.2, n), rng.uniform(0.1, 1, n))


@settings(deadline=None, max_examples=15)
@given(seed=SEEDS, share=st.sampled_from([0.0, 0.3, 0.45]))
def test_alignment_recovers_what_made_it_among_outliers(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    S = random_similarity(rng)
    made = pairs(rng, S)
    wrong = rng.random(len(made.a)) < share
    a = np.where(wrong[:, None], made.a + made.distance[:, None] * rng.normal(0, 0.7, made.a.shape), made.a)
    found = align(Pairs(a, made.b, made.distance, made.weight), joined([]), 0.05)
    assert found is not None
    assert made.residual(found.S_a_b).max() < 1e-4
    assert abs(found.agreeing - (1 - share)) < 0.12


def test_noise_averages_out() -> None:
    rng = np.random.default_rng(0)
    S = random_similarity(rng)
    made = pairs(rng, S)
    noisy = Pairs(made.a + 0.01 * made.distance[:, None] * rng.normal(size=made.a.shape), *fields(made)[1:])
    found = align(noisy, joined([]), 0.05)
    assert found is not None
    assert np.median(made.residual(found.S_a_b)) < 0.002
    assert found.miss == pytest.approx(0.01 * 1.538, rel=0.15)  # median length of a Gaussian in three dimensions


def fields(made: Pairs) -> tuple[np.ndarray, ...]:
    return made.a, made.b, made.distance, made.weight


def test_the_surer_pairs_decide() -> None:
    """Two similarities compete; the one with the greater weight wins although it has fewer pairs."""
    rng = np.random.default_rng(3)
    S, other = random_similarity(rng), random_similarity(rng)
    made = pairs(rng, S)
    first = np.arange(len(made.a)) < 240
    a = np.where(first[:, None], made.a, made.b @ other[:3, :3].T + other[:3, 3])
    found = align(Pairs(a, made.b, made.distance, np.where(first, 1.0, 0.1)), joined([]), 0.05)
    assert found is not None
    np.testing.assert_allclose(found.S_a_b, S, rtol=1e-6, atol=1e-6 * np.abs(S).max())


def test_too_few_pairs_are_no_measurement() -> None:
    rng = np.random.default_rng(0)
    made = pairs(rng, np.eye(4), 10)
    assert align(made, joined([]), 0.05) is None


def graph(rng: np.random.Generator, count: int, noise: float) -> tuple[list[np.ndarray], list[Edge], Edge]:
    """Chunks on a circle in frames of their own, seams with errors, and an exact loop."""
    truth = []
    for k in range(count):
        turn = 2 * np.pi * k / count
        world = np.eye(4)
        world[:3, :3] = [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
        world[:3, 3] = 40 * np.cos(turn), 40 * np.sin(turn), 0
        truth.append(world @ random_similarity(rng) if k else np.eye(4))

    def edge(a: int, b: int, wrong: np.ndarray, miss: float) -> Edge:
        S_a_b = inverse(truth[a]) @ truth[b]
        middle = (inverse(truth[b]) @ np.append((truth[b] @ [0, 0, 0, 1])[:3] + 3, 1.0))[:3]
        reach = 10 / scale_of(truth[b])
        unit = similarity(reach, np.eye(3), middle)
        return Edge(a, b, S_a_b @ unit @ exp(wrong) @ inverse(unit), miss, middle, reach)

    seams = [edge(k, k + 1, noise * rng.normal(size=7), 0.01) for k in range(count - 1)]
    return truth, seams, edge(0, count - 1, np.zeros(7), 0.001)


def wrong_by(S: np.ndarray, truth: np.ndarray) -> float:
    """Root mean square error of what a chunk shows, 10 m around its origin [m]."""
    there = truth[:3, 3] + 10 * np.vstack([np.eye(3), -np.eye(3)])
    own = inverse(truth)
    seen = there @ own[:3, :3].T + own[:3, 3]
    return float(np.sqrt(((seen @ S[:3, :3].T + S[:3, 3] - there) ** 2).sum(1).mean()))


@settings(deadline=None, max_examples=6)
@given(seed=SEEDS)
def test_a_loop_takes_the_drift_out(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth, seams, loop = graph(rng, 9, 0.01)
    chain = chained(seams, 9)
    closed = optimised(chain, [*seams, loop])
    assert cost(closed, [*seams, loop]) < 0.2 * cost(chain, [*seams, loop])
    assert wrong_by(closed[-1], truth[-1]) < 0.35 * wrong_by(chain[-1], truth[-1])
    np.testing.assert_array_equal(closed[0], np.eye(4))


def test_exact_seams_stay_as_they_are() -> None:
    truth, seams, loop = graph(np.random.default_rng(1), 6, 0.0)
    chain = chained(seams, 6)
    closed = optimised(chain, [*seams, loop])
    for S, T in zip(closed, truth, strict=True):
        np.testing.assert_allclose(S, T, rtol=1e-7, atol=1e-7 * np.abs(T).max())


@settings(deadline=None, max_examples=4)
@given(seed=SEEDS)
def test_the_graph_does_not_care_for_the_frames_of_its_chunks(seed: int) -> None:
    """Moving one chunk's frame moves its answer by the same, and nothing else."""
    rng = np.random.default_rng(seed)
    _, seams, loop = graph(rng, 6, 0.02)
    G = random_similarity(rng)
    moved = [in_frame(edge, 3, G) for edge in [*seams, loop]]
    plain = optimised(chained(seams, 6), [*seams, loop])
    other = optimised(chained(moved[:-1], 6), moved)
    for k, (S, T) in enumerate(zip(plain, other, strict=True)):
        expected = S @ G if k == 3 else S
        np.testing.assert_allclose(T, expected, rtol=1e-3, atol=1e-3 * np.abs(expected).max())


def in_frame(edge: Edge, k: int, G: np.ndarray) -> Edge:
    """The edge after chunk k was given in another frame, p_old = G p_new."""
    a, b = edge.a == k, edge.b == k
    S = (inverse(G) if a else np.eye(4)) @ edge.S_a_b @ (G if b else np.eye(4))
    middle = (inverse(G) @ np.append(edge.middle, 1))[:3] if b else edge.middle
    return Edge(edge.a, edge.b, S, edge.miss, middle, edge.reach / scale_of(G) if b else edge.reach)


@settings(deadline=None, max_examples=200)
@given(count=st.integers(1, 300), size=st.integers(1, 80), shared=st.integers(1, 30))
def test_every_plan_covers_all_and_shares_enough(count: int, size: int, shared: int) -> None:
    chunking = Chunking(size=size, shared=shared)
    plan = chunking.plan(count, size)
    assert plan[0].start == 0
    assert plan[-1].stop == count
    assert len({len(chunk) for chunk in plan}) == 1
    assert len(plan[0]) <= max(size, 2)
    for before, after in pairwise(plan):
        assert before.start < after.start
        assert before.stop - after.start >= chunking.overlap(len(before))
    mine = owners(plan)
    assert [photo for part in mine for photo in part] == list(range(count))
    assert all(set(part) <= set(chunk) for part, chunk in zip(mine, plan, strict=True))


def test_nonsense_is_refused() -> None:
    with pytest.raises(InputError, match=r"Chunking\.shared"):
        Chunking(shared=0)
