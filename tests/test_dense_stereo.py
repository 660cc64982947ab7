"""Dense stereo on a rendered dig site with exact truth, and the laws of its consistency check."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dense_scene import cameras, dig_site, look_at, photograph
from excavatwin.backbones.photogrammetry.consistency import agree, drop_speckles, transfer
from excavatwin.backbones.photogrammetry.dense import Dense, densify
from excavatwin.backbones.photogrammetry.placement import PosedImage, SparsePoints
from excavatwin.backbones.photogrammetry.sources import choose_sources, pair_scores
from excavatwin.backbones.photogrammetry.sweep import PlaneFamily, grey_pyramid, level_geometry, plane_family, rays
from excavatwin.scene.frames import project


def plane_depth(image: PosedImage, z: float) -> np.ndarray:
    """Exact depth of the horizontal plane at height z."""
    ray = rays(image.K_cam, image.T_R_cam, image.image.shape[:2])
    return ((z - image.T_R_cam[2, 3]) / ray[..., 2]).astype(np.float32)


def blank(K: np.ndarray, T: np.ndarray, width: int = 64) -> PosedImage:
    return PosedImage("x.jpg", np.zeros((width * 3 // 4, width, 3), np.uint8), K, T)


@pytest.fixture(scope="module")
def orbit():
    return photograph(dig_site(n=640), "oblique", 6, 160)


def test_the_warp_of_a_plane_is_its_homography():
    (K, T_a), (_, T_b) = cameras("oblique", 12, 64)[:2]
    a, b = blank(K, T_a), blank(K, T_b)
    family = PlaneFamily(np.array([0, 0, 1.0]), 1 / 30, 1 / 20)
    pyramids = [grey_pyramid(image, 1) for image in (a, b)]
    level = level_geometry(a, [b], pyramids, 0, family)
    for distance in (22.0, 28.0):
        z = T_a[2, 3] - distance
        point = T_a[:3, 3] + rays(K, T_a, (48, 64)) * plane_depth(a, z)[..., None]
        expected, _ = project(K, T_b, point)
        y, x = np.mgrid[:48, :64] + 0.5
        q = np.stack([x, y, np.ones_like(x)], -1) @ level.M[0].T + (level.slope / distance)[..., None] * level.t[0]
        np.testing.assert_allclose(q[..., :2] / q[..., 2:], expected, atol=2e-3)


def test_exact_depth_maps_confirm_each_other_and_stay_as_they_are():
    images = [blank(*camera) for camera in cameras("nadir", 9, 64)]
    depths = [plane_depth(image, 0.0) for image in images]
    votes, agreed = agree(4, [1, 3, 5, 7], images, depths, 1.0, 0.01)
    assert votes[24, 32] == 4
    np.testing.assert_allclose(agreed, depths[4], rtol=1e-4)


def test_shifted_depth_maps_do_not_confirm():
    images = [blank(*camera) for camera in cameras("nadir", 9, 64)]
    depths = [plane_depth(image, 0.0) for image in images]
    depths[3] = depths[3] * 1.05
    depths[5] = np.full_like(depths[5], np.nan)
    votes, _ = agree(4, [1, 3, 5, 7], images, depths, 1.0, 0.01)
    assert votes.max() == 2
    votes, agreed = agree(4, [3, 5], images, depths, 1.0, 0.01)
    assert votes.max() == 0
    np.testing.assert_allclose(agreed, depths[4], rtol=1e-6)


def test_the_agreed_depth_lies_between_the_views():
    images = [blank(*camera) for camera in cameras("nadir", 9, 64)]
    depths = [plane_depth(image, 0.0) for image in images]
    depths[4] = plane_depth(images[4], 0.1)
    _, agreed = agree(4, [3], images, depths, 1.0, 0.01)
    np.testing.assert_allclose(agreed[24, 32], plane_depth(images[4], 0.05)[24, 32], rtol=1e-4)


def test_transfer_is_undone_by_its_reverse():
    (K, T_a), (_, T_b) = cameras("oblique", 12, 64)[:2]
    M, t = transfer(blank(K, T_a), blank(K, T_b))
    N, n = transfer(blank(K, T_b), blank(K, T_a))
    p = np.array([10.5, 20.5, 1.0]) * 30.0
    np.testing.assert_allclose(N @ (M @ p + t) + n, p, atol=1e-9)


def test_speckles_go_and_surfaces_stay():
    depth = np.full((20, 30), 10.0, np.float32)
    depth[5:7, 5:7] = 14.0
    clean = drop_speckles(depth, 0.01, 10)
    assert np.isnan(clean[5:7, 5:7]).all()
    assert np.isfinite(clean).sum() == 600 - 4


def test_sources_stand_on_several_sides_and_see_the_same(orbit):
    images, sparse, _ = orbit
    scores = pair_scores(images, sparse, 3.0, 14.0, 35.0)
    assert (np.diag(scores) == 0).all()
    chosen = choose_sources(0, scores, images, 2)
    assert sorted(chosen) == [1, 5]


def test_planes_are_horizontal_unless_the_camera_looks_along_the_ground(orbit):
    images, sparse, _ = orbit
    family = plane_family(images[0], sparse.xyz[sparse.visible[0]], 0.3, 12.0)
    assert family is not None
    np.testing.assert_array_equal(family.normal, [0, 0, 1])
    assert 1 / family.w_near < images[0].T_R_cam[2, 3] < 1 / family.w_far
    K = images[0].K_cam
    low = blank(K, look_at(np.array([-20.0, 0, 1.0]), np.array([0, 0, 0.5])))
    points = np.random.default_rng(0).uniform([-5, -5, 0], [5, 5, 3], (200, 3))
    tilted = plane_family(low, points, 0.3, 12.0)
    assert tilted is not None
    assert tilted.normal[2] < 0.9
    assert plane_family(low, points[:3], 0.3, 12.0) is None


def test_a_dig_site_is_found_within_a_fraction_of_the_sampling_distance(orbit):
    images, sparse, truth = orbit
    steps: list[tuple[str, int, int]] = []
    result = densify(images, sparse, replace(Dense(), views_oblique=2), lambda *step: steps.append(step))
    errors, cover, sky = [], [], []
    for image, exact, (depth, support) in zip(images, truth, result, strict=True):
        assert depth.dtype == support.dtype == np.float32
        assert ((support > 0) == np.isfinite(depth)).all()
        errors.append((np.abs(depth - exact) / (exact / image.K_cam[0, 0]))[np.isfinite(depth) & np.isfinite(exact)])
        cover.append(np.isfinite(depth)[np.isfinite(exact)].mean())
        sky.append(np.isfinite(depth)[~np.isfinite(exact)].mean())
    error = np.concatenate(errors)
    assert np.mean(cover) > 0.6
    assert np.median(error) < 0.5
    assert np.quantile(error, 0.9) < 2.5
    assert max(sky) < 0.1
    assert steps[-1] == ("depth consistency", 6, 6)


def test_the_result_does_not_depend_on_threads(orbit):
    images, sparse, _ = orbit
    one = densify(images, sparse, replace(Dense(), threads=1))
    two = densify(images, sparse, replace(Dense(), threads=3))
    for (a, _), (b, _) in zip(one, two, strict=True):
        np.testing.assert_array_equal(a, b)


def test_grey_photos_and_lonely_photos_get_no_depth(orbit):
    images, sparse, _ = orbit
    grey = [replace(image, image=np.full_like(image.image, 140)) for image in images]
    assert all(np.isnan(depth).all() for depth, _ in densify(grey, sparse))
    alone = SparsePoints(sparse.xyz, (sparse.visible[0],))
    [(depth, support)] = densify(images[:1], alone)
    assert np.isnan(depth).all()
    assert (support == 0).all()


def test_pixels_without_a_photo_get_no_depth(orbit):
    images, sparse, _ = orbit
    valid = np.ones(images[0].image.shape[:2], np.uint8)
    valid[:, :40] = 0
    result = densify([replace(images[0], valid=valid), *images[1:]], sparse, replace(Dense(), views_oblique=2))
    assert np.isnan(result[0][0][:, :40]).all()
    assert np.isfinite(result[0][0][:, 40:]).mean() > 0.3


def test_sizes_may_differ(orbit):
    images, sparse, truth = orbit
    cropped = replace(images[1], image=np.ascontiguousarray(images[1].image[:100, :140]))
    result = densify([images[0], cropped, *images[2:]], sparse, replace(Dense(), views_oblique=2))
    assert result[1][0].shape == (100, 140)
    both = np.isfinite(result[1][0]) & np.isfinite(truth[1][:100, :140])
    assert np.median(np.abs(result[1][0] - truth[1][:100, :140])[both]) < 0.5 * 40 / images[1].K_cam[0, 0]
