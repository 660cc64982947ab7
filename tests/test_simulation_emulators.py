"""Emulators of frozen models: seeded, right when told to be, and each error does what its field says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from excavatwin.errors import InputError
from excavatwin.scene.frames import project
from excavatwin.scene.taxonomy import K, TaskClass
from excavatwin.simulation import DigSite, look_at, orbit, render_view
from excavatwin.simulation.camera import Camera
from excavatwin.simulation.emulators import (
    Exact,
    Mask2FormerLike,
    VggtLike,
    YoloeLike,
    emulate,
    emulate_views,
    true_similarity,
)
from excavatwin.simulation.emulators.fields import anchored, footprint, patches

SITE = DigSite(cell=0.1, margin=4.0)
CAMERAS = orbit(4, width=260, aspect=392 / 518)
PERFECT = VggtLike(
    rotation=0, translation=0, focal=0, depth_warp=0, bend=0, noise=0, edge=0, reach=1e6, confidence_correlation=1
)  # fmt: skip
SEGMENTERS = (YoloeLike(), Mask2FormerLike())


@pytest.fixture(scope="module")
def views():
    return tuple(render_view(SITE, camera, samples=0) for camera in CAMERAS)


@pytest.fixture(scope="module")
def horizon():
    """A view with sky in it."""
    camera = Camera(200, 150, 160.0, look_at(np.array([20.0, 5.0, 4.0]), np.array([0, 0, 3.0])))
    view = render_view(SITE, camera, samples=0)
    assert 0.05 < np.isnan(view.depth).mean() < 0.9
    return view, camera


def errors(geometry, views, seed=3):
    """Errors of every point [m] after the best similarity, (S, H, W, 3)."""
    observations = geometry(views, CAMERAS, seed)
    T = true_similarity(observations, views)
    return np.array(
        [a.points @ T[:3, :3].T + T[:3, 3] - b.points for a, b in zip(observations.views, views, strict=True)]
    )


def by_cell(views, values, cell=0.5):
    """Mean of ``values`` (S, H, W) on ground cells, (S, cells); NaN where a view does not see one."""
    out = []
    for view, value in zip(views, values, strict=True):
        use = np.isfinite(value) & (np.abs(view.points[..., :2]) < 15).all(-1)
        col, row = np.floor((view.points[use][:, :2] + 15) / cell).astype(int).T
        flat, n = row * int(30 / cell) + col, int(30 / cell) ** 2
        count = np.bincount(flat, minlength=n)
        out.append(np.where(count > 2, np.bincount(flat, value[use], n) / np.maximum(count, 1), np.nan))
    return np.array(out)


def agreement(first, second):
    """Correlation of two arrays where both are finite."""
    use = np.isfinite(first) & np.isfinite(second)
    assert use.sum() > 200
    return np.corrcoef(first[use], second[use])[0, 1]


def rms(values):
    return float(np.sqrt(np.nanmean(np.square(values))))


# -- whole emulations ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("segmenter", SEGMENTERS)
def test_the_same_seed_gives_the_same_observations_and_another_seed_others(segmenter) -> None:
    first, again, other = (emulate(SITE, CAMERAS[:2], VggtLike(), segmenter, seed) for seed in (5, 5, 6))
    for a, b, c in zip(first.observations.views, again.observations.views, other.observations.views, strict=True):
        for name in ("points", "confidence", "evidence", "T_R_cam", "K_cam"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        assert not np.array_equal(a.points, c.points, equal_nan=True)
        assert not np.array_equal(a.evidence, c.evidence)
    np.testing.assert_array_equal(first.T_M_R, again.T_M_R)


@pytest.mark.parametrize("segmenter", SEGMENTERS)
def test_more_views_do_not_change_the_errors_of_the_first_ones(segmenter, views) -> None:
    few, many = segmenter(views[:2], CAMERAS[:2], 4), segmenter(views, CAMERAS, 4)
    np.testing.assert_array_equal(few[1], many[1])


def test_images_come_along_when_they_are_rendered() -> None:
    coloured = emulate(SITE, CAMERAS[:1], Exact(), YoloeLike(), 0, samples=1)
    np.testing.assert_array_equal(coloured.observations.views[0].image, coloured.views[0].image)
    assert emulate(SITE, CAMERAS[:1], Exact(), YoloeLike(), 0).observations.views[0].image is None
    assert "VggtLike" not in coloured.observations.source["reconstructor"]
    assert "YoloeLike" in coloured.observations.source["segmenter"]


# -- geometry --------------------------------------------------------------------------------------------------------


def test_without_errors_the_true_similarity_recovers_every_point(views) -> None:
    made = emulate_views(views, CAMERAS, PERFECT, YoloeLike(), 3)
    observations, T = made.observations, made.T_M_R
    assert observations.up is None
    assert observations.metres_per_unit is None
    np.testing.assert_allclose(observations.views[0].T_R_cam, np.eye(4), atol=1e-12)  # the first camera's frame
    for seen, true, camera in zip(observations.views, views, CAMERAS, strict=True):
        np.testing.assert_allclose(seen.points @ T[:3, :3].T + T[:3, 3], true.points, atol=2e-4)
        pose = T @ seen.T_R_cam
        pose[:3, :3] /= np.cbrt(np.linalg.det(T[:3, :3]))
        np.testing.assert_allclose(pose, camera.T_M_cam, atol=1e-5)
    distance = np.concatenate([np.linalg.norm(v.points, axis=-1).ravel() for v in observations.views]).mean()
    assert 0.4 < distance < 2.5  # scale is arbitrary, near the mean distance


def test_true_geometry_is_true(views) -> None:
    made = emulate_views(views, CAMERAS, Exact(), Mask2FormerLike(), 3)
    np.testing.assert_allclose(made.T_M_R, np.eye(4), atol=1e-6)
    assert made.observations.metres_per_unit == 1
    np.testing.assert_array_equal(made.observations.views[1].points, views[1].points)


def test_points_lie_on_their_own_pixels_whatever_the_errors(views) -> None:
    for view in VggtLike(vertical_compression=3.0)(views, CAMERAS, 3).views:
        uv, depth = project(view.K_cam, view.T_R_cam, view.points.reshape(-1, 3))
        v, u = np.mgrid[: view.shape[0], : view.shape[1]] + 0.5
        ok = np.isfinite(depth)
        assert ok.mean() > 0.9
        np.testing.assert_allclose(uv[ok], np.stack([u.ravel(), v.ravel()], -1)[ok], atol=0.02)


@pytest.mark.parametrize(
    ("field", "small", "large"),
    [
        ("rotation", 0.1, 0.5),
        ("translation", 0.001, 0.005),
        ("focal", 0.002, 0.01),
        ("depth_warp", 0.002, 0.01),
        ("bend", 0.002, 0.01),
        ("noise", 0.001, 0.005),
        ("edge", 1.0, 3.0),
        ("vertical_compression", 1.2, 3.0),
    ],
)
def test_each_error_grows_with_its_field_and_is_alone(views, field, small, large) -> None:
    none, few, many = (
        rms(errors(replace(PERFECT, **{field: x}), views)) for x in (getattr(PERFECT, field), small, large)
    )
    assert none < 2e-4
    assert 10 * none < few < 0.7 * many


def test_views_drift_by_about_four_thousandths_of_the_distance(views) -> None:
    error = errors(VggtLike(), views)
    relative = np.linalg.norm(error, axis=-1) / np.array([view.depth for view in views])
    assert 0.0015 < np.nanmedian(relative) < 0.006
    assert 0.02 < np.nanmean(np.abs(error[..., 2])) < 0.25  # metres, at some 28 m


def test_the_bend_is_the_same_in_every_view_and_the_warp_is_not(views) -> None:
    bent = by_cell(views, errors(replace(PERFECT, bend=0.005), views)[..., 2])
    warped = by_cell(views, errors(replace(PERFECT, depth_warp=0.005), views)[..., 2])
    assert agreement(bent[0], bent[2]) > 0.9
    assert agreement(warped[0], warped[2]) < 0.5


def test_noise_grows_with_distance(views) -> None:
    error = np.abs(errors(replace(PERFECT, noise=0.003), views)).max(-1)
    depth = np.array([view.depth for view in views])
    near, far = depth < np.quantile(depth, 0.2), depth > np.quantile(depth, 0.8)
    ratio = np.median(depth[far]) / np.median(depth[near])
    assert np.median(error[far]) / np.median(error[near]) > 0.8 * ratio**2  # relative noise itself grows


def test_flying_pixels_lie_at_depth_edges_between_front_and_back(views) -> None:
    import cv2

    observations = replace(PERFECT, edge=1.5)(views, CAMERAS, 3)
    T = true_similarity(observations, views)
    scale = np.cbrt(np.linalg.det(T[:3, :3]))
    moved_share = []
    for seen, true in zip(observations.views, views, strict=True):
        depth = scale * project(seen.K_cam, seen.T_R_cam, seen.points.reshape(-1, 3))[1].reshape(seen.shape)
        moved = np.abs(depth / true.depth - 1) > 0.01
        low, high = (f(true.depth, np.ones((9, 9))) for f in (cv2.erode, cv2.dilate))
        assert (high[moved] > 1.02 * low[moved]).all()
        assert ((depth >= 0.999 * low) & (depth <= 1.001 * high)).all()
        moved_share.append(moved.mean())
    assert 0.002 < np.mean(moved_share) < 0.2


def test_confidence_is_at_least_one_and_ranks_errors_loosely(views) -> None:
    from scipy.stats import spearmanr

    found = {}
    for rho in (0.0, 0.6, 0.95):
        geometry = replace(PERFECT, noise=0.002, depth_warp=0.002, edge=1.5, confidence_correlation=rho)
        error = np.linalg.norm(errors(geometry, views), axis=-1).ravel()
        confidence = np.array([view.confidence for view in geometry(views, CAMERAS, 3).views]).ravel()
        assert confidence.min() >= 1
        found[rho] = spearmanr(confidence, error).statistic
    assert abs(found[0.0]) < 0.1
    assert -0.65 < found[0.6] < -0.25
    assert found[0.95] < found[0.6] - 0.1


def test_vertical_compression_flattens_the_site(views) -> None:
    observations = replace(PERFECT, vertical_compression=4.0)(views, CAMERAS, 3)
    T, T_true = true_similarity(observations, views), true_similarity(PERFECT(views, CAMERAS, 3), views)
    np.testing.assert_allclose(T[:3, :3] @ np.linalg.inv(T_true[:3, :3]), np.eye(3), atol=0.15)
    z = np.concatenate([(v.points @ T_true[:3, :3].T + T_true[:3, 3])[..., 2].ravel() for v in observations.views])
    true = np.concatenate([view.points[..., 2].ravel() for view in views])
    gone = np.abs(true) > 1.0
    assert 0.15 < np.median(z[gone] / true[gone]) < 0.45


def test_nothing_is_declared_unless_asked_for(views) -> None:
    told = replace(PERFECT, declare_scale=0.01, declare_up=0.5)
    errors_of_scale, tilts = [], []
    for seed in range(12):
        observations = told(views[:1], CAMERAS[:1], seed)
        T = true_similarity(observations, views[:1])
        s = np.cbrt(np.linalg.det(T[:3, :3]))
        errors_of_scale.append(np.log(observations.metres_per_unit / s))
        tilts.append(np.degrees(np.arccos(np.clip(observations.up @ (T[:3, :3].T / s)[:, 2], -1, 1))))
    assert 0.003 < rms(errors_of_scale) < 0.02
    assert 0.2 < rms(tilts) < 1.5


def test_the_sky_and_what_is_too_far_have_no_points(horizon) -> None:
    view, camera = horizon
    (seen,) = VggtLike(reach=4.0)([view], [camera], 0).views
    deep = ~(view.depth <= 4 * np.nanmedian(view.depth))
    np.testing.assert_array_equal(np.isnan(seen.points).any(-1), deep)
    assert (seen.confidence[deep] == 1).all()


# -- evidence --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("segmenter", [*SEGMENTERS, YoloeLike.goose_ex(), Mask2FormerLike.goose_ex()])
def test_evidence_is_in_range_and_the_sky_has_none(segmenter, views, horizon) -> None:
    view, camera = horizon
    (looked,) = segmenter([view], [camera], 1)
    assert not looked[np.isnan(view.depth)].any()
    for seen in (looked, *segmenter(views, CAMERAS, 1)):
        assert seen.dtype == np.float32
        assert seen.shape[-1] == K
        assert seen.min() >= 0
        assert seen.max() <= 1
    if isinstance(segmenter, Mask2FormerLike):
        assert looked.sum(-1).max() < 1 + 1e-5
    else:
        reported = looked[looked > 0]
        assert reported.size == 0 or reported.min() >= segmenter.threshold


def test_errors_that_stick_are_the_same_in_every_view_and_fresh_ones_are_not(views) -> None:
    soil = np.array([view.label == TaskClass.CONSTRUCTION_TERRAIN for view in views])
    found = {}
    for share in (0.0, 0.5, 1.0):
        evidence = np.array(replace(Mask2FormerLike(), sticky=share, border=0.3)(views, CAMERAS, 2))
        cells = by_cell(views, np.where(soil, evidence[..., 0], np.nan))
        found[share] = np.mean([agreement(cells[i], cells[j]) for i, j in ((0, 1), (0, 2), (1, 3))])
    assert abs(found[0.0]) < 0.25
    assert 0.25 < found[0.5] < 0.75
    assert found[1.0] > 0.9


def test_what_a_detector_always_misses_or_mistakes_depends_on_the_thing_alone(views) -> None:
    detector = YoloeLike(
        things=2, machines=2, growth=0, sticky=1, mistaken=0.5, missing=0, stuff=0, ghosts=0, luck=3, border=0
    )
    called: dict[int, set[int]] = {}
    for view, evidence in zip(views, detector(views, CAMERAS, 5), strict=True):
        for key in np.unique(view.instance[view.instance > 0]):
            on = evidence[view.instance == key]
            if len(on) > 150:
                called.setdefault(int(key), set()).add(int(np.median(np.where(on.max(-1) > 0, on.argmax(-1) + 1, 0))))
    assert len(called) >= 5
    assert all(len(classes) == 1 for classes in called.values())
    assert len(set().union(*called.values())) >= 2


def test_a_perfect_detector_reports_the_things_and_nothing_else(views) -> None:
    detector = YoloeLike(
        things=9, machines=9, plants=-99, growth=0, luck=0, mistaken=0, missing=0, stuff=0, ghosts=0, border=0
    )
    for view, evidence in zip(views, detector(views, CAMERAS, 5), strict=True):
        found = np.where(evidence.max(-1) > 0, evidence.argmax(-1) + 1, 0)
        np.testing.assert_array_equal(found, np.where(view.instance > 0, view.label, 0))
        assert evidence.max() == np.float32(0.95)


def test_detections_and_their_flaws_grow_with_their_fields(views) -> None:
    def share(**fields) -> float:
        quiet = dict.fromkeys(("luck", "growth", "mistaken", "missing", "stuff", "ghosts", "border"), 0.0)
        quiet |= {"things": 2.0, "machines": 2.0, "plants": -99.0}
        evidence = np.array(YoloeLike(**(quiet | fields))(views, CAMERAS, 5))
        return float((evidence.max(-1) > 0).mean())

    plain = share()
    assert share(things=-9.0) < share(things=0.0, luck=1.0) < plain
    assert share(things=-9.0, machines=-9.0) == 0
    assert share(plants=9.0) > plain
    assert share(stuff=2.0) > plain
    assert share(ghosts=2.0) > plain
    assert share(missing=0.5) < share(missing=0.2) < plain


def test_a_perfect_dense_segmenter_is_right_and_skill_decides_how_often_another_is(views) -> None:
    true = np.array([view.label for view in views])

    def right(**fields) -> float:
        found = np.array(replace(Mask2FormerLike(), **fields)(views, CAMERAS, 5)).argmax(-1) + 1
        return float((found == true).mean())

    assert right(skill=9, spread=0, border=0, small=0, nothing=-9) > 0.995
    assert right(skill=0) < right(skill=1.5) < right(skill=4)
    assert right(spread=3.0) < right(spread=0.5)


def test_a_dense_segmenter_is_worse_far_away_and_its_scores_claim_too_much(views) -> None:
    true = np.array([view.label for view in views])
    size = np.array([footprint(view, camera) for view, camera in zip(views, CAMERAS, strict=True)])
    evidence = np.concatenate([np.array(Mask2FormerLike()(views, CAMERAS, seed))[None] for seed in range(6)])
    right, score = evidence.argmax(-1) + 1 == true, evidence.max(-1)
    soil = np.broadcast_to(true == TaskClass.CONSTRUCTION_TERRAIN, right.shape)
    near, far = soil & (size < np.quantile(size, 0.3)), soil & (size > np.quantile(size, 0.7))
    assert right[near].mean() > right[far].mean() + 0.03
    assert score[right].mean() > score[~right].mean() + 0.03
    assert score.mean() > right.mean() + 0.05


def test_small_things_are_lost_in_their_surroundings(views) -> None:
    kept = {}
    for small in (1.0, 1e5):
        evidence = np.array(replace(Mask2FormerLike(), spread=0, skill=5, small=small)(views, CAMERAS, 5))
        on = np.array([view.instance > 0 for view in views])
        kept[small] = float((evidence[on].argmax(-1) + 1 >= TaskClass.EXCAVATOR).mean())
    assert kept[1.0] > 0.7 > kept[1e5] + 0.4


def test_fields_have_unit_spread_and_forget_themselves_over_their_wavelength(views) -> None:
    drawn = patches((400, 500), 40.0, np.random.default_rng(0), 4)
    assert 0.85 < drawn.std() < 1.15
    assert abs(np.mean(drawn[:, :-80] * drawn[:, 80:])) < 0.15 < 0.7 < np.mean(drawn[:, :-4] * drawn[:, 4:])
    world = np.stack(np.meshgrid(np.arange(0, 60, 0.2), np.arange(0, 60, 0.2), [0.3]), -1).reshape(300, 300, 3)
    held = anchored(world.astype(np.float32), 4.0, 1, 3)
    assert 0.8 < held.std() < 1.2
    assert abs(np.mean(held[:, :-40] * held[:, 40:])) < 0.15


@pytest.mark.parametrize(
    ("part", "wrong"), [(VggtLike, {"rotation": -1}), (VggtLike, {"confidence_correlation": 2}),
                        (YoloeLike, {"sticky": 1.5}), (Mask2FormerLike, {"world_patch": 0.0})],
)  # fmt: skip
def test_parameters_out_of_range_are_refused_by_name(part, wrong) -> None:
    with pytest.raises(InputError, match=f"{part.__name__}.{next(iter(wrong))}"):
        part(**wrong)


def test_views_without_any_surface_are_refused() -> None:
    up = Camera(40, 30, 30.0, look_at(np.array([0, 0, 30.0]), np.array([1, 0, 60.0])))
    with pytest.raises(InputError, match="no view shows any surface"):
        VggtLike()([render_view(SITE, up, samples=0)], [up], 0)
