"""Pictures on their way into a network of transformers: sizes, values, windows. No torch needed."""

from __future__ import annotations

import json
import math
import subprocess
import sys

import numpy as np
import pytest

from excavatwin.backbones import extras, weights
from excavatwin.backbones.catalogue import entry, make
from excavatwin.backbones.protocols import Picture
from excavatwin.backbones.segmenters.eomt import Eomt
from excavatwin.backbones.segmenters.mask2former import Mask2Former
from excavatwin.backbones.segmenters.oneformer import OneFormer
from excavatwin.backbones.segmenters.preparation import Preparation, preparation, read_settings
from excavatwin.backbones.segmenters.pretrained import class_names, configuration
from excavatwin.backbones.segmenters.resampling import centres
from excavatwin.backbones.segmenters.segformer import Segformer
from excavatwin.backbones.segmenters.windows import Window, split
from excavatwin.errors import InputError, MissingExtraError
from excavatwin.vocabularies import shipped_vocabularies

ADAPTERS = (Mask2Former, OneFormer, Eomt, Segformer)


def test_importing_the_adapters_imports_no_model_library():
    code = (
        "import sys\n"
        "from excavatwin.backbones.segmenters import eomt, mask2former, oneformer, segformer\n"
        "heavy = {'torch', 'transformers', 'PIL'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("adapter", ADAPTERS)
def test_cards_are_complete_and_stand_in_the_catalogue(adapter):
    card = adapter.card
    assert entry("segmenter", card.name).load() is adapter
    assert make("segmenter", f"{card.name}:owner/name").weights == "owner/name"
    assert card.install == 'pip install "excavatwin[transformers]"'
    assert card.weights
    assert all("/" in one.repo and one.licence for one in card.weights)
    assert all(math.isnan(one.size) or one.size > 1e6 for one in card.weights)
    assert set(adapter.published.values()) <= set(shipped_vocabularies())
    assert set(adapter.published) <= {one.repo for one in card.weights}


@pytest.mark.parametrize("adapter", ADAPTERS)
def test_without_the_library_the_error_gives_the_line_that_installs_it(adapter, monkeypatch):
    monkeypatch.setattr(extras, "_found", lambda module: module != "transformers")
    with pytest.raises(MissingExtraError, match=r'transformers.*pip install "excavatwin\[transformers\]"'):
        adapter()(Picture(np.zeros((8, 8, 3), np.uint8)))


@pytest.mark.parametrize("adapter", ADAPTERS)
def test_without_weights_the_error_tells_both_ways_to_get_them(adapter, monkeypatch, tmp_path):
    monkeypatch.setattr(extras, "_found", lambda module: True)
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path))
    with pytest.raises(InputError, match="--download") as caught:
        adapter()(Picture(np.zeros((8, 8, 3), np.uint8)))
    assert f"--{adapter.card.name}.weights" in str(caught.value)
    assert adapter.card.weights[0].repo in str(caught.value)
    assert "no weights" in adapter().identity()


@pytest.mark.parametrize("bad", [np.zeros((8, 8), np.uint8), np.zeros((8, 8, 4), np.uint8), np.zeros((8, 8, 3))])
def test_an_image_that_is_none_is_refused(bad, monkeypatch):
    monkeypatch.setattr(extras, "_found", lambda module: True)
    with pytest.raises(InputError, match="RGB image"):
        Segformer()(Picture(bad))


def test_a_negative_long_side_is_refused():
    with pytest.raises(InputError, match="long_side"):
        Mask2Former(long_side=-1)


@pytest.mark.parametrize(
    ("settings", "sides"),
    [
        ({"size": {"shortest_edge": 512, "longest_edge": 2048}, "size_divisor": 32}, (512, 2048, 32)),
        ({"size": {"shortest_edge": 640}, "max_size": 2560}, (640, 2560, 1)),
        ({"size": 512, "max_size": 2048, "size_divisibility": 32}, (512, 2048, 32)),
        ({"size": 640}, (640, None, 1)),
        ({"size": {"height": 512, "width": 1024}}, (512, None, 1)),
        ({"size": {"shortest_edge": 512, "longest_edge": None}}, (512, None, 1)),
        ({}, (7, 9, 1)),
    ],
)
def test_every_form_in_which_the_library_has_written_sizes_is_read(settings, sides):
    how = preparation(settings, Preparation(7, 9))
    assert (how.shortest, how.longest, how.multiple) == sides


@pytest.mark.parametrize(
    ("size", "long_side", "shape"),
    [
        ((480, 640), 0, (512, 704)),  # short side to 512: 682.7, rounded to 683, up to 704
        ((640, 480), 0, (704, 512)),
        ((500, 4000), 0, (256, 2048)),  # the long side is the limit
        ((393, 518), 0, (512, 704)),
        ((393, 518), 1000, (768, 1024)),
        ((393, 518), 32, (32, 32)),
        ((1, 3000), 0, (32, 2048)),
    ],
)
def test_sides_follow_the_shorter_side_its_limit_and_the_multiple(size, long_side, shape):
    assert Preparation(512, 2048, 32).shape(*size, long_side) == shape


