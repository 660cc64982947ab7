"""Pi3 and Pi3X: the adapter on stand-ins that answer rendered pictures with their truth in the models' conventions."""

from __future__ import annotations

import numpy as np
import pytest

from excavatwin.backbones.device import Device
from excavatwin.backbones.reconstructors import pi3 as adapter
from excavatwin.backbones.reconstructors.pi3 import Pi3
from excavatwin.backbones.reconstructors.unprojection import camera_to_world

torch = pytest.importorskip("torch", reason="needs torch: make test-backbones")
pytest.importorskip("safetensors", reason="needs safetensors: make test-backbones")

from networks_on_truth import assert_true, stand_ins, swapped_channels, truth_on_lattice, weights_folder  # noqa: E402

CPU = Device(name="cpu")


@pytest.fixture(autouse=True)
def _stand_ins():
    with stand_ins():
        yield


@pytest.mark.parametrize("size", [(140, 112), (112, 154)])
def test_prediction_is_the_truth(tmp_path, size):
    truth = truth_on_lattice(*size, max(size))
    prediction = Pi3(weights=weights_folder(tmp_path, truth), device=CPU).open()(truth.pictures)
    assert_true(prediction, truth)
    assert prediction.confidence.max() <= 1, "logits must go through the sigmoid"
    assert not np.allclose(prediction.T_world_cam[0], np.eye(4)), "its world is no particular camera's"


def test_weights_of_pi3x_are_recognised_and_metric(tmp_path):
    truth = truth_on_lattice(140, 112, 140)
    folder = weights_folder(tmp_path, truth, metric_token=torch.zeros(1, 1, 2))
    assert_true(Pi3(weights=folder, device=CPU).open()(truth.pictures), truth, metric=True)


def test_focal_length_where_little_is_seen(tmp_path):
    truth = truth_on_lattice(140, 112, 140)
    truth.depth[:, :, 40:] = np.nan
    prediction = Pi3(weights=weights_folder(tmp_path, truth), device=CPU).open()(truth.pictures)
    assert np.allclose(prediction.K_cam, truth.K, rtol=1e-4, atol=0.02)


@pytest.mark.parametrize(
    ("name", "mistake"), [("rigid", camera_to_world), ("pictures", swapped_channels)], ids=["pose inverted", "BGR"]
)
def test_mistakes_of_convention_do_not_pass(tmp_path, monkeypatch, name, mistake):
    truth = truth_on_lattice(140, 112, 140)
    network = Pi3(weights=weights_folder(tmp_path, truth), device=CPU).open()
    monkeypatch.setattr(adapter, name, mistake)
    with pytest.raises(AssertionError):
        assert_true(network(truth.pictures), truth)


def test_memory_without_flash_attention_grows_with_the_square():
    """On CPUs its attention stores the matrix of all tokens by all tokens."""
    small, large = (Pi3(device=CPU).memory(images, 392, 518) for images in (10, 40))
    assert large - small > 16 * 4 * (392 * 518 / 196) ** 2 * (40**2 - 10**2)
    in_bfloat16 = Pi3(device=Device(name="cpu", precision="bfloat16")).memory(40, 392, 518)
    assert in_bfloat16 < 0.3 * large
