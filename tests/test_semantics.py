"""Consistency, reliability, admissibility and decision."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from excavatwin.accumulation import accumulate, per_voxel
from excavatwin.scene.support import LocalGeometry, ObjectSupport, Terrain
from excavatwin.scene.taxonomy import Reason, TaskClass
from excavatwin.scene.voxels import Voxels
from excavatwin.semantics.admissibility import Admissibility, AdmitAll
from excavatwin.semantics.agreement import agreed
from excavatwin.semantics.certainty import Certainty, KeepScore
from excavatwin.semantics.consistency import Consistency, KeepEvidence, compete, plausible, sample_labels
from excavatwin.semantics.decision import Decision
from excavatwin.semantics.reliability import Reliability, Uniform, distinct_rank
from excavatwin.semantics.vote import Vote
from hand_built import flat_local, terrain_below, voxels_at

relaxed = settings(deadline=None, max_examples=25)
seeds = st.integers(0, 2**32 - 1)
CT, OT, RC, EX, OB = range(5)


# ---- accumulation


@relaxed
@given(seeds)
def test_views_that_say_nothing_do_not_dilute(seed: int) -> None:
    rng = np.random.default_rng(seed)
    S, J = 4, 5
    evidence = rng.random((S * J, 5)) * (rng.random((S * J, 1)) < 0.6)
    voxels = voxels_at(rng.random((J, 3)), 0.1, S, evidence)
    voxels = replace(voxels, confidence=rng.random(S * J).astype(np.float32))
    e, phi = accumulate(voxels, voxels.evidence)
    total = per_voxel(voxels, voxels.evidence)
    for j in range(J):
        own = [m for m in range(S * J) if voxels.voxel[m] == j]
        spoke = [voxels.evidence[m].astype(float) for m in own if voxels.evidence[m].any()]
        assert e[j] == pytest.approx(sum(spoke) / len(spoke) if spoke else np.zeros(5), rel=1e-5)
        assert phi[j] == pytest.approx(np.mean([voxels.confidence[m] for m in own]), rel=1e-5)
        assert total[j] == pytest.approx(np.sum(spoke, axis=0) if spoke else np.zeros(5), rel=1e-5)


# ---- consistency


def _line(J: int, evidence: np.ndarray, S: int = 1) -> Voxels:
    """J voxels in a row along x, one edge apart."""
    x = np.arange(J) * 0.1
    return voxels_at(np.column_stack([x, 0 * x, 0 * x]), 0.1, S, evidence)


def _on_terrain(voxels: Voxels, member: bool | np.ndarray) -> Terrain:
    return terrain_below(voxels, np.broadcast_to(np.asarray(member), (len(voxels),)).copy())


def _says(label: list[int], strength: float = 0.8) -> np.ndarray:
    """Evidence of ``strength`` for class label - 1; nothing for 0."""
    e = np.zeros((len(label), 5), np.float32)
    for i, k in enumerate(label):
        if k:
            e[i, k - 1] = strength
    return e


def test_small_clusters_are_noise() -> None:
    label = [1] * 12 + [0] * 5 + [1] * 9 + [0] * 5 + [2] * 10 + [4] * 3
    voxels = _line(len(label), _says(label))
    kept = Consistency(min_cluster=10).without_noise(voxels, voxels.evidence)
    assert sample_labels(kept, 0.2).tolist() == [1] * 12 + [0] * 19 + [2] * 10 + [0] * 3


def test_only_the_class_that_is_noise_is_struck_out() -> None:
    e = _says([1] * 20)
    e[5:8, EX], e[5:8, CT] = 0.9, 0.4
    voxels = _line(20, e)
    kept = Consistency(min_cluster=10).without_noise(voxels, voxels.evidence)
    assert (kept[5:8, EX] == 0).all()
    assert kept[5:8, CT] == pytest.approx(0.4)
    assert voxels.evidence[5:8, EX] == pytest.approx(0.9)  # the input is left alone


def test_clusters_are_of_voxels_not_of_view_samples() -> None:
    """Six voxels that two views label are six, not twelve; and views may take turns along a cluster."""
    label = [4] * 6
    twice = voxels_at(np.column_stack([np.arange(6) * 0.1, np.zeros(6), np.zeros(6)]), 0.1, 2, _says(label * 2))
    assert not Consistency(min_cluster=7).without_noise(twice, twice.evidence).any()
    turns = _says([4, 0] * 6 + [0, 4] * 6)
    voxels = _line(12, turns, S=2)
    assert (Consistency(min_cluster=12).without_noise(voxels, voxels.evidence) == voxels.evidence).all()


def test_weak_evidence_makes_no_label() -> None:
    e = np.array([[0.1, 0.19, 0, 0, 0], [0, 0.2, 0.1, 0, 0], [0, 0, 0, 0, 0.9], [0, 0, 0, 0, 0]], np.float32)
    assert sample_labels(e, 0.2).tolist() == [0, 2, 5, 0]


@pytest.mark.parametrize(("on_terrain", "k"), [(True, 1), (False, 1), (True, 4), (False, 4), (True, 3), (False, 3)])
def test_a_gap_is_filled_only_where_the_support_is_compatible(on_terrain: bool, k: int) -> None:
    label = [k] * 15 + [0] * 6 + [k] * 15
    voxels = _line(len(label), _says(label))
    filled = Consistency(agreement=0.0)(voxels, voxels.evidence, _on_terrain(voxels, on_terrain))
    gap = filled[15:21]
    if on_terrain == (k in (1, 2)):
        assert (sample_labels(gap, 1e-6) == k).all()
        d = np.array([1, 2, 3, 3, 2, 1])  # voxels to the nearest anchor
        assert gap[:, k - 1] == pytest.approx(0.8 / (1 + (d / 25) ** 2) * 0.8, rel=1e-4)
    else:
        assert not gap.any()
    assert (filled[:15] == voxels.evidence[:15]).all()


def test_a_gap_between_two_classes_goes_to_the_nearer_and_the_middle_to_none() -> None:
    label = [1] * 15 + [0] * 7 + [2] * 15
    voxels = _line(len(label), _says(label))
    filled = Consistency(agreement=0.0)(voxels, voxels.evidence, _on_terrain(voxels, True))
    middle = sample_labels(filled[15:22], 1e-6)
    assert middle[:3].tolist() == [1, 1, 1]
    assert middle[4:].tolist() == [2, 2, 2]


def test_nothing_is_lent_beyond_reach_off_the_terrain() -> None:
    label = [5] * 15 + [0] * 12
    voxels = _line(len(label), _says(label))
    filled = Consistency(reach=5.5, agreement=0.0)(voxels, voxels.evidence, _on_terrain(voxels, False))
    assert (sample_labels(filled[15:], 1e-6) > 0).tolist() == [True] * 5 + [False] * 7
    lent = filled[15:20, OB]
    assert (np.diff(lent) < 0).all()


def test_terrain_goes_on_beyond_reach() -> None:
    label = [1] * 15 + [0] * 300
    voxels = _line(len(label), _says(label))
    filled = Consistency(reach=5.5, agreement=0.0)(voxels, voxels.evidence, _on_terrain(voxels, True))
    lent = filled[15:, CT]
    assert (lent > 0).all()
    assert (np.diff(lent) < 0).all()


def test_all_or_nothing_labelled_stays_as_it_is() -> None:
    for label in ([0] * 12, [1] * 12):
        voxels = _line(12, _says(label))
        assert Consistency()(voxels, voxels.evidence, _on_terrain(voxels, True)) == pytest.approx(
            voxels.evidence, abs=1e-6
        )
    voxels = _line(12, _says([0, 1] * 6))
    assert KeepEvidence()(voxels, voxels.evidence, _on_terrain(voxels, True)) is voxels.evidence


@relaxed
@given(seeds)
def test_competition(seed: int) -> None:
    rng = np.random.default_rng(seed)
    distance = rng.choice([0.5, 1.0, 1.5, 2.0, np.inf], (40, 5))
    expected = []
    for row in distance.tolist():
        winner = 0
        for k in range(5):
            if row[k] < min(row[c] for c in range(5) if c != k):
                winner = k + 1
        expected.append(winner)
    assert compete(distance).tolist() == expected


def test_a_place_takes_only_classes_that_its_support_allows() -> None:
    allowed = plausible(np.array([True, False]))
    assert allowed.tolist() == [[True, True, False, False, False], [False, False, True, True, True]]


# ---- agreement


@relaxed
@given(seeds)
def test_agreement_against_its_definition(seed: int) -> None:
    """The local linear model written out: one weighted least-squares fit at the middle of one block."""
    rng = np.random.default_rng(seed)
    n, radius, ridge = 60, 2.0, 1e-3
    xy = np.full((n, 2), 0.25)  # the middle of a block of half a metre
    xy[0] = 0.0
    rgb = rng.uniform(0, 255, (n, 3)).astype(np.float32)
    evidence = rng.random((n, 5)).astype(np.float32)
    evidence[rng.random(n) < 0.3] = 0
    evidence[0] = rng.random(5)
    said = evidence.any(axis=1)
    c, p = rgb.astype(float)[said] / 255, evidence.astype(float)[said]
    deviation = c - c.mean(0)
    slope = np.linalg.solve(
        deviation.T @ deviation / len(c) + ridge * np.eye(3), deviation.T @ (p - p.mean(0)) / len(c)
    )
    expected = p.mean(0) + (rgb / 255.0 - c.mean(0)) @ slope
    found = agreed(xy, rgb, evidence, radius, ridge)
    assert found[1:] == pytest.approx(np.maximum(expected, 0)[1:], abs=1e-5)


def test_what_looks_alike_nearby_is_alike() -> None:
    """Soil and grass side by side, a tenth of the evidence wrong in patches: colour puts it right, keeps the edge."""
    y, x = np.mgrid[:60, :60] * 0.1
    xy = np.stack([x.ravel(), y.ravel()], axis=1)
    true = (xy[:, 0] > 3.05).astype(int)
    rgb = np.array([[150, 110, 70], [70, 110, 50]], np.float32)[true]
    told = np.where((xy[:, 0] // 0.8 + xy[:, 1] // 0.8) % 9 == 0, 1 - true, true)
    found = agreed(xy, rgb, np.eye(5, dtype=np.float32)[told], 2.0, 5e-4)
    assert (found.argmax(axis=1) == true).all()


# ---- reliability


def _seen(rng: np.random.Generator, J: int = 8, S: int = 3) -> tuple[Voxels, LocalGeometry]:
    voxels = voxels_at(rng.random((J, 3)), 0.1, S, rng.random((S * J, 5)))
    normal = rng.normal([0, 0, 3], 1.0, (J, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    confident = replace(voxels, confidence=rng.random(S * J).astype(np.float32))
    return confident, replace(flat_local(J), normal=normal.astype(np.float32))


@relaxed
@given(seeds)
def test_reliability_against_its_definition(seed: int) -> None:
    voxels, local = _seen(np.random.default_rng(seed))
    weight = Reliability()(voxels, voxels.evidence, local)
    distinct = sorted(set(voxels.confidence.tolist()))
    for m in range(len(weight)):
        j = voxels.voxel[m]
        ray = voxels.centres[voxels.view[m]] - voxels.xyz[m]
        length = np.linalg.norm(ray)
        others = [np.linalg.norm(voxels.centres[voxels.view[i]] - voxels.xyz[i])
                  for i in range(len(weight)) if voxels.voxel[i] == j]  # fmt: skip
        terms = [
            (voxels.evidence[m].max(), 1.0),
            ((distinct.index(float(voxels.confidence[m])) + 1) / len(distinct), 0.5),
            (abs(ray @ local.normal[j]) / length, 0.5),
            (min(others) / length, 1.0),
        ]
        expected = np.prod([min(max(float(t), 0.05), 1.0) ** x for t, x in terms])
        assert weight[m] == pytest.approx(expected, rel=1e-4)


@relaxed
@given(seeds)
def test_reliability_is_positive_bounded_and_blind_to_units(seed: int) -> None:
    voxels, local = _seen(np.random.default_rng(seed))
    weight = Reliability()(voxels, voxels.evidence, local)
    assert (weight >= 0.05**3 * 0.99).all()
    assert (weight <= 1 + 1e-6).all()
    scaled = replace(voxels, xyz=voxels.xyz * 8, centres=voxels.centres * 8, confidence=voxels.confidence * 4)
    assert Reliability()(scaled, voxels.evidence, local) == pytest.approx(weight, rel=1e-4)


def test_more_of_each_term_is_never_less_reliable() -> None:
    J = 20
    rising = np.linspace(0, 1, J, dtype=np.float32)
    at = np.zeros((J, 3))
    base = voxels_at(at, 0.1, 1, np.tile([0.5, 0, 0, 0, 0], (J, 1)))
    local, weigh = flat_local(J), Reliability()
    said = np.outer(rising, [1, 0, 0, 0, 0]).astype(np.float32)
    assert (np.diff(weigh(base, said, local)) >= 0).all()
    assert (np.diff(weigh(replace(base, confidence=rising), base.evidence, local)) > 0).all()
    tilt = np.arccos(rising)
    turned = np.column_stack([np.sin(tilt), 0 * tilt, np.cos(tilt)]).astype(np.float32)
    overhead = replace(base, centres=np.array([[0, 0, 20.0]]))
    seen_from_above = weigh(overhead, base.evidence, replace(local, normal=turned))
    assert (np.diff(seen_from_above) >= 0).all()
    assert seen_from_above[-1] > 4 * seen_from_above[0]


def test_the_nearer_view_of_a_voxel_counts_more() -> None:
    voxels = voxels_at(np.zeros((1, 3)), 0.1, 2, np.full((2, 5), 0.5))
    voxels = replace(voxels, centres=np.array([[0, 0, 5.0], [0, 0, 10.0]]))
    near, far = Reliability()(voxels, voxels.evidence, flat_local(1))
    assert near == pytest.approx(2 * far)
    assert (Uniform()(voxels, voxels.evidence, flat_local(1)) == 1).all()


def test_ranks_ignore_repetition_and_scale() -> None:
    c = np.array([3.0, 1.0, 3.0, 9.0], np.float32)
    assert distinct_rank(c) == pytest.approx([2 / 3, 1 / 3, 2 / 3, 1])
    assert (distinct_rank(np.exp(c)) == distinct_rank(c)).all()
    assert (distinct_rank(np.full(5, 7.0, np.float32)) == 1).all()


def test_a_lone_doubtful_view_does_not_look_certain() -> None:
    voxels = voxels_at(np.zeros((1, 3)), 0.1, 1, [[1, 0, 0, 0, 0]])
    faint, firm = (Vote()(voxels, voxels.evidence, np.full(1, w, np.float32))[0, CT] for w in (0.01, 1.0))
    assert faint == pytest.approx(0.01 / 0.03, rel=1e-4)
    assert firm == pytest.approx(1 / 1.02, rel=1e-4)


# ---- admissibility


def _places() -> tuple[Voxels, LocalGeometry, Terrain, ObjectSupport]:
    """Eight places: terrain (smooth x 3, steep, rough), off it in a component, off it without, outlier."""
    J = 8
    voxels = voxels_at(np.column_stack([np.arange(J) * 0.1, np.zeros(J), np.zeros(J)]), 0.1)
    inlier = np.arange(J) != 7
    local = replace(
        flat_local(J, inlier),
        slope=np.array([0, 0, 0.2, 1.5, 0, 0, 0, 0], np.float32),
        roughness=np.array([0.01, 0.01, 0.01, 0.01, 0.5, 0, 0, 0], np.float32),
    )
    component = np.array([0, 0, 0, 0, 0, 1, 0, 0], np.int32)
    objects = ObjectSupport(component, 4 * component)
    return voxels, local, _on_terrain(voxels, np.arange(J) < 5), objects


def test_the_table_of_admissibility() -> None:
    stage = Admissibility(doubtful=0.04, no_component=0.5, in_component=0.15, cover_smooth=0.1)
    g = stage(*_places())
    assert g.shape == (8, 5)
    assert (g >= 0).all()
    assert (g <= 1).all()
    smooth, steep, rough, standing, loose, outlier = g[0], g[3], g[4], g[5], g[6], g[7]
    assert smooth == pytest.approx([1, 1, 0.1, 0.04, 0.04])
    assert steep == pytest.approx([1, 0.04, 0.1, 0.04, 0.04])  # a face is dug or dumped, not turf
    assert rough == pytest.approx([1, 1, 1, 0.04, 0.04])
    assert standing == pytest.approx([0.04, 0.04, 0.15, 1, 0.15])  # a component of excavators
    assert loose == pytest.approx([0.04, 0.04, 1, 0.5, 0.5])
    assert (outlier == 0).all()


def test_objects_need_components_only_where_components_are_looked_for() -> None:
    voxels, local, terrain, _ = _places()
    g = Admissibility()(voxels, local, terrain, None)
    assert (g[5:7, EX:] == 1).all()
    assert (g[:5, EX:] == Admissibility().doubtful).all()
    assert (g[7] == 0).all()
    assert (AdmitAll()(voxels, local, terrain, None) == 1).all()


@relaxed
@given(seeds, st.floats(0.0, 0.3), st.floats(0.0, 1.0))
def test_properties_of_admissibility(seed: int, doubtful: float, no_component: float) -> None:
    rng = np.random.default_rng(seed)
    J = 40
    voxels = voxels_at(rng.random((J, 3)), 0.1)
    local = replace(
        flat_local(J, rng.random(J) < 0.8),
        slope=rng.uniform(0, np.pi / 2, J).astype(np.float32),
        roughness=rng.exponential(0.02, J).astype(np.float32),
    )
    terrain = _on_terrain(voxels, local.inlier & (rng.random(J) < 0.5))
    component = rng.integers(0, 3, J).astype(np.int32)
    objects = ObjectSupport(component, np.where(component > 0, rng.choice([4, 5], J), 0).astype(np.int32))
    g = Admissibility(doubtful=doubtful, no_component=no_component)(voxels, local, terrain, objects)
    ground, standing = terrain.member, local.inlier & ~terrain.member
    assert (g[~local.inlier] == 0).all()
    assert (g[ground, EX:] == np.float32(doubtful)).all()
    assert (g[standing, :RC] == np.float32(doubtful)).all()
    assert (g[local.inlier].max(axis=1) == 1).all()
    for k in (EX, OB):
        with_component = standing & (objects.task_class == k + 1)
        assert (g[with_component, k] == 1).all()
        assert (g[standing & (component == 0), k] == np.float32(no_component)).all()
    assert (g[standing & (component > 0)].max(axis=1) == 1).all()
    for value, column, sign in ((local.slope, OT, -1), (local.roughness, RC, 1)):
        order = np.argsort(value[ground], kind="stable")
        assert (sign * np.diff(g[ground][order, column]) >= -1e-6).all()


def test_perfectly_smooth_terrain_is_not_cover() -> None:
    voxels, local, terrain, objects = _places()
    smooth = replace(local, roughness=np.zeros(8, np.float32))
    assert Admissibility()(voxels, smooth, terrain, objects)[:5, RC] == pytest.approx(Admissibility().cover_smooth)
    nowhere = _on_terrain(voxels, False)
    assert np.isfinite(Admissibility()(voxels, local, nowhere, objects)).all()


# ---- decision


def _decided(v: list[float], g: list[float], **parameters: float) -> tuple[int, Reason]:
    labels = Decision(**parameters)(np.array([v], np.float32), np.array([g], np.float32))
    return int(labels.label[0]), Reason(int(labels.reason[0]))


ALL = [1.0, 1, 1, 1, 1]
ON_TERRAIN = [1.0, 1, 0.1, 0.04, 0.04]


@pytest.mark.parametrize(
    ("v", "g", "label", "reason"),
    [
        ([0.9, 0, 0, 0, 0], ALL, TaskClass.CONSTRUCTION_TERRAIN, Reason.CLASSIFIED),
        ([0, 0, 0, 0, 0], ALL, TaskClass.UNKNOWN, Reason.INSUFFICIENT),
        ([0, 0, 0, 0.001, 0], ON_TERRAIN, TaskClass.UNKNOWN, Reason.INSUFFICIENT),
        ([0, 0, 0, 0.05, 0], ON_TERRAIN, TaskClass.UNKNOWN, Reason.INADMISSIBLE),
        ([0.45, 0.45, 0, 0, 0], ALL, TaskClass.UNKNOWN, Reason.CONFLICTING),
        ([0.2, 0.2, 0, 0.9, 0], ON_TERRAIN, TaskClass.UNKNOWN, Reason.INADMISSIBLE),
        ([0.9, 0.9, 0.9, 0.9, 0.9], [0.0] * 5, TaskClass.UNKNOWN, Reason.INADMISSIBLE),
        ([0.6, 0, 0, 0.7, 0], ON_TERRAIN, TaskClass.CONSTRUCTION_TERRAIN, Reason.CLASSIFIED),
    ],
    ids=[
        "clear",
        "silence",
        "a whisper",
        "a word for what cannot be",
        "two classes",
        "not here",
        "outlier",
        "geometry decides",
    ],
)
def test_labels_and_reasons(v: list[float], g: list[float], label: TaskClass, reason: Reason) -> None:
    assert _decided(v, g) == (label, reason)


def test_strong_repeated_evidence_overcomes_a_doubtful_support() -> None:
    assert _decided([0, 0, 0, 0.95, 0], ON_TERRAIN, epsilon=0.005)[0] == TaskClass.EXCAVATOR
    assert _decided([0.1, 0, 0, 0.95, 0], ON_TERRAIN)[0] == TaskClass.CONSTRUCTION_TERRAIN


@relaxed
@given(seeds, st.floats(0.05, 0.95))
def test_every_unknown_has_a_reason_and_no_class_has_one(seed: int, tau: float) -> None:
    rng = np.random.default_rng(seed)
    v = (rng.random((60, 5)) * rng.choice([0, 0.05, 1], (60, 1))).astype(np.float32)
    g = rng.choice([0, 0.04, 1], (60, 5)).astype(np.float32)
    labels = Decision(tau=tau)(v, g)
    assert ((labels.reason == Reason.CLASSIFIED) == (labels.label > 0)).all()
    assert not (labels.reason == Reason.UNOBSERVED).any()
    assert (labels.confidence == labels.score.max(axis=1)).all()
    assert (labels.confidence[labels.label > 0] >= np.float32(tau)).all()
    total = labels.score.sum(axis=1)
    assert np.allclose(total[g.any(axis=1)], 1, atol=1e-5)
    assert (total[~g.any(axis=1)] == 0).all()


# ---- certainty


@relaxed
@given(seeds, st.floats(0.0, 1.0))
def test_certainty_against_its_definition(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    J = 12
    near = rng.integers(0, J, (J, 4)).astype(np.int32)
    voxels = replace(voxels_at(rng.random((J, 3)), 0.1), neighbours=near, distances=np.zeros((J, 4), np.float32))
    v = rng.random((J, 5)).astype(np.float32)
    labels = Decision(tau=0.3)(v, np.ones_like(v))
    sure = Certainty(neighbours=share)(voxels, labels)
    for j in range(J):
        alike = sum(labels.label[n] == labels.label[j] for n in voxels.neighbours[j]) / 4
        assert sure.confidence[j] == pytest.approx(labels.confidence[j] ** (1 - share) * alike**share, rel=1e-5)
    assert (sure.label == labels.label).all()
    assert KeepScore()(voxels, labels) is labels
