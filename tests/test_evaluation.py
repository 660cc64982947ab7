"""Figures against naive transcriptions, against known offsets, and for a perfect map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from excavatwin.errors import InputError
from excavatwin.evaluation import Metric, evaluate_site, load_truth
from excavatwin.evaluation.elevation import ground_sampling_distance
from excavatwin.evaluation.frame import true_height
from excavatwin.evaluation.objects import area, box_overlap, clip, match, rectangle
from excavatwin.evaluation.semantics import confusion, intersection_over_union
from excavatwin.export import write_site
from excavatwin.scene.observations import Georeference, Lattice
from excavatwin.scene.site import MappedView, Site
from scored_site import a_map, a_truth, an_object, one_point


def figures(metrics: tuple[Metric, ...]) -> dict[str, float]:
    assert len({metric.name for metric in metrics}) == len(metrics)
    return {metric.name: metric.value for metric in metrics}


def test_a_perfect_map_has_no_errors_and_is_whole() -> None:
    truth = a_truth()
    found = figures(evaluate_site(a_map(truth), truth))
    for name, value in found.items():
        if name.endswith(("_mae", "_rmse", "_bias", "_nmad", "_p95", "_gsd", "_error")) or name == "elevation_tilt":
            assert value == pytest.approx(0, abs=1e-5), name
    for name in (
        "elevation_completeness",
        "map_miou",
        "map_coverage",
        "object_recall",
        "object_precision",
        "object_overlap",
    ):
        assert found[name] == pytest.approx(100), name
    assert found["gsd"] == pytest.approx(0.1, rel=0.02)


def test_known_offset_and_tilt_come_out() -> None:
    truth = a_truth()
    m = a_map(truth)
    x, y = np.meshgrid(truth.grid.x, truth.grid.y)
    moved = replace(m, elevation=(m.elevation + 0.05 + 0.01 * x - 0.02 * y).astype(np.float32))
    found = figures(evaluate_site(moved, truth))
    scored = np.isfinite(m.elevation)
    expected = (0.05 + 0.01 * x - 0.02 * y)[scored]
    assert found["elevation_mae"] == pytest.approx(np.abs(expected).mean(), abs=1e-5)
    assert found["elevation_bias"] == pytest.approx(expected.mean(), abs=1e-5)
    assert found["elevation_rmse"] == pytest.approx(np.sqrt((expected**2).mean()), abs=1e-5)
    assert found["elevation_p95"] == pytest.approx(np.percentile(np.abs(expected), 95), abs=1e-5)
    spread = sorted(abs(e - np.median(expected)) for e in expected)
    assert found["elevation_nmad"] == pytest.approx(1.4826 * np.median(spread), abs=1e-5)
    assert found["elevation_mae_gsd"] == pytest.approx(found["elevation_mae"] / ground_sampling_distance(truth))
    assert found["elevation_fitted_mae"] == pytest.approx(0, abs=1e-5)
    assert found["elevation_tilt"] == pytest.approx(np.rad2deg(np.arctan(np.hypot(0.01, 0.02))), abs=1e-3)


def test_the_georeferences_bring_map_and_truth_together() -> None:
    truth = a_truth()
    m = a_map(truth)
    other = Georeference(32632, (690990.0, 5334005.0, 500.0), 0.0)
    elsewhere = replace(
        m,
        grid=replace(m.grid, west=m.grid.west + 10, north=m.grid.north - 5),
        elevation=m.elevation + np.float32(20),
        objects=(),
        georeference=other,
    )
    found = figures(evaluate_site(elsewhere, truth))
    assert found["elevation_mae"] == pytest.approx(0, abs=1e-5)
    assert found["map_miou"] == pytest.approx(100)
    with pytest.raises(InputError, match="no georeference"):
        evaluate_site(replace(m, georeference=None), truth)
    with pytest.raises(InputError, match="EPSG:32633"):
        evaluate_site(replace(m, georeference=replace(other, epsg=32633)), truth)
    with pytest.raises(InputError, match="arbitrary"):
        evaluate_site(replace(m, metric=False), truth)
    assert figures(evaluate_site(replace(m, georeference=None), truth, (0, 0, 0)))["map_miou"] == pytest.approx(100)


def test_what_is_missing_lowers_completeness_and_coverage() -> None:
    truth = a_truth()
    m = a_map(truth)
    elevation, label = m.elevation.copy(), m.label.copy()
    elevation[:, 40:] = np.nan
    label[:, 40:] = 255
    label[40:50, :40] = 0
    found = figures(evaluate_site(replace(m, elevation=elevation, label=label), truth))
    terrain = np.isin(truth.label, (1, 2))
    assert found["elevation_completeness"] == pytest.approx(100 * terrain[:, :40].sum() / terrain.sum())
    labelled = (label >= 1) & (label <= 5)
    assert found["map_coverage"] == pytest.approx(100 * labelled.mean())
    assert found["map_accuracy"] == pytest.approx(100 * (label == truth.label).mean())
    assert found["map_miou"] < 60  # unknown counts as wrong


@settings(deadline=None)
@given(
    st.lists(st.tuples(st.sampled_from([0, 1, 2, 3, 4, 5, 255]), st.sampled_from([0, 1, 2, 3, 4, 5, 255])), min_size=1)
)
def test_iou_equals_its_naive_twin(pairs) -> None:
    predicted, true = np.array(pairs, np.uint8).T
    iou = intersection_over_union(confusion(predicted, true))
    for k in range(1, 6):
        valid = [(p, t) for p, t in pairs if 1 <= t <= 5]
        both = sum(p == k and t == k for p, t in valid)
        either = sum(p == k or t == k for p, t in valid)
        assert iou[k - 1] == pytest.approx(both / either) if either else np.isnan(iou[k - 1])


def test_photos_are_compared_pixel_by_pixel_through_their_lattice() -> None:
    truth = a_truth()
    half = truth.views[0].label[::2, ::2]
    K = truth.views[0].K_cam
    lattice = Lattice(80, 60, np.array([[0.5, 0, 0], [0, 0.5, 0]]), K)
    view = MappedView("a.jpg", half, K, np.eye(4), lattice=lattice)
    points = one_point()
    found = figures(evaluate_site(Site(a_map(truth), points, (view,)), truth))
    assert found["photo_coverage"] == pytest.approx(50)  # b.jpg was not placed
    assert found["photo_accuracy"] == pytest.approx(50, abs=1)


def test_a_site_folder_gives_the_figures_of_its_site(tmp_path) -> None:
    truth = a_truth()
    m = a_map(truth)
    K = truth.views[0].K_cam
    view = MappedView("a.jpg", truth.views[0].label, K, truth.views[0].T_M_cam)
    points = one_point()
    site = Site(m, points, (view,))
    write_site(site, tmp_path / "site")
    direct, read = figures(evaluate_site(site, truth)), figures(evaluate_site(tmp_path / "site", truth))
    assert direct.keys() == read.keys()
    for name, value in direct.items():
        assert read[name] == pytest.approx(value, abs=0.2 if "%" in name or "error" in name else 2e-3, nan_ok=True), (
            name
        )


def test_overlap_of_rectangles() -> None:
    a = rectangle(an_object(yaw=0), np.zeros(3))
    assert area(a) == pytest.approx(2.0)
    assert box_overlap(a, a) == pytest.approx(1)
    assert box_overlap(a, a + np.array([1.0, 0])) == pytest.approx(1 / 3)
    assert box_overlap(a, a + np.array([9.0, 0])) == 0
    turned = rectangle(an_object(length=1, width=1, yaw=45), np.zeros(3))
    square = rectangle(an_object(length=1, width=1, yaw=0), np.zeros(3))
    octagon = 2 * np.sqrt(2) - 2
    assert area(clip(turned, square)) == pytest.approx(octagon)


def test_objects_are_matched_once_and_measured() -> None:
    truth = a_truth()
    larger = an_object(0.1, 0, 2.2, 1.0, 1.35)
    stray = an_object(-3, -2, number=7)
    found = figures(
        evaluate_site(replace(a_map(truth), objects=(stray, larger, an_object(0.05, 0.3, number=9))), truth)
    )
    assert found["object_recall"] == 50
    assert found["object_precision"] == pytest.approx(100 / 3)
    assert found["object_1_skip_length_error"] == pytest.approx(10)
    assert found["object_1_skip_height_error"] == pytest.approx(-10)
    assert found["object_size_relative_error"] == pytest.approx(100 * (0.1 + 0 + 0.1) / 3)
    assert np.isnan(found["object_size_relative_error_resolved"])  # 1 m is 10 GSD here
    assert figures(evaluate_site(a_map(truth), replace(truth, views=())))["object_size_relative_error_resolved"] == 0
    assert match((larger,), truth.objects, np.array([50.0, 0, 0])) == []


def test_true_height_is_bilinear_and_unknown_outside() -> None:
    truth = a_truth()
    x, y = np.array([0.03, -3.95, 9.0]), np.array([0.21, 2.95, 0.0])
    z = true_height(truth, x, y)
    np.testing.assert_allclose(z[:2], 0.3 * x[:2] - 0.2 * y[:2] + 1, atol=1e-6)
    assert np.isnan(z[2])


def test_a_file_that_is_no_truth_is_refused(tmp_path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        load_truth(tmp_path / "none.npz")
    np.savez(tmp_path / "odd.npz", west=1)
    with pytest.raises(InputError, match="'north'"):
        load_truth(tmp_path / "odd.npz")
    (tmp_path / "text.npz").write_text("no")
    with pytest.raises(InputError, match="cannot be read"):
        load_truth(tmp_path / "text.npz")
    with pytest.raises(InputError, match=r"map\.nc"):
        evaluate_site(tmp_path, a_truth())
