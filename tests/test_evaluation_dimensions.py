"""Object dimensions: figures by naive transcription, and that no object sets the scale that it is scored with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from excavatwin.errors import InputError
from excavatwin.evaluation.dimensions import (
    MeasuredObject,
    camera_baseline,
    camera_scale,
    class_mean_ratio,
    dimension_metrics,
    metric_backbone,
    one_dimension,
    other_object,
)

LENGTH = st.floats(0.05, 20)
SIZE = st.tuples(LENGTH, LENGTH, LENGTH)
OBJECTS = st.lists(
    st.builds(MeasuredObject, st.sampled_from("abc"), st.sampled_from(["cup", "shoe"]), SIZE, SIZE),
    min_size=1,
    max_size=8,
)


def some_objects() -> list[MeasuredObject]:
    """Reconstructed at half size in clip a and at a third in clip b, one dimension a little wrong."""
    return [
        MeasuredObject("a", "cup", (0.04, 0.05, 0.11), (0.08, 0.1, 0.2)),
        MeasuredObject("a", "shoe", (0.15, 0.05, 0.05), (0.3, 0.1, 0.1)),
        MeasuredObject("b", "cup", (0.03, 0.03, 0.05), (0.09, 0.09, 0.15)),
    ]


@settings(deadline=None)
@given(OBJECTS, st.integers(0, 7), st.integers(0, 2), st.floats(0.5, 2))
def test_the_scored_dimension_never_sets_its_own_scale(objects, which, axis, factor) -> None:
    i = which % len(objects)
    measured = list(objects[i].measured)
    measured[axis] *= factor
    changed = [*objects[:i], replace(objects[i], measured=tuple(measured)), *objects[i + 1 :]]
    scale_of = {"a": 2.0, "b": 3.0, "c": 1.0}
    for protocol in (
        lambda o: camera_baseline(o, scale_of),
        lambda o: metric_backbone(o, scale_of),
        other_object,
        one_dimension,
    ):
        before, after = protocol(objects), protocol(changed)
        if before.scored[i, axis]:
            assert after.scale[i] == pytest.approx(before.scale[i], nan_ok=True), before.protocol
        else:
            assert before.protocol == "one_dimension"
            assert np.argmax(objects[i].true) == axis
    guess, again = class_mean_ratio(objects), class_mean_ratio(changed)
    np.testing.assert_allclose(again.size[i], guess.size[i])  # it never looks at the reconstruction


@settings(deadline=None)
@given(OBJECTS, st.integers(0, 7), st.floats(0.5, 2))
def test_the_guess_does_not_know_the_object_that_it_guesses(objects, which, factor) -> None:
    i = which % len(objects)
    longest = int(np.argmax(objects[i].true))
    true = [v if a == longest else v * min(factor, 1) for a, v in enumerate(objects[i].true)]
    changed = [*objects[:i], replace(objects[i], true=tuple(true)), *objects[i + 1 :]]
    np.testing.assert_allclose(class_mean_ratio(changed).size[i], class_mean_ratio(objects).size[i])


def test_scales_of_the_protocols() -> None:
    objects = some_objects()
    np.testing.assert_allclose(camera_baseline(objects, {"a": 2.0}).scale, [2, 2, np.nan])
    np.testing.assert_allclose(one_dimension(objects).scale, [0.2 / 0.11, 2, 3])
    np.testing.assert_allclose(other_object(objects).scale, [2, 0.2 / 0.11, np.nan])
    np.testing.assert_allclose(metric_backbone(objects).scale, 1)
    guess = class_mean_ratio(objects)
    np.testing.assert_allclose(guess.size[0], np.array([0.09, 0.09, 0.15]) / 0.15 * 0.2)
    assert np.isnan(guess.size[1]).all()  # no other shoe
    epochs = [replace(o, reconstruction=f"a/{k}") for k, o in enumerate(objects[:2])]
    assert np.isnan(other_object(epochs).scale).all()  # each was reconstructed on its own


@settings(deadline=None)
@given(OBJECTS)
def test_figures_equal_their_naive_twins(objects) -> None:
    found = {m.name: m.value for m in dimension_metrics(one_dimension(objects), objects)}
    errors, relative = [], []
    for o in objects:
        longest = o.true.index(max(o.true))
        s = o.true[longest] / o.measured[longest]
        for axis in {0, 1, 2} - {longest}:
            errors.append(s * o.measured[axis] - o.true[axis])
            relative.append(abs(errors[-1]) / o.true[axis])
    n = len(errors)
    assert found["dimension_one_dimension_mae"] == pytest.approx(sum(map(abs, errors)) / n)
    assert found["dimension_one_dimension_rmse"] == pytest.approx((sum(e * e for e in errors) / n) ** 0.5)
    assert found["dimension_one_dimension_relative_error"] == pytest.approx(100 * sum(relative) / n)
    assert found["dimension_one_dimension_relative_error_median"] == pytest.approx(100 * np.median(relative))
    assert found["dimension_one_dimension_objects"] == len(objects)


def test_intervals_are_over_sequences_and_objects_without_scale_are_counted_out() -> None:
    objects = some_objects()
    found = {m.name: m for m in dimension_metrics(camera_baseline(objects, {"a": 2.0, "b": 3.0}), objects)}
    mae = found["dimension_camera_baseline_mae"]
    assert mae.low is not None
    assert mae.high is not None
    assert mae.low <= mae.value <= mae.high
    assert found["dimension_camera_baseline_relative_error_median_shoe"].value == pytest.approx(0, abs=1e-9)
    alone = {m.name: m for m in dimension_metrics(camera_baseline(objects, {"a": 2.0}), objects)}
    assert alone["dimension_camera_baseline_objects"].value == 2
    assert alone["dimension_camera_baseline_mae"].low is None  # one sequence tells nothing about the next
    nothing = {m.name: m.value for m in dimension_metrics(camera_baseline(objects, {}), objects)}
    assert np.isnan(nothing["dimension_camera_baseline_mae"])


def test_camera_scale_is_that_of_the_similarity() -> None:
    rng = np.random.default_rng(3)
    ours = rng.normal(size=(6, 3))
    angle = 0.7
    R = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    assert camera_scale(ours, 2.5 * ours @ R.T + 4) == pytest.approx(2.5)
    with pytest.raises(InputError, match="at least three"):
        camera_scale(ours[:2], ours[:2])
    with pytest.raises(InputError, match="zero or less"):
        one_dimension([MeasuredObject("a", "cup", (0, 1, 1), (1, 1, 1))])