def test_values_are_normalised_as_the_settings_say():
    image = np.full((8, 8, 3), (255, 51, 0), np.uint8)
    seen = preparation({}, Preparation(8)).pixels(image, (8, 8))
    expected = (np.array([1, 0.2, 0]) - [0.485, 0.456, 0.406]) / [0.229, 0.224, 0.225]
    assert seen.dtype == np.float32
    np.testing.assert_allclose(seen[:, 3, 4], expected, rtol=1e-5)
    odd = {"rescale_factor": 1 / 127.5, "image_mean": [1, 1, 1], "image_std": [0.5, 1, 2]}
    seen = preparation(odd, Preparation(8)).pixels(image, (8, 8))
    np.testing.assert_allclose(seen[:, 0, 0], [2, -0.6, -0.5], rtol=1e-5)
    seen = preparation({"do_normalize": False}, Preparation(8)).pixels(image, (8, 8))
    np.testing.assert_allclose(seen[:, 0, 0], [1, 0.2, 0], atol=1e-6)
    seen = preparation({"do_normalize": False, "do_rescale": False}, Preparation(8)).pixels(image, (8, 8))
    np.testing.assert_allclose(seen[:, 0, 0], [255, 51, 0], rtol=1e-6)


def test_the_padding_is_black_before_normalisation_and_lies_right_or_below():
    image = np.full((6, 8, 3), 200, np.uint8)
    seen = Preparation(8, mean=(0, 0, 0), std=(1, 1, 1)).pixels(image, (6, 8), (8, 8))
    assert seen.shape == (3, 8, 8)
    assert (seen[:, :6] > 0.7).all()
    assert (seen[:, 6:] == 0).all()


def test_an_edge_stays_at_its_place_when_the_picture_is_resized():
    image = np.zeros((40, 90, 3), np.uint8)
    image[:, 30:] = 255
    seen = Preparation(64, mean=(0, 0, 0), std=(1, 1, 1)).pixels(image, (64, 144))[0, 32]
    at = np.interp(0.5, seen, centres(144, 144))  # where the step is half way, in pixels of the input
    assert at == pytest.approx(30 * 144 / 90, abs=0.02)


@pytest.mark.parametrize("shape", [(64, 64), (64, 65), (64, 128), (64, 129), (64, 333), (333, 64), (64, 1000)])
def test_windows_cover_the_input_and_are_squares(shape):
    seen = np.zeros(shape, int)
    windows = split(shape, 64)
    for window in windows:
        assert window.bottom - window.top == window.right - window.left == 64
        seen[window.rows, window.columns] += 1
    assert seen.min() >= 1
    assert len(windows) == -(-max(shape) // 64)
    assert Window.whole(shape).rows == slice(0, shape[0])


def test_settings_are_found_in_both_files_of_the_library(tmp_path):
    assert read_settings(tmp_path) == {}
    (tmp_path / "processor_config.json").write_text(json.dumps({"image_processor": {"size": 5}}))
    assert read_settings(tmp_path) == {"size": 5}
    (tmp_path / "preprocessor_config.json").write_text(json.dumps({"size": 6}))
    assert read_settings(tmp_path) == {"size": 6}
    (tmp_path / "preprocessor_config.json").write_text("{")
    with pytest.raises(InputError, match="not readable JSON"):
        read_settings(tmp_path)
    (tmp_path / "preprocessor_config.json").write_text("[1]")
    with pytest.raises(InputError, match="not a JSON table"):
        read_settings(tmp_path)


def test_class_names_are_read_in_the_order_of_their_ids():
    assert class_names({"id2label": {"10": "sky", "2": "tree", "0": "wall"}}) == ("wall", "tree", "sky")
    assert class_names({"id2label": {"0": "LABEL_0", "1": "LABEL_1"}}) == ()
    assert class_names({}) == ()


def test_weights_of_another_network_are_named(tmp_path):
    with pytest.raises(InputError, match=r"no config\.json"):
        configuration(tmp_path, Segformer.kinds, "segformer")
    (tmp_path / "config.json").write_text(json.dumps({"model_type": "mask2former"}))
    with pytest.raises(InputError, match="'mask2former', but segformer needs segformer"):
        configuration(tmp_path, Segformer.kinds, "segformer")
    assert configuration(tmp_path, Mask2Former.kinds, "mask2former")["model_type"] == "mask2former"


def test_the_terms_of_the_weights_are_those_of_their_publishers():
    commercial = {adapter.card.name: weights.chosen(adapter.card, "").commercial for adapter in ADAPTERS}
    assert commercial == {"mask2former": False, "oneformer": True, "eomt": True, "segformer": False}
