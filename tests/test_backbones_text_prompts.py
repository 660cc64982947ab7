"""Prompts and the merging of instances: light parts of the text-prompted segmenters, without torch."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from excavatwin.backbones import catalogue
from excavatwin.backbones.lattices import Fit, fit
from excavatwin.backbones.protocols import Picture
from excavatwin.backbones.segmenters import sight
from excavatwin.backbones.segmenters.instances import Tally
from excavatwin.backbones.segmenters.prompts import CHANNELS, prompts_text, read_prompts, shipped_prompts
from excavatwin.errors import InputError, MissingExtraError
from excavatwin.scene.taxonomy import K, TaskClass

TEXT_SEGMENTERS = ("yoloe", "sam3", "grounded-sam", "clipseg")


def vote(**weights: float) -> np.ndarray:
    names = [*[one.name.lower() for one in TaskClass][1:], "no_surface", "nothing"]
    row = np.zeros(CHANNELS, np.float32)
    for name, weight in weights.items():
        row[names.index(name)] = weight
    return row


def written(tmp_path: Path, text: str) -> str:
    path = tmp_path / "own.toml"
    path.write_text(text)
    return str(path)


def test_shipped_prompts_cover_every_task_class_and_the_sky() -> None:
    assert "excavation" in shipped_prompts()
    prompts = read_prompts("excavation")
    assert (prompts.votes[:, :K].sum(0) > 0).all()
    by_text = dict(zip(prompts.texts, prompts.votes, strict=True))
    assert by_text["digger arm"].argmax() == TaskClass.EXCAVATOR - 1
    assert by_text["traffic cone"].argmax() == TaskClass.OBSTACLE - 1
    assert by_text["sky"].argmax() == K
    assert (prompts.votes.sum(1) == 1).all()


def test_a_copy_of_the_shipped_text_is_the_shipped_set(tmp_path: Path) -> None:
    copy = read_prompts(written(tmp_path, prompts_text("excavation")))
    assert copy.texts == read_prompts("excavation").texts
    assert copy.identity() == read_prompts("excavation").identity()


def test_weights_and_identity(tmp_path: Path) -> None:
    text = '[prompts]\nexcavator = {"excavator" = 1.0, "crane" = 0.5}\nnothing = ["shadow"]\n'
    soft = read_prompts(written(tmp_path, text))
    assert soft.texts == ("excavator", "crane", "shadow")
    assert soft.name == "own"
    assert soft.votes[1].tolist() == vote(excavator=0.5).tolist()
    assert soft.votes[2].tolist() == vote(nothing=1).tolist()
    harder = read_prompts(written(tmp_path, text.replace("0.5", "0.6")))
    assert soft.identity() != harder.identity()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[prompts]\nmachine = ["excavator"]', "'machine' is not a task class.*excavator.*no_surface"),
        ("[prompts]\nexcavator = []", "excavator has no prompts"),
        (
            '[prompts]\nexcavator = ["digger"]\nobstacle = ["Digger "]',
            "'Digger ' stands for excavator and for obstacle",
        ),
        ('[prompts]\nexcavator = ["digger", "digger"]', "stands for excavator and for excavator"),
        ("[prompts]\nexcavator = [3]", "contains 3"),
        ('[prompts]\nexcavator = ["  "]', "contains '  '"),
        ('[prompts]\nexcavator = {"digger" = 0}', "weight of 'digger' is 0"),
        ('[prompts]\nexcavator = {"digger" = 1.5}', "weight of 'digger' is 1.5"),
        ('[prompts]\nexcavator = "digger"', r"write excavator = \["),
        ('excavator = ["digger"]', r"no table \[prompts\]"),
        ("excavator =", "not valid TOML"),
    ],
)
def test_wrong_prompts_are_refused(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        read_prompts(written(tmp_path, text))


def test_unknown_set_names_the_shipped_ones() -> None:
    with pytest.raises(InputError, match=r"neither a readable TOML file nor one of the shipped sets: .*excavation"):
        read_prompts("quarry")


def test_one_instance_is_its_mask_times_its_score() -> None:
    tally, mask = Tally.empty((3, 4)), np.zeros((3, 4), bool)
    mask[1, 2] = True
    tally.claim_instance(vote(excavator=1), mask, 0.75)
    seen = tally.segmentation()
    expected = np.zeros((3, 4, K), np.float32)
    expected[1, 2, TaskClass.EXCAVATOR - 1] = 0.75
    np.testing.assert_allclose(seen.evidence, expected, atol=2e-6)
    assert not seen.no_surface.any()
    assert seen.doubts == ()


def test_repeated_detections_of_a_class_do_not_add_up() -> None:
    tally, everywhere = Tally.empty((1, 1)), np.ones((1, 1), bool)
    for _ in range(5):
        tally.claim_instance(vote(construction_terrain=1), everywhere, 0.6)
    assert tally.segmentation().evidence[0, 0, 0] == pytest.approx(0.6, abs=1e-5)


def test_contradiction_is_shared_by_odds_and_never_exceeds_the_strongest() -> None:
    tally, everywhere = Tally.empty((1, 1)), np.ones((1, 1), bool)
    tally.claim_instance(vote(excavator=1), everywhere, 0.9)
    tally.claim_instance(vote(obstacle=1), everywhere, 0.5)
    evidence = tally.segmentation().evidence[0, 0]
    assert evidence[TaskClass.EXCAVATOR - 1] == pytest.approx(0.81, abs=1e-5)  # odds 9 : 1 share 0.9
    assert evidence[TaskClass.OBSTACLE - 1] == pytest.approx(0.09, abs=1e-5)


def test_soft_votes_of_one_claim_do_not_compete_with_each_other() -> None:
    tally = Tally.empty((1, 1))
    tally.claim_instance(vote(construction_terrain=0.5, other_terrain=0.5), np.ones((1, 1), bool), 0.8)
    np.testing.assert_allclose(tally.segmentation().evidence[0, 0, :2], [0.4, 0.4], atol=1e-5)


def test_sky_takes_the_pixel_and_nothing_takes_evidence() -> None:
    tally = Tally.empty((1, 3))
    tally.claim(vote(obstacle=1), np.full((1, 3), 0.5, np.float32))
    tally.claim(vote(no_surface=1), np.array([[0.9, 0.3, 0.0]], np.float32))
    tally.claim(vote(nothing=1), np.array([[0.0, 0.0, 0.5]], np.float32))
    seen = tally.segmentation()
    assert seen.no_surface.tolist() == [[True, False, False]]
    assert seen.evidence[0, 0].sum() == 0
    assert seen.evidence[0, 2, TaskClass.OBSTACLE - 1] == pytest.approx(0.25, abs=1e-5)


def test_an_empty_picture_is_said() -> None:
    assert Tally.empty((2, 2)).segmentation().doubts == ("none of its prompts was found in the photo.",)


@given(
    arrays(np.float32, (6, 2, 3), elements=st.floats(0, 1, width=32)),
    arrays(np.float32, (6,), elements=st.floats(0, 1, width=32)),
)
def test_evidence_is_always_in_range(beliefs: np.ndarray, weights: np.ndarray) -> None:
    tally = Tally.empty((2, 3))
    for index, (belief, weight) in enumerate(zip(beliefs, weights, strict=True)):
        row = np.zeros(CHANNELS, np.float32)
        row[index] = weight
        tally.claim(row, belief)
    evidence = tally.segmentation().evidence
    assert evidence.dtype == np.float32
    assert (evidence >= 0).all()
    assert (evidence.sum(-1) <= 1).all()
    assert (evidence.sum(-1) <= beliefs.max(0) + 1e-5).all()


FITS = {
    "letterbox, odd": sight.letterbox((37, 23), 96, 32),
    "letterbox, portrait": sight.letterbox((19, 61), 128, 32),
    "cornered": sight.cornered((45, 30), 64),
    "stretch": fit((33, 21), (56, 56), "stretch"),
    "bounded": sight.bounded((41, 27), 40, 50),
}


@pytest.mark.parametrize("known", FITS.values(), ids=FITS.keys())
@pytest.mark.parametrize("coarser", [1, 2, 4])
def test_masks_come_back_without_a_shift(known: Fit, coarser: int) -> None:
    """A linear ramp over the network's input is reproduced exactly by bilinear sampling, so a shift would show."""
    height, width = known.shape[0] // coarser, known.shape[1] // coarser
    steps_x, steps_y = known.shape[1] / width, known.shape[0] / height
    x, y = (np.arange(width) + 0.5) * steps_x, (np.arange(height) + 0.5) * steps_y
    ramp = x[None, :] + 100 * y[:, None]
    back = sight.returned(ramp.astype(np.float32), known)
    assert back.shape == known.size[::-1]
    cols, rows = np.meshgrid(np.arange(known.size[0]) + 0.5, np.arange(known.size[1]) + 0.5)
    u, v = np.moveaxis(np.stack([cols, rows, np.ones_like(cols)], -1) @ known.affine.T, -1, 0)
    inside = (u > x[0]) & (u < x[-1]) & (v > y[0]) & (v < y[-1])
    assert inside.mean() > 0.6
    np.testing.assert_allclose(back[inside], (u + 100 * v)[inside], rtol=1e-4)


