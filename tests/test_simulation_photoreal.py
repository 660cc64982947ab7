"""Photos by Mitsuba: their truth is that of our own tracer, their geometry closed, their light where it belongs."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from excavatwin.errors import InputError, MissingExtraError
from excavatwin.kernels.irradiance import smoothed
from excavatwin.kernels.laser import returns
from excavatwin.kernels.ray_casting import TUBE_BORE
from excavatwin.scene.frames import project
from excavatwin.scene.taxonomy import TaskClass
from excavatwin.simulation import DigSite, orbit, render_view
from excavatwin.simulation.bodies import Body, Kind, Material
from excavatwin.simulation.conditions import Conditions
from excavatwin.simulation.photoreal import render, seen_from_above
from excavatwin.simulation.photoreal.backend import backend
from excavatwin.simulation.photoreal.foliage import blades, leaves
from excavatwin.simulation.photoreal.meshes import solid
from excavatwin.simulation.photoreal.sky import daylight
from excavatwin.simulation.render import geometry
from excavatwin.simulation.renderers import Fast
from excavatwin.simulation.sensor import bucket_place, smeared
from excavatwin.simulation.site import contents
from excavatwin.simulation.truth import site_truth

pytest.importorskip("mitsuba", reason="Mitsuba is not installed: pip install 'excavatwin[sim]'")

BARE = DigSite(vegetation=0, cell=0.05)
GREEN = DigSite(cell=0.1)
CAMERA = orbit(3, width=96)[1]


@pytest.fixture(scope="module")
def photo():
    return render(GREEN, CAMERA, samples=8)


def test_depth_and_classes_are_those_of_our_own_tracer() -> None:
    by_mitsuba, by_us = render(BARE, CAMERA, samples=0), render_view(BARE, CAMERA, samples=0)
    gap = np.abs(by_mitsuba.depth - by_us.depth)
    assert (gap < 0.005).mean() > 0.99
    assert (by_mitsuba.label == by_us.label).mean() > 0.995
    assert (by_mitsuba.instance == by_us.instance).mean() > 0.995
    truth = site_truth(BARE, cell=0.2)
    surface, label, instance = seen_from_above(BARE, truth.grid)
    assert (np.abs(surface - truth.surface) < 0.005).mean() > 0.99
    assert (label == truth.label).mean() > 0.995
    assert (instance == truth.instance).mean() > 0.995


def test_points_lie_on_their_own_pixels(photo) -> None:
    uv, z = project(CAMERA.K_cam, CAMERA.T_M_cam, photo.points.reshape(-1, 3))
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width] + 0.5
    np.testing.assert_allclose(uv, np.stack([u.ravel(), v.ravel()], -1), atol=2e-3)
    np.testing.assert_allclose(z, photo.depth.ravel(), rtol=1e-5)


def test_a_photo_is_the_same_every_time_and_looks_like_ours(photo) -> None:
    again = render(DigSite(cell=0.1), orbit(3, width=96)[1], samples=8)
    np.testing.assert_array_equal(photo.image, again.image)
    ours = Fast()(GREEN, CAMERA).image
    assert 60 < photo.image.mean() < 150
    likeness = np.corrcoef(photo.image.mean(-1).ravel(), ours.mean(-1).ravel())[0, 1]
    assert likeness > 0.7


def test_leaves_stay_where_their_plants_are(photo) -> None:
    cover = photo.points[photo.label == TaskClass.REMOVABLE_COVER]
    assert len(cover) > 30
    inside = contents(GREEN)
    near = np.zeros(len(cover), bool)
    for body, label in zip(inside.bodies, inside.labels, strict=True):
        if label == TaskClass.REMOVABLE_COVER:
            local = (cover - body.centre) @ body.axes / (body.half + 0.15)
            near |= (np.abs(local) <= 1).all(1)
    assert near.all()


def test_what_the_sun_does_not_reach_is_darker() -> None:
    site = DigSite(vegetation=0, cell=0.1, sun=(180.0, 35.0))
    image = render(site, CAMERA, samples=4).image.astype(float).mean(-1)
    view = render(site, CAMERA, samples=0)
    ground, bodies = geometry(site)
    beams = np.broadcast_to(site.to_sun, (view.label.size, 3))
    start = view.points.reshape(-1, 3).astype(float) + 0.05 * site.to_sun
    free = np.isinf(returns(ground, bodies, contents(site).ground.label, start, beams, 60.0)[0]).reshape(image.shape)
    soil = view.label == TaskClass.CONSTRUCTION_TERRAIN
    assert (soil & ~free).sum() > 30
    assert np.median(image[soil & ~free]) < 0.6 * np.median(image[soil & free])


def test_conditions_do_what_they_say(photo) -> None:
    def image(**changes: float) -> np.ndarray:
        return render(GREEN, CAMERA, samples=4, conditions=Conditions(**changes)).image.astype(float)

    plain = image()
    low = image(sun_elevation=10.0)
    warmth = [np.log(v[..., 0] / np.maximum(v[..., 2], 1))[photo.label == 1] for v in (plain, low)]
    assert np.ptp(np.quantile(warmth[1], [0.1, 0.9])) > 1.3 * np.ptp(np.quantile(warmth[0], [0.1, 0.9]))  # red and blue
    grad = [np.abs(np.diff(v.mean(-1), axis=1)).mean() for v in (plain, image(motion_blur=6.0))]
    assert grad[1] < 0.8 * grad[0]
    assert abs(np.log(image(exposure_drift=1.0).mean() / plain.mean())) > 0.05
    noisy = image(grain=12.0) - image(grain=0.0)
    assert 8 < noisy.std() < 14
    at = bucket_place(contents(GREEN))
    assert at is not None
    changed = np.abs(image(dust=2.0) - plain).mean(-1)
    uv, _ = project(CAMERA.K_cam, CAMERA.T_M_cam, at[None])
    row, col = int(uv[0, 1]), int(uv[0, 0])
    assert changed[row - 2 : row + 3, col - 2 : col + 3].mean() > 15
    assert np.median(changed) < 5  # the cloud is local


@pytest.mark.parametrize("wrong", [{"dust": -1.0}, {"sun_elevation": 0.0}, {"turbidity": 20.0}, {"grain": np.nan}])
def test_conditions_out_of_range_are_refused(wrong) -> None:
    with pytest.raises(InputError, match=next(iter(wrong))):
        Conditions(**wrong)


@given(
    kind=st.sampled_from(list(Kind)),
    half=st.tuples(*[st.floats(0.05, 2.0)] * 2),
    turn=st.floats(0, 6.3),
)
@settings(deadline=None, max_examples=25)
def test_polyhedra_are_closed_and_have_their_bodies_volume(kind, half, turn) -> None:
    axes = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    size = np.array([half[0], half[0], half[1]])
    body = Body(kind, np.array([3.0, -2.0, 1.0]), axes, size, Material.CONCRETE)
    mesh = solid(body, 0)
    a, b, c = np.moveaxis(mesh.vertex[mesh.face].astype(float) - body.centre, 1, 0)
    volume = (a * np.cross(b, c)).sum() / 6  # positive only if every face looks outwards
    share = {Kind.BOX: 8, Kind.CYLINDER: 2 * np.pi, Kind.CONE: 2 * np.pi / 3, Kind.ELLIPSOID: 4 * np.pi / 3}
    share[Kind.TUBE] = 2 * np.pi * (1 - TUBE_BORE**2)
    assert volume == pytest.approx(share[kind] * size.prod(), rel=0.08)
    outward = (np.cross(b - a, c - a) * mesh.normal[mesh.face].mean(1)).sum(-1)
    assert (outward > -1e-9).all()


@given(porosity=st.floats(0.1, 0.8), half=st.floats(0.1, 1.0), seed=st.integers(0, 99))
@settings(deadline=None, max_examples=20)
def test_leaves_and_blades_keep_near_their_ellipsoid(porosity, half, seed) -> None:
    size = np.array([half, 0.8 * half, 0.6 * half])
    body = Body(Kind.ELLIPSOID, np.array([1.0, 2.0, 3.0]), np.eye(3), size, Material.LEAVES, porosity)
    for grow in (leaves, blades):
        grown = grow(body, np.random.default_rng(seed))
        assert np.isfinite(grown).all()
        reach = np.abs(grown - body.centre).max((0, 1)) / size
        assert (reach < 2.0).all()
        fewer = grow(replace(body, porosity=min(1.0, porosity + 0.15)), np.random.default_rng(seed))
        assert len(fewer) <= len(grown)


def test_the_filter_keeps_edges_and_means_and_removes_noise() -> None:
    rng = np.random.default_rng(3)
    depth = np.where(np.arange(64) < 32, 10.0, 14.0) * np.ones((48, 1))
    normal = np.broadcast_to([0.0, 0, -1], (48, 64, 3)).astype(np.float32)
    truth = np.where(depth[..., None] < 12, 1.0, 0.2) * np.ones(3)
    noisy = (truth + rng.normal(0, 0.2, truth.shape)).astype(np.float32)
    out = noisy
    for step in (1, 2, 4):
        out = smoothed(out, depth.astype(np.float32), normal, (depth / 100).astype(np.float32), step, 0.08, 2.0)
    assert np.abs(out - truth).std() < 0.2 * np.abs(noisy - truth).std()
    np.testing.assert_allclose(out[:, 31].mean(), 1.0, atol=0.05)
    np.testing.assert_allclose(out[:, 32].mean(), 0.2, atol=0.05)


def test_smear_keeps_the_light() -> None:
    image = np.zeros((41, 41, 3), np.float32)
    image[20, 20] = 1.0
    out = smeared(image, 9.0, 0.0)
    assert out.sum() == pytest.approx(3.0, rel=1e-5)
    assert (out[20, :, 0] > 1e-3).sum() in (9, 10, 11)
    assert smeared(image, 0.2, 0.0) is image


def test_daylight_is_neutral_at_noon_and_warm_in_the_evening() -> None:
    noon, evening = daylight(180.0, 55.0, 3.0), daylight(260.0, 8.0, 3.0)
    for light in (noon, evening):
        assert (light.sky >= 0).all()
        assert np.isfinite(light.sky).all()
        assert (light.sun > 0).all()
    assert noon.sun[0] / noon.sun[2] < evening.sun[0] / evening.sun[2]
    assert noon.skylight.mean() < 0.5 * noon.sun.mean()


def test_missing_parts_are_named_with_the_line_to_type(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    backend.cache_clear()
    try:
        with pytest.raises(MissingExtraError, match=r'pip install "excavatwin\[sim\]"'):
            backend()
    finally:
        backend.cache_clear()
    code = "from excavatwin.simulation.photoreal.backend import backend; backend()"
    environment = os.environ | {"DRJIT_LIBLLVM_PATH": "/nowhere/libLLVM.so"}
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=False)
    assert run.returncode != 0
    assert "apt install libllvm19" in run.stderr.splitlines()[-1]
