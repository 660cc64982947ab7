"""MapAnything: the adapter on a stand-in that answers rendered pictures with their truth in its conventions."""

from __future__ import annotations

import numpy as np
import pytest

from excavatwin.backbones.device import Device
from excavatwin.backbones.reconstructors import map_anything as adapter
from excavatwin.backbones.reconstructors.map_anything import MapAnything
from excavatwin.backbones.reconstructors.unprojection import camera_to_world
from excavatwin.errors import InputError

torch = pytest.importorskip("torch", reason="needs torch: make test-backbones")
pytest.importorskip("safetensors", reason="needs safetensors: make test-backbones")

from networks_on_truth import assert_true, stand_ins, swapped_channels, truth_on_lattice, weights_folder  # noqa: E402

CPU = Device(name="cpu")
SETTINGS = {"name": "mapanything", "encoder_config": {"encoder_str": "dinov2", "uses_torch_hub": True}}


@pytest.fixture(autouse=True)
def _stand_ins(monkeypatch, tmp_path):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))
    (tmp_path / "torch" / "hub" / "facebookresearch_dinov2_main").mkdir(parents=True)
    with stand_ins():
        yield


@pytest.mark.parametrize("size", [(140, 132), (112, 154)])
def test_prediction_is_the_truth(tmp_path, size):
    truth = truth_on_lattice(*size, max(size))
    network = MapAnything(weights=weights_folder(tmp_path / "w", truth, SETTINGS), device=CPU).open()
    prediction = network(truth.pictures)
    assert_true(prediction, truth, metric=True)
    masked = np.isnan(prediction.points[..., 0])
    assert masked[:, :3].all(), "what the network masks is no point"
    assert (prediction.confidence[masked] == 0).all()
    assert prediction.confidence[~masked].min() >= 1


@pytest.mark.parametrize(
    ("name", "mistake"),
    [
        ("rigid", camera_to_world),
        ("centred", lambda K: K.astype(float)),
        ("pictures", swapped_channels),
        ("IMAGENET", ((0.5, 0.5, 0.5), (0.5, 0.5, 0.5))),
    ],
    ids=["pose inverted", "half pixel forgotten", "BGR", "another normalisation"],
)
def test_mistakes_of_convention_do_not_pass(tmp_path, monkeypatch, name, mistake):
    truth = truth_on_lattice(140, 112, 140)
    network = MapAnything(weights=weights_folder(tmp_path / "w", truth, SETTINGS), device=CPU).open()
    monkeypatch.setattr(adapter, name, mistake)
    with pytest.raises(AssertionError):
        assert_true(network(truth.pictures), truth, metric=True)


def test_torch_hub_downloads_nothing(tmp_path):
    truth = truth_on_lattice(140, 112, 140)
    folder = weights_folder(tmp_path / "w", truth, SETTINGS)
    (tmp_path / "torch" / "hub" / "facebookresearch_dinov2_main").rmdir()
    with pytest.raises(InputError, match=r"git clone --depth 1 https://github\.com/facebookresearch/dinov2"):
        MapAnything(weights=folder, device=CPU).open()


def test_weights_with_another_normalisation_are_refused(tmp_path):
    folder = weights_folder(tmp_path / "w", truth_on_lattice(140, 112, 140), SETTINGS | {"norm": "dinov3"})
    with pytest.raises(InputError, match="normalised as 'dinov3'"):
        MapAnything(weights=folder, device=CPU).open()


def test_settings_that_the_code_does_not_know_are_named(tmp_path):
    folder = weights_folder(tmp_path / "w", truth_on_lattice(140, 112, 140), SETTINGS | {"novelty": 1})
    with pytest.raises(InputError, match=r"does not take the settings of these weights .*novelty.*update it"):
        MapAnything(weights=folder, device=CPU).open()
