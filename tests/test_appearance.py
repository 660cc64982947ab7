"""The appearance segmenter: each class on patches that look like it, laws, and real photos where they are present."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from excavatwin.backbones.appearance import Appearance
from excavatwin.backbones.protocols import Picture
from excavatwin.errors import InputError
from excavatwin.scene.taxonomy import TaskClass

CT, OT, RC, EX, OB = (int(c) - 1 for c in tuple(TaskClass)[1:])
DATA = Path(os.environ.get("EXCAVATWIN_DATA", Path(__file__).parents[2] / "shared" / "data"))
SOIL, ASPHALT, TURF, CROWN = (150, 122, 92), (118, 118, 121), (104, 138, 70), (60, 92, 48)


def ground(rgb: tuple[int, int, int], roughness: float, shape=(240, 320), grain: int = 2, seed: int = 0) -> np.ndarray:
    """A patch of one colour whose brightness varies by ``roughness`` (log) in blotches of ``grain`` px."""
    rng = np.random.default_rng(seed)
    blotches = rng.normal(0, roughness, (shape[0] // grain + 1, shape[1] // grain + 1))
    shading = np.exp(np.kron(blotches, np.ones((grain, grain)))[: shape[0], : shape[1], None])
    return np.clip(np.array(rgb) * shading + rng.normal(0, 1.5, (*shape, 3)), 0, 255).astype(np.uint8)


def best(image: np.ndarray, rows: slice = slice(20, -20), cols: slice = slice(20, -20)) -> tuple[int, float]:
    """Strongest channel of a region's mean evidence, and that mean."""
    mean = Appearance()(Picture(image)).evidence[rows, cols].mean((0, 1))
    return int(mean.argmax()), float(mean.max())


@pytest.mark.parametrize(
    ("rgb", "roughness", "expected"),
    [
        (SOIL, 0.15, CT),
        ((205, 180, 140), 0.05, CT),  # sand
        ((92, 72, 55), 0.2, CT),  # wet clay
        (ASPHALT, 0.03, OT),
        ((190, 190, 188), 0.02, OT),  # concrete slab that fills the photo
        (CROWN, 0.45, RC),
    ],
)
def test_surfaces(rgb, roughness, expected):
    channel, strength = best(ground(rgb, roughness))
    assert channel == expected
    assert strength > 0.4


def test_turf_is_shared_between_ground_and_cover():
    evidence = Appearance()(Picture(ground(TURF, 0.03))).evidence[20:-20, 20:-20].mean((0, 1))
    assert evidence[OT] == pytest.approx(evidence[RC], abs=0.15)
    assert evidence[[OT, RC]].sum() > 0.8


def test_machine_on_soil():
    image = ground(SOIL, 0.12)
    image[90:150, 120:200] = (225, 165, 30)
    image[100:130, 130:160] = (40, 45, 52)  # glass
    image[150:166, 115:205] = (52, 50, 50)  # track
    evidence = Appearance()(Picture(image)).evidence
    assert evidence[95:145, 165:195, EX].mean() > 0.7
    assert evidence[152:164, 130:190, EX].mean() > 0.4
    assert evidence[:60, :, EX].mean() < 0.02


THINGS = [(185, 196, 208), (200, 40, 45), (40, 80, 190), (235, 120, 170), (60, 190, 80)]


@pytest.mark.parametrize(
    ("colour", "around"),
    [(c, SOIL) for c in THINGS] + [(c, TURF) for c in THINGS[:-1]],  # green on grass cannot be told by colour
)
def test_things_on_the_ground(colour, around):
    image = ground(around, 0.08)
    image[100:135, 140:190] = colour
    evidence = Appearance()(Picture(image)).evidence
    assert evidence[104:131, 144:186, OB].mean() > 0.5
    assert evidence[:70, :, OB].mean() < 0.05


def test_sky_and_water_are_abstained_on():
    photo = ground(CROWN, 0.4, grain=5)
    photo[:80] = np.linspace((250, 251, 255), (235, 241, 252), 80)[:, None]
    result = Appearance()(Picture(photo))
    assert result.no_surface[:70].mean() > 0.98
    assert result.no_surface[100:].mean() < 0.01
    shore = ground(SOIL, 0.15)
    shore[120:] = ground((70, 84, 78), 0.004)[120:]
    result = Appearance()(Picture(shore))
    assert result.no_surface[135:].mean() > 0.95
    assert result.no_surface[:110].mean() < 0.01
    assert not result.evidence[result.no_surface].any()


@pytest.mark.parametrize("colour", [SOIL, ASPHALT, TURF, (236, 232, 226)])
def test_ground_that_fills_the_photo_is_neither_sky_nor_water(colour):
    assert not Appearance()(Picture(ground(colour, 0.06))).no_surface.any()


def test_sky_detection_can_be_turned_off():
    photo = np.full((120, 160, 3), 255, np.uint8)
    assert Appearance()(Picture(photo)).no_surface.all()
    assert not Appearance(sky=False)(Picture(photo)).no_surface.any()


