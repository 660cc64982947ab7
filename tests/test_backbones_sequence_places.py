"""Loops that are closed, the upright frame, lattices of mixed photos, and how many photos fit into memory."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from emulated_network import Emulated, Flight, line, ring
from excavatwin.backbones.device import Device
from excavatwin.backbones.sequence.framing import framing
from excavatwin.backbones.sequence.memory import MOST, room
from excavatwin.backbones.sequence.network import Network, Prediction
from excavatwin.errors import InputError
from excavatwin.scene.frames import umeyama
from excavatwin.scene.observations import Observations
from excavatwin.scene.photo import Gimbal, GpsFix, Photo
from excavatwin.scene.progress import silent

EAST, NORTH = 587600.0, 3338100.0  # UTM 14N


@pytest.fixture(scope="module")
def round_trip(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    """A flight around a circle of 100 m; its last three photos show what the first three show."""
    return Flight(ring(30, 16.0), tmp_path_factory.mktemp("ring"), (96, 128))


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    return Flight(line(12), tmp_path_factory.mktemp("line"))


def camera_error(obs: Observations, flight: Flight) -> float:
    centres = np.array([v.centre for v in obs.views])
    s, R, t = umeyama(centres, flight.poses[:, :3, 3], np.ones(len(centres)))
    return float(np.linalg.norm(s * centres @ R.T + t - flight.poses[:, :3, 3], axis=1).max())


def test_closing_the_loop_takes_the_drift_out(round_trip: Flight, tmp_path: Path) -> None:
    found = {}
    for loops in (0, 1):
        model = replace(Emulated(flight=round_trip, tilt=5e-4, depth_error=0.002, lattice=128).with_chunks(8, 3, loops))
        folder = tmp_path / str(loops)
        folder.mkdir()
        found[loops] = model(round_trip.photos, silent, folder)
    assert camera_error(found[1], round_trip) < 0.6 * camera_error(found[0], round_trip)
    said = [doubt for doubt in found[1].doubts if "drifted" in doubt]
    assert len(said) == 1
    assert found[1].source["loops"].startswith("1 of")
    assert "were not looked for" in " ".join(found[0].doubts)
    assert len(list((tmp_path / "1").iterdir())) == 3  # the joint prediction is gone, too


def test_without_drift_a_loop_changes_nothing(round_trip: Flight, tmp_path: Path) -> None:
    obs = Emulated(flight=round_trip, lattice=128).with_chunks(8, 3, 1)(round_trip.photos, silent, tmp_path)
    assert camera_error(obs, round_trip) < 1e-3


def test_a_line_has_no_loop(flight: Flight, tmp_path: Path) -> None:
    obs = Emulated(flight=flight).with_chunks(4, 2, 1)(flight.photos, silent, tmp_path)
    assert obs.source["loops"].startswith("0 of")
    assert any("drift is not known" in doubt for doubt in obs.doubts)


class Dreaming(Emulated):
    """Where it is asked about both ends of a flight at once, it puts them elsewhere."""

    def answer(self, images: np.ndarray) -> Prediction:
        said = super().answer(images)
        if max(np.diff(self.asked[-1])) == 1:
            return said
        second = np.arange(len(images)) > np.argmax(np.diff(self.asked[-1]))
        shift = 0.3 * np.linalg.norm(said.points[0, 0, 0] - said.T_world_cam[0, :3, 3]) * np.ones(3)
        points, T = said.points.copy(), said.T_world_cam.copy()
        points[second] += shift.astype(np.float32)
        T[second, :3, 3] += shift
        return replace(said, points=points, T_world_cam=T)


def test_a_joint_prediction_that_the_pictures_contradict_is_not_believed(round_trip: Flight, tmp_path: Path) -> None:
    model = Dreaming(flight=round_trip, lattice=128).with_chunks(8, 3, 1)
    obs = model(round_trip.photos, silent, tmp_path)
    assert any(max(np.diff(asked)) > 1 for asked in model.asked)  # it was asked
    assert obs.source["loops"].startswith("0 of")
    assert camera_error(obs, round_trip) < 1e-3


def located(flight: Flight, sigma: float = 0.0, gimbal: bool = False) -> list[Photo]:
    """The photos with GPS positions."""
    from pyproj import Transformer

    rng = np.random.default_rng(0)
    at = flight.poses[:, :3, 3] + sigma * rng.normal(size=(len(flight.poses), 3))
    lon, lat = Transformer.from_crs(32614, 4326, always_xy=True).transform(at[:, 0] + EAST, at[:, 1] + NORTH)
    tag = Gimbal(0.0, -78.0, 0.0) if gimbal else None
    return [
        replace(photo, gps=GpsFix(float(lat[i]), float(lon[i]), float(at[i, 2] + 400)), gimbal=tag)
        for i, photo in enumerate(flight.photos)
    ]


def world_error(obs: Observations, flight: Flight) -> float:
    assert obs.georeference is not None
    origin = np.array(obs.georeference.origin) - (EAST, NORTH, 400)
    seen = np.concatenate([np.asarray(v.points[::7, ::7], float).reshape(-1, 3) for v in obs.views]) + origin
    true = np.concatenate([flight.points(i)[::7, ::7].reshape(-1, 3) for i in range(len(obs.views))])
    return float(np.linalg.norm(seen - true, axis=1).max())


def test_gps_gives_the_vertical_metres_and_the_place(round_trip: Flight, tmp_path: Path) -> None:
    """Points, too, are where they belong: to a centimetre on ground 20 m below."""
    obs = Emulated(flight=round_trip, lattice=128).with_chunks(8, 3)(located(round_trip), silent, tmp_path)
    assert obs.metres_per_unit == 1.0
    assert obs.georeference is not None
    assert obs.georeference.epsg == 32614
    assert obs.source["gravity"] == "gps"
    assert world_error(obs, round_trip) < 0.01


def test_gimbal_tags_give_the_vertical(flight: Flight, tmp_path: Path) -> None:
    tagged = [replace(photo, gimbal=Gimbal(0.0, -78.0, 0.0)) for photo in flight.photos]
    obs = Emulated(flight=flight).with_chunks(6)(tagged, silent, tmp_path)
    assert obs.source["gravity"] == "gimbal"
    assert obs.metres_per_unit is None
    up_cam = obs.views[3].T_R_cam[:3, :3].T @ [0, 0, 1.0]
    np.testing.assert_allclose(up_cam, flight.poses[3][:3, :3].T @ [0, 0, 1.0], atol=0.01)


def test_a_metric_network_keeps_its_metres(flight: Flight, tmp_path: Path) -> None:
    obs = Emulated(flight=flight, frames=-1, metric=True).with_chunks(5)(flight.photos, silent, tmp_path)
    assert obs.metres_per_unit == 1.0
    assert obs.georeference is None
    span = np.linalg.norm(obs.views[0].centre - obs.views[-1].centre)
    assert span == pytest.approx(np.linalg.norm(flight.poses[0][:3, 3] - flight.poses[-1][:3, 3]), rel=1e-4)
    assert not any("metres" in doubt for doubt in obs.doubts)


class Overrated(Emulated):
    """A metric network whose metres are 0.8 m, and in every chunk a little different."""

    spread = 0.0

    def answer(self, images: np.ndarray) -> Prediction:
        said = super().answer(images)
        s = float(0.8 * np.exp(self.spread * (-1) ** len(self.asked)))
        T = said.T_world_cam.copy()
        T[:, :3, 3] /= s
        return replace(said, points=said.points / np.float32(s), T_world_cam=T)


def test_metres_that_gps_contradicts_are_said(round_trip: Flight, tmp_path: Path) -> None:
    model = Overrated(flight=round_trip, frames=-1, metric=True, lattice=128).with_chunks(8, 3)
    obs = model(located(round_trip), silent, tmp_path)
    assert any("0.8 times as large as the network" in doubt for doubt in obs.doubts)
    assert world_error(obs, round_trip) < 0.01


def test_metres_that_differ_between_chunks_are_said(flight: Flight, tmp_path: Path) -> None:
    model = Overrated(flight=flight, frames=-1, metric=True).with_chunks(5)
    object.__setattr__(model, "spread", 0.1)
    obs = model(flight.photos, silent, tmp_path)
    assert any("differ between chunks by 10%" in doubt for doubt in obs.doubts)


@dataclass(frozen=True)
class Plain(Emulated):
    """Sees a level plane under cameras in a row, whatever the photos show."""

    def open(self) -> Network:
        return self.plane

    def plane(self, images: np.ndarray) -> Prediction:
        S, H, W = images.shape[:3]
        K = np.array([[W, 0, W / 2], [0, W, H / 2], [0, 0, 1.0]])
        v, u = np.mgrid[:H, :W] + 0.5
        rays = np.stack([(u - W / 2) / W, (v - H / 2) / W, np.ones_like(u)], -1)
        T = np.array([np.eye(4)] * S)
        T[:, 0, 3] = np.arange(S) * 0.1
        points = (rays + T[:, None, None, :3, 3]).astype(np.float32)
        return Prediction(points, np.ones((S, H, W), np.float32), T, np.array([K] * S))


def test_photos_of_another_shape_are_padded_and_padding_is_no_point(tmp_path: Path) -> None:
    photos = []
    for i, (w, h) in enumerate([(320, 240), (320, 240), (240, 320), (640, 480), (320, 160)]):
        path = tmp_path / f"{i}.png"
        Image.fromarray(np.full((h, w, 3), 10 * i, np.uint8)).save(path)
        photos.append(Photo(path.name, path, w, h, str(i)))
    folder = tmp_path / "scratch"
    folder.mkdir()
    obs = Plain(lattice=64).with_chunks(5)(photos, silent, folder)
    framed = framing(photos, 64, 4, "crop")
    assert framed.shape == (48, 64)
    for i, view in enumerate(obs.views):
        np.testing.assert_array_equal(np.isfinite(view.points[..., 0]), framed.fits[i].inside())
        assert view.lattice is not None
        assert view.image is not None
        np.testing.assert_array_equal(view.image[framed.fits[i].inside()], 10 * i)
        assert (view.image[~framed.fits[i].inside()] == 255).all()
        corners = view.lattice.from_photo(np.array([[0.0, 0.0], [photos[i].width, photos[i].height]]))
        rows, cols = np.nonzero(framed.fits[i].inside())
        np.testing.assert_allclose(corners, [[cols.min(), rows.min()], [cols.max() + 1, rows.max() + 1]], atol=1e-9)
        back = np.vstack([view.lattice.affine, [0, 0, 1]]) @ view.lattice.K_photo
        np.testing.assert_allclose(back, view.K_cam)
    assert [bool(np.isnan(view.points).any()) for view in obs.views] == [False, False, True, False, True]
    assert any("2 photos of another shape" in doubt for doubt in obs.doubts)


@dataclass(frozen=True)
class Small(Device):
    """A device with little memory."""

    left: float = 0.0

    def free(self) -> float | None:
        return self.left


@pytest.mark.parametrize(("left", "size"), [(1e9, MOST), (20e6, 17), (2e6, 2)])
def test_as_many_photos_as_fit(flight: Flight, left: float, size: int) -> None:
    model: Any = replace(Emulated(flight=flight), device=Small(left=left))
    found = room(model, (48, 64), 200)
    assert found.size == size
    assert f"{size} of 200 photos at once" in found.sentence(200)
    assert room(model, (48, 64), 2).size == 2


def test_too_little_for_two_photos_is_refused(flight: Flight) -> None:
    with pytest.raises(InputError, match=r"use a smaller --emulated\.lattice"):
        room(replace(Emulated(flight=flight), device=Small(left=1e6)), (48, 64), 200)
