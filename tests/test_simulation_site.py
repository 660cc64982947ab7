"""The simulated site: the same every time, and its truth is the truth of its pictures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from excavatwin.errors import InputError
from excavatwin.scene.frames import project
from excavatwin.scene.taxonomy import NOT_OBSERVED, TaskClass
from excavatwin.simulation import (
    DigSite,
    Earthworks,
    Placement,
    exact_observations,
    look_at,
    models,
    orbit,
    render_view,
    site_truth,
)
from excavatwin.simulation.camera import Camera
from excavatwin.simulation.site import PLACEMENTS, contents

SITE = DigSite(cell=0.1, margin=4.0)
CAMERAS = orbit(3, width=160)


@pytest.fixture(scope="module")
def view():
    return render_view(SITE, CAMERAS[0])


@pytest.fixture(scope="module")
def truth():
    return site_truth(SITE, [("a", CAMERAS[0])], cell=0.1, long_side=80)


def test_a_view_is_the_same_every_time(view) -> None:
    again = render_view(DigSite(cell=0.1, margin=4.0), orbit(3, width=160)[0])
    for name in ("image", "depth", "points", "label", "instance"):
        np.testing.assert_array_equal(getattr(view, name), getattr(again, name))
    other = render_view(replace(SITE, seed=8), CAMERAS[0])
    assert (other.image != view.image).mean() > 0.5


def test_points_lie_on_their_own_pixels_at_their_depth(view) -> None:
    camera = CAMERAS[0]
    uv, z = project(camera.K_cam, camera.T_M_cam, view.points.reshape(-1, 3))
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    seen = np.isfinite(view.depth).ravel()
    assert seen.all()
    np.testing.assert_allclose(uv, np.stack([u.ravel(), v.ravel()], -1), atol=2e-3)
    np.testing.assert_allclose(z, view.depth.ravel(), rtol=1e-5)


def test_truth_needs_no_light(view) -> None:
    dark = render_view(SITE, CAMERAS[0], samples=0, grain=0.0)
    assert not dark.image.any()
    for name in ("depth", "points", "label", "instance"):
        np.testing.assert_array_equal(getattr(dark, name), getattr(view, name))


def test_terrain_points_lie_on_the_true_terrain(view) -> None:
    ground = contents(SITE).ground
    terrain = np.isin(view.label, (TaskClass.CONSTRUCTION_TERRAIN, TaskClass.OTHER_TERRAIN))
    p = view.points[terrain].astype(float)
    p = p[(np.abs(p[:, :2]) < SITE.half - 0.2).all(axis=1)]
    u, v = (p[:, :2].T - ground.west) / ground.cell
    i, j = np.floor(u).astype(int), np.floor(v).astype(int)
    u, v = u - i, v - j
    h = ground.height.astype(float)
    z = (h[j, i] * (1 - u) + h[j, i + 1] * u) * (1 - v) + (h[j + 1, i] * (1 - u) + h[j + 1, i + 1] * u) * v
    assert len(p) > 5000
    assert np.abs(p[:, 2] - z).max() < 2e-3 * SITE.cell / 0.025  # float32 positions on 75 degree walls


def test_the_truth_from_above_agrees_with_the_pictures(view, truth) -> None:
    index = truth.grid.flat_index(view.points.reshape(-1, 3)[:, :2])
    z = view.points[..., 2].ravel()
    on_top = (index >= 0) & (np.abs(z - truth.surface.ravel()[np.maximum(index, 0)]) < 0.05)
    agree = view.label.ravel()[on_top] == truth.label.ravel()[index[on_top]]
    assert on_top.sum() > 3000
    assert agree.mean() > 0.97  # cells that a border crosses
    assert (truth.surface >= truth.height - 1e-4).all()
    flat = truth.instance == 0
    bare = flat & (truth.label != TaskClass.REMOVABLE_COVER)
    np.testing.assert_allclose(truth.surface[bare], truth.height[bare], atol=1e-4)


def test_every_class_and_every_object_is_seen(truth) -> None:
    assert set(np.unique(truth.label)) == {1, 2, 3, 4, 5}
    assert set(np.unique(truth.instance)) == set(range(len(PLACEMENTS) + 1))
    assert truth.views[0].label.shape == (60, 80)


def test_objects_have_the_dimensions_that_they_were_built_with() -> None:
    sizes = {name: o.size for name, o in zip([p.name for p in PLACEMENTS], contents(SITE).objects, strict=True)}
    assert sizes["pickup"] == pytest.approx((5.2, 1.85, 1.78))
    assert sizes["pipes"] == pytest.approx((3.6, 2.2, 0.9))
    assert sizes["skip"] == pytest.approx((3.2, 1.7, 1.35))
    assert sizes["block"] == pytest.approx((1.8, 1.0, 1.0))
    length, width, height = sizes["excavator"]
    assert 4.0 < length < 5.0
    assert 1.5 < width < 1.9
    assert 2.4 < height < 2.7


@pytest.mark.parametrize("yaw", [0.0, 37.0, 90.0, -60.0])
def test_the_box_of_an_object_turns_with_it(yaw) -> None:
    place = Placement("block", TaskClass.OBSTACLE, models.block, 1.0, 2.0, yaw, 1.2)
    site = DigSite(extent=8, margin=3, cell=0.2, placements=(place,), vegetation=0)
    (box,) = contents(site).objects
    assert box.size == pytest.approx((1.8, 1.0, 1.0))
    assert box.centre[:2] == pytest.approx((1.0, 2.0))
    assert (box.yaw - yaw + 90) % 180 - 90 == pytest.approx(0, abs=1e-6)
    assert -90 <= box.yaw < 90
    assert box.z_top - box.z_base == pytest.approx(1.0)


def test_the_heap_stands_at_its_angle_of_repose_and_the_pit_is_deep() -> None:
    works = Earthworks(slope=(0.0, 0.0), relief=0.0, roughness=0.0)
    bare = DigSite(cell=0.1, margin=4.0, earthworks=works, placements=(), vegetation=0)
    ground = contents(bare).ground
    assert ground.height.min() == pytest.approx(-works.pit_depth, abs=1e-6)
    assert ground.height.max() == pytest.approx(works.heap_height, abs=0.02)
    slope = np.hypot(*np.gradient(ground.height.astype(float), ground.cell))
    on_flank = (ground.height > 0.3) & (ground.height < 1.2)
    assert np.rad2deg(np.arctan(np.median(slope[on_flank]))) == pytest.approx(works.repose, abs=1.5)
    assert np.rad2deg(np.arctan(slope.max())) > 55  # the pit's walls, across one cell


def test_above_the_horizon_there_is_sky() -> None:
    camera = Camera(40, 30, 30.0, look_at(np.array([0.0, -20.0, 6.0]), np.array([0.0, 0.0, 6.0])))
    view = render_view(SITE, camera)
    assert (view.label[:5] == NOT_OBSERVED).all()
    assert np.isnan(view.points[:5]).all()
    assert (view.label[-5:] != NOT_OBSERVED).all()
    assert (view.image[:5, :, 2] > 200).all()


def test_observations_in_another_frame_describe_the_same_site(view) -> None:
    turn = models.turn_z(0.7) @ np.array([[1, 0, 0], [0, 0, -1.0], [0, 1, 0]])
    t = np.array([3.0, -2.0, 9.0])
    obs = exact_observations(SITE, CAMERAS[:1], metres_per_unit=0.25, R_R_M=turn, t_R_M=t)
    seen = obs.views[0]
    uv, z = project(seen.K_cam, seen.T_R_cam, seen.points.reshape(-1, 3))
    v, u = np.mgrid[:120, :160] + 0.5
    np.testing.assert_allclose(uv, np.stack([u.ravel(), v.ravel()], -1), atol=5e-3)
    assert (z > 0).all()
    back = ((seen.points - t) @ turn * 0.25).reshape(view.points.shape)
    np.testing.assert_allclose(back, view.points, atol=1e-4)
    np.testing.assert_allclose(obs.up, turn[:, 2])
    assert obs.metres_per_unit == 0.25
    np.testing.assert_array_equal(seen.evidence.argmax(-1) + 1, view.label)


def test_observations_err_by_the_amount_that_was_asked_for(view) -> None:
    (noisy,) = exact_observations(SITE, CAMERAS[:1], range_noise=0.002, wrong=0.3, declare=False).views
    error = np.linalg.norm(noisy.points - view.points, axis=-1) / np.linalg.norm(
        view.points - CAMERAS[0].T_M_cam[:3, 3], axis=-1
    )
    assert np.sqrt((error**2).mean()) == pytest.approx(0.002, rel=0.05)
    assert 0.1 < (noisy.evidence.argmax(-1) + 1 != view.label).mean() < 0.3
    with pytest.raises(ValueError, match="evidence"):
        exact_observations(SITE, CAMERAS[:1], evidence="perfect")


def test_nothing_may_stand_outside_the_site() -> None:
    with pytest.raises(InputError, match="pickup is to stand at"):
        contents(DigSite(extent=18))


def test_the_orbit_looks_at_the_site() -> None:
    for camera in orbit(8, radius=20, height=15, jitter=0):
        forward = camera.T_M_cam[:3, 2]
        np.testing.assert_allclose(forward, -camera.T_M_cam[:3, 3] / 25, atol=1e-12)
        assert camera.T_M_cam[2, 1] < 0  # image down is down
        assert np.linalg.det(camera.T_M_cam[:3, :3]) == pytest.approx(1)
