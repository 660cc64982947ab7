"""Semantic scores against naive transcriptions, and the laws they keep."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from excavatwin.evaluation.selective import expected_calibration_error, risk_coverage
from excavatwin.evaluation.semantics import semantic_scores

CLASSES = st.sampled_from([0, 1, 2, 3, 4, 5, 255])
PLACES = st.lists(st.tuples(CLASSES, CLASSES, st.sampled_from([0.0, 0.2, 0.25, 0.7, 1.0])), min_size=1, max_size=40)


def arrays(places) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    predicted, true, confidence = zip(*places, strict=True)
    return np.array(predicted, np.uint8), np.array(true, np.uint8), np.array(confidence)


def values(metrics) -> dict[str, float]:
    assert len({m.name for m in metrics}) == len(metrics)
    return {m.name: m.value for m in metrics}


def naive_miou(pairs, selective: bool) -> float:
    """By the definition, one class after the other."""
    scored = [(p, t) for p, t in pairs if 1 <= t <= 5]
    present = {t for _, t in scored}
    if selective:
        scored = [(p, t) for p, t in scored if 1 <= p <= 5]
    found = []
    for k in sorted(present):
        both = sum(p == k and t == k for p, t in scored)
        either = sum(p == k or t == k for p, t in scored)
        if either:
            found.append(both / either)
    return 100 * sum(found) / len(found) if found else float("nan")


@settings(deadline=None)
@given(PLACES)
def test_scores_equal_their_naive_twins(places) -> None:
    predicted, true, confidence = arrays(places)
    found = values(semantic_scores(predicted, true, confidence))
    pairs = [(p, t) for p, t, _ in places]
    valid = [(p, t) for p, t in pairs if 1 <= t <= 5]
    labelled = [(p, t) for p, t in valid if 1 <= p <= 5]
    share = lambda part, whole: 100 * part / whole if whole else float("nan")  # noqa: E731
    expected = {
        "map_miou": naive_miou(pairs, selective=False),
        "map_miou_selective": naive_miou(pairs, selective=True),
        "map_coverage": share(len(labelled), len(valid)),
        "map_accuracy": share(sum(p == t for p, t in valid), len(valid)),
        "map_accuracy_selective": share(sum(p == t for p, t in labelled), len(labelled)),
    }
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, nan_ok=True), name


@settings(deadline=None)
@given(PLACES)
def test_strict_never_exceeds_selective(places) -> None:
    found = values(semantic_scores(*arrays(places)))
    for strict, selective in (("map_miou", "map_miou_selective"), ("map_accuracy", "map_accuracy_selective")):
        assert not found[strict] > found[selective] + 1e-9
    if found["map_coverage"] == 100:
        assert found["map_miou"] == pytest.approx(found["map_miou_selective"])


@settings(deadline=None)
@given(PLACES, st.integers(0, 9))
def test_risk_coverage_equals_its_naive_twin_and_knows_no_order(places, seed) -> None:
    predicted, true, confidence = arrays(places)
    curve = risk_coverage(predicted, true, confidence)
    valid = [(p, t, c) for p, t, c in places if 1 <= t <= 5]
    ranked = sorted((x for x in valid if 1 <= x[0] <= 5), key=lambda x: -x[2])
    assert len(curve.risk) == len(ranked)
    assert (np.diff(curve.coverage) > 0).all()
    assert (np.diff(curve.threshold) <= 0).all()
    errors = 0.0
    for i, (_, _, c) in enumerate(ranked):
        tied = [x[0] != x[1] for x in ranked if x[2] == c]
        errors += sum(tied) / len(tied)
        assert curve.coverage[i] == pytest.approx((i + 1) / len(valid))
        assert curve.risk[i] == pytest.approx(errors / (i + 1))
    shuffled = np.random.default_rng(seed).permutation(len(places))
    again = risk_coverage(predicted[shuffled], true[shuffled], confidence[shuffled])
    np.testing.assert_allclose(again.risk, curve.risk, atol=1e-12)


def test_risk_at_a_coverage_is_read_off_the_curve() -> None:
    true = np.ones(100, np.uint8)
    forced = np.where(np.arange(100) < 90, 1, 2).astype(np.uint8)  # 10 % wrong ...
    confidence = np.linspace(1, 0, 100)  # ... and they are the least confident
    rejected = np.where(confidence > 0.02, forced, 0).astype(np.uint8)
    found = values(semantic_scores(rejected, true, confidence, forced=forced))
    assert found["map_risk_forced"] == pytest.approx(10)
    assert found["map_risk_at_95"] == pytest.approx(100 * 5 / 95)
    assert found["map_risk_ratio"] == pytest.approx(10 * 5 / 95)
    assert found["map_aurc"] == pytest.approx(100 * np.mean([max(0, i - 90) / i for i in range(1, 101)]))
    curve = risk_coverage(np.where(np.arange(100) < 80, forced, 0).astype(np.uint8), true, confidence)
    assert curve.coverage[-1] == 0.8
    assert np.isnan(curve.risk_at(0.95))
    assert len(risk_coverage(forced, true, confidence).thinned(11).risk) == 11


def test_calibration_error_is_zero_when_calibrated_and_large_when_not() -> None:
    confidence = np.repeat([0.1, 0.5, 0.9], 10)
    calibrated = np.concatenate([np.arange(10) < n for n in (1, 5, 9)])
    assert expected_calibration_error(calibrated, confidence) == pytest.approx(0)
    assert expected_calibration_error(np.zeros(10, bool), np.ones(10)) == pytest.approx(1)
    assert np.isnan(expected_calibration_error(np.zeros(0, bool), np.zeros(0)))


@settings(deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.floats(0, 1)), min_size=1, max_size=60))
def test_calibration_error_equals_its_naive_twin(places) -> None:
    right, confidence = (np.array(v) for v in zip(*places, strict=True))
    total = 0.0
    for b in range(15):
        inside = [(r, c) for r, c in places if min(int(c * 15), 14) == b]
        if inside:
            accuracy, stated = (sum(column) / len(inside) for column in zip(*inside, strict=True))
            total += len(inside) / len(places) * abs(accuracy - stated)
    assert expected_calibration_error(right, confidence) == pytest.approx(total, abs=1e-9)


def test_every_iou_names_its_kind_and_its_policy() -> None:
    ones = np.ones(4, np.uint8)
    for metric in semantic_scores(ones, ones, policy="diggable", name="photo"):
        if "iou" in metric.name:
            assert "'diggable'" in metric.meaning
            assert "strict" in metric.meaning or "selective" in metric.meaning
