"""Which photos are worth a network's time: frames of a video are thinned, blur goes where nothing is lost by it."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from emulated_network import Flight, down
from excavatwin.backbones.sequence.overlaps import glance, overlap, sharpness
from excavatwin.backbones.sequence.selection import Selection, in_order
from excavatwin.capture import find_photos, read_photo
from excavatwin.errors import InputError
from excavatwin.scene.photo import Photo

SHAPE = (180, 240)
WIDE = 25.0
"""Width of the ground in a photo from 20 m [m]."""


def straight(count: int, step: float) -> np.ndarray:
    return np.array([down(step * i, 0, 0, tilt=0) for i in range(count)])


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    """A slow flight: 0.4 m a frame, 98 % of which the next frame shows again; 1.9 m are a tenth of a frame."""
    return Flight(straight(24, 0.4), tmp_path_factory.mktemp("video"), SHAPE)


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    """A survey flight: 5 m a photo, of 19 m that it shows."""
    return Flight(straight(10, 5.0), tmp_path_factory.mktemp("survey"), SHAPE)


def blurred(photo: Photo, folder: Path, length: int) -> Photo:
    """The same photo, smeared along its rows."""
    path = folder / photo.name
    Image.fromarray(cv2.blur(read_photo(photo), (length, 1))).save(path)
    return replace(photo, path=path)


@pytest.mark.parametrize("step", [0.5, 2.0, 6.0, 10.0])
def test_overlap_is_that_of_the_ground(tmp_path: Path, step: float) -> None:
    flight = Flight(np.array([down(x, 0, 90, tilt=0) for x in (0.0, step)]), tmp_path, SHAPE)
    found = overlap(glance(flight.image(0)), glance(flight.image(1)))
    assert found == pytest.approx(1 - step / WIDE, abs=0.04)


def test_overlap_survives_a_turn_and_knows_strangers(tmp_path: Path) -> None:
    flight = Flight(np.array([down(0, 0, 0, tilt=0), down(0, 0, 180, tilt=0), down(40, 30, 0)]), tmp_path, SHAPE)
    a, turned, elsewhere = (glance(flight.image(i)) for i in range(3))
    assert overlap(a, turned) > 0.93
    assert np.isnan(overlap(a, elsewhere))


def test_pictures_without_features_are_equal_or_unknown() -> None:
    grey = np.full((90, 120, 3), 90, np.uint8)
    assert overlap(glance(grey), glance(grey)) == 1
    assert np.isnan(overlap(glance(grey), glance(grey + 60)))


@pytest.mark.parametrize("kernel", [(9, 1), (1, 9), (5, 5)])
def test_blur_of_any_direction_is_seen_and_darkness_is_none(survey: Flight, kernel: tuple[int, int]) -> None:
    grey = cv2.cvtColor(survey.image(0), cv2.COLOR_RGB2GRAY)
    assert sharpness(cv2.blur(grey, kernel)) < 0.3 * sharpness(grey)
    assert sharpness((grey * 0.6).astype(np.uint8)) == pytest.approx(sharpness(grey), rel=0.15)


def test_a_video_is_thinned_to_frames_that_add_something(video: Flight) -> None:
    chosen = Selection()(video.photos)
    names = [photo.name for photo in chosen.photos]
    assert 4 <= len(names) <= 6
    assert names == sorted(names)
    assert len(chosen.unplaced) == 24 - len(names)
    assert all("adds nothing" in one.reason for one in chosen.unplaced)
    glances = [glance(read_photo(photo)) for photo in chosen.photos]
    shared = [overlap(a, b) for a, b in pairwise(glances)]
    assert min(shared) > 0.6
    assert max(shared) <= 0.9


def test_sparse_photos_are_all_kept(survey: Flight, shared_data: Path) -> None:
    assert Selection()(survey.photos).unplaced == ()
    photos = find_photos(shared_data / "caliterra_site" / "images")[:20]
    assert Selection()(photos).photos == in_order(photos)


def test_a_blurred_photo_goes_where_its_neighbours_bridge_the_gap(survey: Flight, tmp_path: Path) -> None:
    photos = [blurred(p, tmp_path, 11) if i == 4 else p for i, p in enumerate(survey.photos)]
    chosen = Selection()(photos)
    assert [one.name for one in chosen.unplaced] == ["photo_0004.png"]
    assert "blurred" in chosen.unplaced[0].reason


def test_a_blurred_photo_stays_where_it_is_the_only_one(tmp_path: Path) -> None:
    flight = Flight(straight(6, 7.0), tmp_path / "far", SHAPE)  # two steps leave 25 % in common
    photos = [blurred(p, tmp_path, 11) if i == 3 else p for i, p in enumerate(flight.photos)]
    assert Selection()(photos).unplaced == ()


def test_most_thins_evenly(survey: Flight) -> None:
    chosen = Selection(most=4)(survey.photos)
    assert [photo.name for photo in chosen.photos] == [f"photo_{i:04d}.png" for i in (0, 3, 6, 9)]
    assert all("selection.most" in one.reason for one in chosen.unplaced)


def test_nothing_is_measured_when_nothing_is_asked_for(survey: Flight) -> None:
    gone = [replace(photo, path=Path("/nowhere.png")) for photo in survey.photos]
    assert len(Selection(overlap=1.0, sharpness=0.0)(gone).photos) == 10
    with pytest.raises(InputError, match="cannot be decoded"):
        Selection()(gone)


def test_no_photo_and_nonsense_are_refused() -> None:
    with pytest.raises(InputError, match="no photo"):
        Selection()([])
    with pytest.raises(InputError, match=r"Selection\.overlap"):
        Selection(overlap=2.0)