def test_exposure_and_vignetting_keep_labels():
    image = ground(SOIL, 0.12)
    image[:, 200:] = ground(TURF, 0.05)[:, 200:]
    image[100:140, 60:110] = (185, 196, 208)
    label = Appearance()(Picture(image)).evidence.argmax(-1)
    y, x = np.mgrid[-1:1:240j, -1:1:320j]
    vignette = 1 - 0.35 * (x**2 + y**2)[..., None]
    for other in (image * 0.55, image * vignette):
        assert (Appearance()(Picture(other.astype(np.uint8))).evidence.argmax(-1) == label).mean() > 0.9


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 90), st.integers(1, 90), st.sampled_from([0, 30, 128]))
def test_laws(seed, height, width, low):
    image = np.random.default_rng(seed).integers(low, 256, (height, width, 3)).astype(np.uint8)
    first, second = Appearance()(Picture(image)), Appearance()(Picture(image))
    assert first.evidence.shape == (height, width, 5)
    assert first.evidence.dtype == np.float32
    assert first.no_surface.shape == (height, width)
    assert np.isfinite(first.evidence).all()
    assert first.evidence.min() >= 0
    assert first.evidence.sum(-1).max() <= 1 + 1e-5
    assert not first.evidence[first.no_surface].any()
    assert np.array_equal(first.evidence, second.evidence)
    assert np.array_equal(first.no_surface, second.no_surface)


def test_large_photos_are_worked_on_small_and_given_back_large():
    image = ground(SOIL, 0.1, (900, 1200), grain=8)
    result = Appearance()(Picture(image))
    assert result.evidence.shape == (900, 1200, 5)
    assert best(image)[0] == CT


@pytest.mark.parametrize("image", [np.zeros((4, 4), np.uint8), np.zeros((4, 4, 4), np.uint8), np.zeros((4, 4, 3))])
def test_other_arrays_are_refused(image):
    with pytest.raises(InputError, match="RGB image"):
        Appearance()(Picture(image))


# Boxes (x0, y0, x1, y1) at 640 px long side, chosen by looking at the photos.
REAL = [
    ("caliterra_site/images/IMG_9404.jpg", (385, 130, 410, 200), OB, "concrete pipes"),
    ("caliterra_site/images/IMG_9404.jpg", (245, 442, 280, 460), EX, "excavator"),
    ("caliterra_site/images/IMG_9420.jpg", (463, 386, 481, 396), EX, "excavator"),
    ("caliterra_site/images/IMG_9420.jpg", (20, 150, 120, 400), RC, "trees"),
    ("caliterra_site/images/IMG_9420.jpg", (320, 300, 370, 450), CT, "spoil heaps"),
    ("caliterra_site/images/IMG_9404.jpg", (205, 355, 240, 390), CT, "gravel cone"),
    ("caliterra_site/images/IMG_9414.jpg", (460, 390, 468, 425), OB, "pickup truck"),
    ("lewis_oblique/images/img_4116.jpg", (180, 190, 330, 240), CT, "sand ring"),
    ("lewis_oblique/images/img_4116.jpg", (50, 40, 560, 80), RC, "forest"),
    ("lewis_oblique/images/img_4116.jpg", (480, 150, 600, 250), OT, "mown field"),
    ("brighton_beach/images/DJI_0031.jpg", (10, 150, 50, 300), OT, "asphalt"),
    ("brighton_beach/images/DJI_0022.jpg", (100, 100, 350, 300), RC, "forest"),
    ("brighton_beach/images/DJI_0031.jpg", (415, 126, 438, 140), OB, "car"),
    ("sandpile_oppaiyama/images/IMG_6790.jpg", (220, 110, 290, 200), CT, "sand heap"),
    ("sandpile_oppaiyama/images/IMG_6853.jpg", (345, 288, 380, 308), OB, "red toy"),
    ("orfd_y0613/images/1623721491895.jpg", (100, 220, 200, 340), OT, "pale gravel road"),
]


def real_photo(name: str) -> np.ndarray:
    path = DATA / name
    if not path.exists():
        pytest.skip(f"shared data not present: {name}")
    photo = Image.open(path)
    return np.array(photo.resize((640, round(640 * photo.height / photo.width)), Image.Resampling.LANCZOS))


@pytest.mark.parametrize(("name", "box", "channel", "what"), REAL)
def test_real_photos(name, box, channel, what):
    x0, y0, x1, y1 = box
    evidence = Appearance()(Picture(real_photo(name))).evidence[y0:y1, x0:x1]
    assert evidence.mean((0, 1)).argmax() == channel, what
    assert (evidence.argmax(-1) == channel).mean() > 0.5, what


def test_real_sky_and_water():
    sky = Appearance()(Picture(real_photo("lewis_oblique/images/img_4234.jpg"))).no_surface
    assert sky[5:30, 5:120].all()
    assert sky[100:].mean() == 0
    road = Appearance()(Picture(real_photo("orfd_y0613/images/1623721491895.jpg"))).no_surface
    assert road[5:90, 5:60].all()
    assert road[140:].mean() == 0
    lake = Appearance()(Picture(real_photo("brighton_beach/images/DJI_0031.jpg"))).no_surface
    assert lake[280:340, 530:620].mean() > 0.9
    assert lake[:, :380].mean() == 0


@pytest.mark.parametrize("number", [9400, 9404, 9407, 9414, 9420, 9430])
def test_a_nadir_dig_site_has_neither_sky_nor_water(number):
    assert Appearance()(Picture(real_photo(f"caliterra_site/images/IMG_{number}.jpg"))).no_surface.mean() < 0.002
