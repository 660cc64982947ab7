"""Laws of merging several segmenters, and weights found from labelled pictures."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from excavatwin.backbones.merging import FURTHEST, Merging, _unlikeliness, calibrate
from excavatwin.backbones.protocols import Segmentation
from excavatwin.errors import InputError

SHAPE = (4, 5)
NAMES = ("yoloe", "mask2former", "masks")


@st.composite
def segmentations(draw) -> Segmentation:
    """Evidence as the protocol has it: in [0, 1], sum at most 1, none where there is no surface."""
    raw = draw(arrays(np.float32, (*SHAPE, 5), elements=st.floats(0, 1, width=32)))
    evidence = raw / np.maximum(raw.sum(-1, keepdims=True), 1)
    none = draw(arrays(bool, SHAPE))
    evidence[none] = 0
    return Segmentation(evidence, none)


rows = st.tuples(*[st.floats(0, 8)] * 5)
crowds = st.dictionaries(st.sampled_from(NAMES), segmentations(), min_size=1)


def silent() -> Segmentation:
    return Segmentation(np.zeros((*SHAPE, 5), np.float32), np.zeros(SHAPE, bool))


@settings(max_examples=60, deadline=None)
@given(crowds, st.fixed_dictionaries(dict.fromkeys(NAMES, rows)), st.randoms())
def test_evidence_is_bounded_and_order_is_irrelevant(seen, weights, random):
    merge = Merging({name: weights[name] for name in seen})
    out = merge(seen)
    assert out.evidence.dtype == np.float32
    assert out.evidence.shape == (*SHAPE, 5)
    assert out.evidence.min() >= 0
    assert out.evidence.sum(-1).max() <= 1 + 1e-6
    assert not out.evidence[out.no_surface].any()
    order = list(seen)
    random.shuffle(order)
    again = merge({name: seen[name] for name in order})
    np.testing.assert_array_equal(again.evidence, out.evidence)
    np.testing.assert_array_equal(again.no_surface, out.no_surface)


@settings(max_examples=30, deadline=None)
@given(segmentations())
def test_one_segmenter_passes_unchanged(one):
    assert Merging()({"yoloe": one}) is one
    same = Merging({"yoloe": (1.0,) * 5})({"yoloe": one})
    np.testing.assert_allclose(same.evidence, one.evidence, atol=1e-7)
    np.testing.assert_array_equal(same.no_surface, one.no_surface)


@settings(max_examples=30, deadline=None)
@given(segmentations(), rows)
def test_who_abstains_dilutes_nobody(one, row):
    """A segmenter that says nothing changes nothing, whatever its weight: neither evidence nor the sky."""
    out = Merging({"masks": row})({"yoloe": one, "masks": silent()})
    np.testing.assert_allclose(out.evidence, one.evidence, atol=1e-7)
    np.testing.assert_array_equal(out.no_surface, one.no_surface)


@settings(max_examples=30, deadline=None)
@given(segmentations())
def test_agreement_strengthens(one):
    out = Merging()({"yoloe": one, "masks": one})
    assert (out.evidence >= one.evidence - 1e-6).all()
    np.testing.assert_array_equal(out.no_surface, one.no_surface)


def uniform(row, none=False) -> Segmentation:
    return Segmentation(np.broadcast_to(np.float32(row), (*SHAPE, 5)).copy(), np.full(SHAPE, none))


def test_weights_are_of_channels():
    seen = {"yoloe": uniform([0.2, 0, 0, 0.4, 0]), "masks": uniform([0, 0.3, 0, 0.1, 0])}
    out = Merging({"yoloe": (0.5, 1, 1, 2, 1), "masks": (1, 1, 1, 0, 1)})(seen)
    np.testing.assert_allclose(out.evidence[0, 0], np.array([0.1, 0.3, 0, 0.8, 0]) / 1.2, rtol=1e-6)


def test_where_there_is_no_surface_the_weightier_decide():
    sky, ground = uniform([0] * 5, True), uniform([0.6, 0.2, 0, 0, 0])
    assert Merging()({"a": sky, "b": ground}).no_surface.all()
    assert not Merging()({"a": sky, "b": ground, "c": uniform([0, 0.5, 0, 0, 0])}).no_surface.any()
    assert not Merging({"a": (0.5,) * 5})({"a": sky, "b": ground}).no_surface.any()
    out = Merging()({"a": sky, "b": ground, "c": sky})
    assert out.no_surface.all()
    assert not out.evidence.any()


def test_doubts_name_their_segmenter():
    a = Segmentation(silent().evidence, silent().no_surface, ("has no labels.",))
    assert Merging()({"masks": a, "yoloe": silent()}).doubts == ("masks: has no labels.",)


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        ({"a": (1, 1, 1)}, r"merging.weights of a is \[1, 1, 1\]; give 5 numbers"),
        ({"a": (1, 1, 1, 1, -1)}, "numbers of at least 0"),
        ({"a": (1, 1, 1, 1, np.nan)}, "numbers of at least 0"),
        ({"yoleo": (1,) * 5}, "names yoleo, but the segmenters are: a, b"),
    ],
)
def test_wrong_weights_are_refused(weights, message):
    with pytest.raises(InputError, match=message):
        Merging(weights)({"a": silent(), "b": silent()})


def test_different_sizes_are_refused():
    small = Segmentation(np.zeros((2, 2, 5), np.float32), np.zeros((2, 2), bool))
    with pytest.raises(InputError, match="different shapes"):
        Merging()({"a": silent(), "b": small})


# --- calibration ----------------------------------------------------------------------------------------------------


def labelled(seed: int, pixels: int = 20_000, without: int = 0) -> tuple[dict[str, Segmentation], np.ndarray]:
    """A dense segmenter that overclaims cover and takes machines for obstacles, and a sparse one that finds them."""
    rng = np.random.default_rng(seed)
    true = rng.choice(5, pixels, p=[0.4, 0.3, 0.15, 0.05, 0.1]) + 1
    true[true == without] = 1
    odds = 1.5 * np.eye(5)[true - 1] + rng.normal(size=(pixels, 5))
    odds[:, 2] += 1.5
    odds[true == 4, 4] += 2.5
    dense = np.exp(odds) / np.exp(odds).sum(1, keepdims=True)
    sparse = np.zeros((pixels, 5))
    sparse[:, 3] = 0.3 * ((true == 4) & (rng.random(pixels) < 0.7))
    sparse[:, 0] = 0.5 * (rng.random(pixels) < 0.1)  # claims soil at random
    shape = (pixels // 100, 100)
    seen = {
        name: Segmentation(some.reshape(*shape, 5).astype(np.float32), np.zeros(shape, bool))
        for name, some in (("dense", dense), ("sparse", sparse))
    }
    return seen, true.reshape(shape).astype(np.uint8)


def mean_iou(found: Segmentation, truth: np.ndarray) -> float:
    best = found.evidence.argmax(-1) + 1
    return float(
        np.mean([((best == k) & (truth == k)).sum() / ((best == k) | (truth == k)).sum() for k in range(1, 6)])
    )


def test_weights_are_learned_from_some_pictures_and_help_on_others():
    first, second = labelled(0), labelled(1)
    weights = calibrate([first[0]], [first[1]])
    assert weights["dense"][2] < 0.6 * weights["dense"][0]  # what it overclaims
    assert weights["sparse"][3] > 2  # what it knows, although it claims little
    assert weights["sparse"][0] < 0.5  # what it claims at random
    assert all(1 / FURTHEST <= w <= FURTHEST for row in weights.values() for w in row)
    plain, better = mean_iou(Merging()(second[0]), second[1]), mean_iou(Merging(weights)(second[0]), second[1])
    dense = mean_iou(second[0]["dense"], second[1])
    assert better > plain + 0.05
    assert better > dense + 0.05


def test_calibration_is_deterministic_and_blind_to_order():
    seen, truth = labelled(0)
    weights = calibrate([seen], [truth])
    assert calibrate([seen], [truth]) == weights
    turned = calibrate([dict(reversed(seen.items()))], [truth])
    for name in weights:
        np.testing.assert_allclose(turned[name], weights[name])


def test_channels_without_truth_keep_their_weight():
    seen, truth = labelled(0, without=4)
    assert calibrate([seen], [truth])["sparse"][3] == 1
    truth = np.where(truth == 3, 255, truth)  # not labelled
    assert calibrate([seen], [truth])["dense"][2] == 1


def test_the_gradient_is_right():
    rng = np.random.default_rng(0)
    evidence, true, importance = 0.3 * rng.random((2, 300, 5)), rng.integers(0, 5, 300), rng.random(300)
    logs = 0.5 * rng.normal(size=10)
    _, gradient = _unlikeliness(logs, evidence, true, importance)
    for i in range(10):
        step = 1e-6 * np.eye(10)[i]
        up, down = (_unlikeliness(logs + sign * step, evidence, true, importance)[0] for sign in (1, -1))
        assert gradient[i] == pytest.approx((up - down) / 2e-6, rel=1e-4, abs=1e-7)


def test_calibration_without_truth_is_refused():
    seen, truth = labelled(0)
    with pytest.raises(InputError, match="hold no pixel of a task class"):
        calibrate([seen], [np.zeros_like(truth)])
    with pytest.raises(InputError, match="hold no pixel of a task class"):
        calibrate([], [])
    with pytest.raises(InputError, match="seen by the same segmenters"):
        calibrate([seen, {"dense": seen["dense"]}], [truth, truth])
