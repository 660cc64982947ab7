"""Flights: where drones are, what they see, and that equal seeds fly equal ways."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from excavatwin.errors import InputError
from excavatwin.simulation.flights import FLIGHTS, hover, lawnmower


@given(name=st.sampled_from(sorted(FLIGHTS)), views=st.integers(2, 40), seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=40)
def test_flights_have_as_many_photos_as_asked_for_and_repeat(name, views, seed) -> None:
    cameras, again = FLIGHTS[name](views, 64, seed), FLIGHTS[name](views, 64, seed)
    assert len(cameras) == views
    for camera, twin in zip(cameras, again, strict=True):
        np.testing.assert_array_equal(camera.T_M_cam, twin.T_M_cam)
        R = camera.T_M_cam[:3, :3]
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-9)
        assert np.linalg.det(R) == pytest.approx(1)
        assert R[2, 2] < 0  # looks down
        assert 8 < camera.T_M_cam[2, 3] < 30
        assert (camera.width, camera.height) == (64, 48)
    other = FLIGHTS[name](views, 64, seed + 1)
    assert not np.array_equal(cameras[0].T_M_cam, other[0].T_M_cam)


def test_neighbours_of_a_lawnmower_overlap_as_asked() -> None:
    cameras = lawnmower(overlap=(0.7, 0.6), tilt=0, jitter=0)
    places = np.array([camera.T_M_cam[:3, 3] for camera in cameras])
    camera = cameras[0]
    along = np.linalg.norm(places[1] - places[0])
    shown = camera.height / camera.focal * places[0, 2]
    assert 0.7 <= 1 - along / shown < 0.78  # at least as asked
    sides = np.unique(places[:, 0].round(6))
    assert 0.6 <= 1 - np.diff(sides).max() / (camera.width / camera.focal * places[0, 2]) < 0.75
    np.testing.assert_allclose(np.array([c.T_M_cam[:3, 2] for c in cameras]), [[0, 0, -1]] * len(cameras), atol=1e-12)
    assert np.abs(places[:, :2]).max() == pytest.approx(13)


def test_a_tilted_lawnmower_looks_forwards() -> None:
    first, second = lawnmower(tilt=20, jitter=0)[:2]
    step = second.T_M_cam[:3, 3] - first.T_M_cam[:3, 3]
    axis = first.T_M_cam[:3, 2]
    assert np.rad2deg(np.arccos(-axis[2])) == pytest.approx(20)
    assert axis @ step > 0


def test_a_hovering_drone_stays_and_looks_at_the_site() -> None:
    cameras = hover(200, drift=0.4, seed=3)
    places = np.array([camera.T_M_cam[:3, 3] for camera in cameras])
    assert 0.2 < places.std(0).mean() < 0.6
    assert np.hypot(*places.mean(0)[:2]) == pytest.approx(20, abs=0.5)
    middle = places.mean(0)
    aim = np.array([camera.T_M_cam[:3, 2] for camera in cameras]).mean(0)
    assert aim @ (-middle / np.linalg.norm(middle)) > 0.999


def test_impossible_flights_are_refused() -> None:
    with pytest.raises(InputError, match="overlap"):
        lawnmower(overlap=(1.0, 0.5))
    for flight in FLIGHTS.values():
        with pytest.raises(InputError, match="at least 2"):
            flight(1, 64, 0)