def test_a_square_lands_on_exactly_its_pixels() -> None:
    known = sight.letterbox((40, 30), 160, 32)  # scale 4, masks at a quarter: one mask cell is one pixel
    logits = np.full((known.shape[0] // 4, known.shape[1] // 4), -1.0, np.float32)
    top = known.offset[1] // 4
    logits[top + 5 : top + 9, 7:12] = 1
    mask = sight.returned(logits, known) > 0
    expected = np.zeros((30, 40), bool)
    expected[5:9, 7:12] = True
    assert (mask == expected).all()


def test_boxes_go_there_and_back() -> None:
    boxes = np.array([[1.5, 2, 20, 18.25], [0, 0, 37, 23]])
    for known in FITS.values():
        np.testing.assert_allclose(sight.from_input(sight.to_input(boxes, known), known), boxes, atol=1e-12)
    known = FITS["letterbox, odd"]
    assert sight.to_input(boxes, known)[1, :2].tolist() == list(known.offset)


@pytest.mark.parametrize("smooth", [True, False])
def test_pictures_are_shown_where_the_affine_says(smooth: bool) -> None:
    image = np.zeros((23, 37, 3), np.uint8)
    image[10:14, 20:26] = (250, 120, 10)
    known = FITS["letterbox, odd"]
    seen = sight.shown(image, known, fill=114, smooth=smooth)
    assert seen.shape == (*known.shape, 3)
    assert (seen[: known.offset[1]] == 114).all()
    weight = seen[known.offset[1] : known.offset[1] + known.resized[1], :, 0].astype(float)
    rows, cols = np.indices(weight.shape) + 0.5
    centre = (cols * weight).sum() / weight.sum(), (rows * weight).sum() / weight.sum() + known.offset[1]
    expected = known.affine @ (23, 12, 1)
    np.testing.assert_allclose(centre, expected, atol=0.05)
    assert seen[round(expected[1]), round(expected[0])].tolist() == [250, 120, 10]


@pytest.mark.parametrize("image", [np.zeros((4, 4), np.uint8), np.zeros((4, 4, 3)), np.zeros((0, 4, 3), np.uint8)])
def test_wrong_images_are_refused(image: np.ndarray) -> None:
    with pytest.raises(InputError, match=r"segmenter sam3 needs an RGB image"):
        sight.checked(image, "sam3")


@pytest.mark.parametrize("name", TEXT_SEGMENTERS)
def test_cards(name: str) -> None:
    card = catalogue.entry("segmenter", name).card()
    assert card.name == name
    assert card.kind == "segmenter"
    assert card.install
    assert card.modules
    assert card.argument == "weights"
    assert card.weights
    segmenter = catalogue.make("segmenter", f"{name}:/nowhere/at-all")
    assert segmenter.weights == "/nowhere/at-all"


def test_terms_are_stated() -> None:
    assert catalogue.entry("segmenter", "yoloe").card().licence == "AGPL-3.0"
    assert not catalogue.entry("segmenter", "yoloe").card().commercial
    assert catalogue.entry("segmenter", "sam3").card().weights[0].gated


@pytest.mark.parametrize("name", TEXT_SEGMENTERS)
def test_without_its_library_it_says_what_to_install(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    segmenter = catalogue.make("segmenter", name)
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    line = re.escape(segmenter.card.install)
    with pytest.raises(MissingExtraError, match=f"segmenter {name} needs torch.*run: {line}"):
        segmenter(Picture(np.zeros((4, 4, 3), np.uint8)))


@pytest.mark.parametrize("name", TEXT_SEGMENTERS)
def test_without_weights_it_says_how_to_get_them(name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    segmenter = catalogue.make("segmenter", name)
    for module in segmenter.card.modules:
        pytest.importorskip(module, reason="needs torch: make test-backbones")
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path))
    with pytest.raises(InputError, match=r"are not on this machine; (add --download|run: hf download)"):
        segmenter(Picture(np.zeros((4, 4, 3), np.uint8)))


@pytest.mark.parametrize("name", TEXT_SEGMENTERS)
def test_wrong_pictures_are_refused(name: str) -> None:
    with pytest.raises(InputError, match=f"segmenter {name} needs an RGB image"):
        catalogue.make("segmenter", name)(Picture(np.zeros((4, 4, 4), np.uint8)))


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        ("yoloe", {"score": 1.5}),
        ("yoloe", {"long_side": 600}),
        ("sam3", {"score": -0.1}),
        ("grounded-sam", {"short_side": 900, "long_side": 800}),
        ("clipseg", {"threshold": 2}),
    ],
)
def test_parameters_outside_their_range_are_refused(name: str, fields: dict[str, float]) -> None:
    with pytest.raises(InputError, match="expected"):
        catalogue.entry("segmenter", name).load()(**fields)


def test_importing_the_adapters_imports_no_model_library() -> None:
    modules = ", ".join(catalogue.SHIPPED["segmenter"][name].partition(":")[0] for name in TEXT_SEGMENTERS)
    code = f"import sys, {modules}; assert not {{'torch', 'transformers', 'ultralytics', 'cv2'}} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
