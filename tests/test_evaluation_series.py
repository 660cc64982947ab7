"""Volumes, series, bootstrap and alignment: naive transcriptions, laws, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from excavatwin.errors import InputError
from excavatwin.evaluation import (
    Metric,
    align,
    bootstrap,
    evaluate_site,
    mean_interval,
    over_sequences,
    paired_difference,
)
from excavatwin.evaluation.alignment import shifted
from excavatwin.evaluation.frame import bilinear
from excavatwin.evaluation.published import with_paper
from excavatwin.evaluation.series import change_metrics, final_terrain_metrics, update_interval_metrics
from excavatwin.evaluation.volume import Survey, Volumes, detected, levelled, volumes
from excavatwin.scene.grid import Grid
from excavatwin.scene.site import MappedView, Site
from scored_site import a_map, a_truth, one_point

HEIGHTS = arrays(float, (4, 5), elements=st.one_of(st.floats(-3, 3), st.just(float("nan"))))


def values(metrics) -> dict[str, float]:
    assert len({m.name for m in metrics}) == len(metrics)
    return {m.name: m.value for m in metrics}


@settings(deadline=None)
@given(HEIGHTS, arrays(bool, (4, 5)))
def test_volumes_equal_their_naive_twin(difference, region) -> None:
    found = volumes(difference, 0.5, region)
    cut = fill = area = skipped = 0.0
    for dz, wanted in zip(difference.ravel(), region.ravel(), strict=True):
        if not wanted:
            continue
        if np.isnan(dz):
            skipped += 0.25
            continue
        area += 0.25
        cut, fill = cut + max(-dz, 0) * 0.25, fill + max(dz, 0) * 0.25
    assert (found.cut, found.fill, found.area, found.skipped) == pytest.approx((cut, fill, area, skipped))
    assert found.net == pytest.approx(fill - cut)
    back = volumes(-difference, 0.5, region)
    assert (back.cut, back.fill) == pytest.approx((found.fill, found.cut))


def dug() -> tuple:
    """Two truths with their maps: a pit of 2 x 1 m, 0.5 m deep, appears; a machine hides part of the second map."""
    before = a_truth()
    grid = before.grid
    x, y = np.meshgrid(grid.x, grid.y)
    height = before.height - np.float32(0.5) * ((x > -3) & (x < -1) & (y > -2) & (y < -1))
    after = replace(before, height=height)
    return before, after, a_map(before), a_map(after)


def test_volumes_between_two_maps_with_what_is_skipped() -> None:
    before, after, m0, m1 = dug()
    m0, m1 = (replace(m, elevation=t.height.copy()) for m, t in ((m0, before), (m1, after)))
    hidden = m1.elevation.copy()
    hidden[:, :10] = np.nan  # x < -3: nothing was dug there
    m1 = replace(m1, elevation=hidden)
    place = shifted((0, 0, 0))
    found = values(change_metrics(Survey(m0, place), Survey(m1, place), (before, after)))
    assert found["volume_cut"] == pytest.approx(1.0, abs=1e-4)
    assert found["volume_fill"] == pytest.approx(0, abs=1e-4)
    assert found["volume_net"] == pytest.approx(-1.0, abs=1e-4)
    assert found["volume_cut_error"] == pytest.approx(0, abs=1e-4)
    assert found["volume_cut_relative_error"] == pytest.approx(0, abs=1e-2)
    assert np.isnan(found["volume_fill_relative_error"])
    assert found["volume_skipped_share"] == pytest.approx(100 / 8)
    assert found["volume_skipped_area"] == pytest.approx(6.0)
    assert found["volume_area"] == pytest.approx(42.0)


def test_skipped_change_is_told_from_wrong_change() -> None:
    before, after, m0, m1 = dug()
    m0, m1 = (replace(m, elevation=t.height.copy()) for m, t in ((m0, before), (m1, after)))
    x, _ = np.meshgrid(before.grid.x, before.grid.y)
    m1 = replace(m1, elevation=np.where(x < -2, np.nan, m1.elevation).astype(np.float32))  # half of the pit
    place = shifted((0, 0, 0))
    found = values(change_metrics(Survey(m0, place), Survey(m1, place), (before, after)))
    assert found["volume_cut_error"] == pytest.approx(-0.5, abs=1e-3)
    assert found["volume_cut_hidden"] == pytest.approx(50, abs=0.1)
    assert found["volume_cut_error_compared"] == pytest.approx(0, abs=1e-3)
    stated = values(change_metrics(Survey(m0, place), Survey(m1, place), (before, after), Volumes(2.0, 0.0, 0, 0)))
    assert stated["volume_cut_error"] == pytest.approx(-1.5, abs=1e-3)


def test_two_flights_are_brought_to_one_level_by_themselves() -> None:
    before, after, m0, m1 = dug()
    m0, m1 = (replace(m, elevation=t.height.copy()) for m, t in ((m0, before), (m1, after)))
    x, _ = np.meshgrid(before.grid.x, before.grid.y)
    tilted = replace(m1, elevation=(m1.elevation + 0.3 + 0.01 * x).astype(np.float32))
    place = shifted((0, 0, 0))
    found = values(change_metrics(Survey(m0, place), Survey(tilted, place), (before, after)))
    assert found["volume_fill"] > 10  # the shift of 0.3 m over 48 m2
    assert found["volume_levelled_cut"] == pytest.approx(1.0, abs=0.02)
    assert found["volume_levelled_fill"] == pytest.approx(0, abs=0.02)
    other = replace(after, grid=replace(after.grid, west=9.0))
    with pytest.raises(InputError, match="different grids"):
        change_metrics(Survey(m0, place), Survey(m1, place), (before, other))


def test_changes_within_the_noise_are_none() -> None:
    difference = np.array([[0.01, -0.03, 0.5, np.nan]])
    found = detected(difference, np.array([[0.02, 0.01, 0.02, 0.02]]))
    np.testing.assert_array_equal(found, [[0, -0.03, 0.5, np.nan]])
    assert levelled(difference).shape == difference.shape  # too few cells for a plane


def test_a_map_on_another_grid_is_read_between_its_cells() -> None:
    grid = Grid(0.0, 4.0, 1.0, 4, 4)
    x, y = np.meshgrid(grid.x, grid.y)
    plane = 2 * x - y
    plane[0, 0] = np.nan
    assert bilinear(grid, plane, np.array([2.3]), np.array([1.7])) == pytest.approx(2.9)
    assert bilinear(grid, plane, grid.x[1:2], grid.y[:1]) == pytest.approx(2 * 1.5 - 3.5)  # beside NaN, on a centre
    assert np.isnan(bilinear(grid, plane, np.array([1.2, 0.2]), np.array([3.2, 2.0]))).all()


def test_series_figures() -> None:
    assert update_interval_metrics([5.0]) == ()
    found = values(update_interval_metrics([0, 10, 20, 60]))
    assert found["update_interval_mean"] == 20
    assert found["update_interval_median"] == 10
    assert found["update_interval_max"] == 40
    assert found["update_interval_p95"] == pytest.approx(np.percentile([10, 10, 40], 95))
    with pytest.raises(InputError, match="ascend"):
        update_interval_metrics([3, 1])
    epochs = [(Metric("elevation_mae", v, "m"),) for v in (0.3, 0.1)]
    assert values(final_terrain_metrics(epochs)) == {"final_terrain_mae": 0.1}
    assert final_terrain_metrics(epochs[:1]) == ()


# --- bootstrap ------------------------------------------------------------------------------------------------------


@settings(deadline=None, max_examples=25)
@given(st.lists(st.floats(-100, 100), min_size=2, max_size=12), st.integers(0, 5))
def test_bootstrap_is_deterministic_and_holds_its_value(numbers, seed) -> None:
    first, again = mean_interval(numbers, seed), mean_interval(numbers, seed)
    assert first == again
    assert first.value == pytest.approx(np.mean(numbers))
    assert min(numbers) - 1e-9 <= first.low <= first.value + 1e-9
    assert first.value - 1e-9 <= first.high <= max(numbers) + 1e-9
    plain = bootstrap(numbers, lambda rows: float(np.mean(rows)), seed)
    assert (plain.low, plain.high) == pytest.approx((first.low, first.high))


def test_bootstrap_covers_the_truth_about_as_often_as_it_says() -> None:
    rng = np.random.default_rng(11)
    hits = [(i := mean_interval(rng.normal(3, 1, 25))).low <= 3 <= i.high for _ in range(200)]
    assert 0.87 <= np.mean(hits) <= 0.98  # percentile intervals of 25 are a little narrow


def test_paired_differences_drop_what_both_share() -> None:
    site = np.array([10.0, 50, 90, 30])
    difference = paired_difference(site + np.array([1, 1.2, 0.9, 1.1]), site)
    assert difference.excludes_zero
    assert difference.value == pytest.approx(1.05)
    assert mean_interval(site).high - mean_interval(site).low > 40 * (difference.high - difference.low)
    with pytest.raises(InputError, match="paired"):
        paired_difference([1, 2], [1])
    assert np.isnan(mean_interval([4.0]).low)
    assert mean_interval([4.0, float("nan"), 6.0]).n == 2
    assert np.isnan(mean_interval([]).value)


def test_epochs_count_once_for_their_sequence() -> None:
    row = lambda v: (Metric("elevation_mae", v, "m", "error"),)  # noqa: E731
    tables = {"a": [row(1.0), row(3.0)], "b": [row(5.0)], "c": [row(float("nan"))]}
    (metric,) = over_sequences(tables)
    assert metric.value == pytest.approx(3.5)
    assert metric.meaning == "error (2 of 3 sequences)"
    assert (metric.low, metric.high) == (2.0, 5.0)


# --- alignment ------------------------------------------------------------------------------------------------------


def turned_site(yaw: float = 0.4, shift: tuple[float, float, float] = (3.0, -2.0, 7.0)) -> tuple[Site, object]:
    """A map that knows its truth only by three cameras: the truth turned and shifted, without georeference."""
    truth = a_truth()
    poses = [np.array(p, float) for p in ((-3, 2, 9), (3, 1, 10), (0, -3, 11))]
    views = []
    for k, p in enumerate(poses):
        T = truth.views[0].T_M_cam.copy()
        T[:3, 3] = p
        views.append(replace(truth.views[0], name=f"{k}.jpg", T_M_cam=T))
    truth = replace(truth, views=tuple(views))
    c, s = np.cos(-yaw), np.sin(-yaw)
    inverse = np.array([[c, -s], [s, c]])
    mapped = []
    for view in views:
        T = view.T_M_cam.copy()
        T[:2, 3] = inverse @ (T[:2, 3] - shift[:2])
        T[2, 3] -= shift[2]
        mapped.append(MappedView(view.name, view.label, view.K_cam, T))
    grid = Grid(-12.0, 12.0, 0.1, 240, 240)
    x, y = np.meshgrid(grid.x, grid.y)
    X, Y = c * x + s * y + shift[0], -s * x + c * y + shift[1]
    index = truth.grid.flat_index(np.stack([X.ravel(), Y.ravel()], -1)).reshape(X.shape)
    label = np.where(index >= 0, truth.label.ravel()[np.maximum(index, 0)], 255).astype(np.uint8)
    flat = a_map(truth)
    empty = np.zeros(grid.shape, np.float32)
    terrain = np.isin(label, (1, 2))
    m = replace(
        flat, grid=grid, elevation=np.where(terrain, 0.3 * X - 0.2 * Y + 1 - shift[2], np.nan).astype(np.float32),
        elevation_std=empty, label=label, confidence=empty + 1, observed=(label < 255).astype(np.uint8),
        reason=np.zeros(grid.shape, np.uint8), object_id=np.zeros(grid.shape, np.int32), object_top=empty,
        object_base=empty, support=np.zeros(grid.shape, np.uint8), objects=(), georeference=None,
    )  # fmt: skip
    return Site(m, one_point(), tuple(mapped)), truth


def test_cameras_of_equal_names_bring_a_turned_map_into_the_frame() -> None:
    site, truth = turned_site()
    alignment = align(site.map, site.views, truth)
    assert alignment.way == "cameras"
    assert alignment.yaw == pytest.approx(0.4)
    assert alignment.residual == pytest.approx(0, abs=1e-9)
    assert alignment.scale == pytest.approx(1)
    found = values(evaluate_site(site, truth))
    assert found["elevation_mae"] == pytest.approx(0, abs=1e-4)
    assert found["map_miou"] > 95  # cells are turned against each other
    assert found["alignment_residual"] == pytest.approx(0, abs=1e-9)
    x, y = alignment.to_map(*alignment.to_truth(np.array([1.0, 2]), np.array([3.0, -4])))
    np.testing.assert_allclose((x, y), ([1, 2], [3, -4]))


def test_alignment_never_scales_and_never_sees_the_scored_cells() -> None:
    site, truth = turned_site()
    grown = tuple(replace(v, T_M_cam=v.T_M_cam * np.r_[np.ones(3), 1.1][None]) for v in site.views)
    alignment = align(site.map, grown, truth)
    assert alignment.scale == pytest.approx(1 / 1.1)
    assert alignment.residual > 0.1
    twisted = replace(site.map, elevation=site.map.elevation + 5)
    assert align(twisted, site.views, truth).shift == pytest.approx(align(site.map, site.views, truth).shift)


def test_what_cannot_be_aligned_is_refused() -> None:
    site, truth = turned_site()
    with pytest.raises(InputError, match="three are needed"):
        align(site.map, site.views[:2], truth, "cameras")
    with pytest.raises(InputError, match="arbitrary"):
        align(replace(site.map, metric=False), site.views, truth, "cameras")
    with pytest.raises(InputError, match="no way to align"):
        align(site.map, site.views, truth, "icp")
    with pytest.raises(InputError, match="no georeference"):
        align(site.map, site.views, truth, "declared")


def test_objects_move_with_the_map() -> None:
    site, truth = turned_site()
    alignment = align(site.map, site.views, truth)
    moved = alignment.moved(a_truth().objects[0])
    assert moved.centre == pytest.approx((3.0, -2.0, 0.75 + 7))
    assert moved.yaw == pytest.approx(20 + np.rad2deg(0.4))
    assert moved.z_top == pytest.approx(1.5 + 7)


def test_the_papers_values_stand_beside_ours() -> None:
    ours = (
        Metric("elevation_mae", 0.02, "m", "error"),
        Metric("dimension_camera_baseline_mae", 0.03, "m"),
        Metric("dimension_class_mean_ratio_mae", 0.03, "m"),
        Metric("photo_miou", 60, "%"),
    )
    found = {m.name: m.paper for m in with_paper(ours, "oces")}
    assert found["elevation_mae"] == pytest.approx(0.1261)
    assert found["dimension_camera_baseline_mae"] == pytest.approx(0.0623)
    assert found["dimension_class_mean_ratio_mae"] is None
    assert found["photo_miou"] == 53.19
    assert {m.name: m.paper for m in with_paper(ours, "oces", "yoloe")}["photo_miou"] == 34.57
    assert all(m.paper is None for m in with_paper(ours, "a sample"))
    assert "tab:geometry_accuracy" in with_paper(ours, "oces")[0].meaning
