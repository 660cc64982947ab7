"""Geometry like VGGT's: right up to a similarity without its errors, and each error does what its field says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import emulated_views
from emulated_views import CAMERAS, SITE, agreement, by_cell
from excavatwin.errors import InputError
from excavatwin.scene.frames import project
from excavatwin.simulation import look_at, render_view
from excavatwin.simulation.camera import Camera
from excavatwin.simulation.emulators import (
    Exact,
    Mask2FormerLike,
    VggtLike,
    YoloeLike,
    emulate_views,
    true_similarity,
)

PERFECT = VggtLike(
    rotation=0, translation=0, focal=0, depth_warp=0, bend=0, noise=0, edge=0, reach=1e6, confidence_correlation=1
)  # fmt: skip


@pytest.fixture(scope="module")
def views():
    return emulated_views.true_views()


@pytest.fixture(scope="module")
def horizon():
    return emulated_views.horizon()


def errors(geometry, views, seed=3):
    """Errors of every point [m] after the best similarity, (S, H, W, 3)."""
    observations = geometry(views, CAMERAS, seed)
    T = true_similarity(observations, views)
    return np.array(
        [a.points @ T[:3, :3].T + T[:3, 3] - b.points for a, b in zip(observations.views, views, strict=True)]
    )


def rms(values):
    return float(np.sqrt(np.nanmean(np.square(values))))


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


def test_views_without_any_surface_are_refused() -> None:
    up = Camera(40, 30, 30.0, look_at(np.array([0, 0, 30.0]), np.array([1, 0, 60.0])))
    with pytest.raises(InputError, match="no view shows any surface"):
        VggtLike()([render_view(SITE, up, samples=0)], [up], 0)
