"""DUSt3R and MASt3R: the adapters on stand-ins that answer pairs of rendered pictures in the models' conventions."""

from __future__ import annotations

import math

import pytest

from excavatwin.backbones.device import Device
from excavatwin.backbones.reconstructors import pairwise as adapter
from excavatwin.backbones.reconstructors.dust3r import Dust3r
from excavatwin.backbones.reconstructors.mast3r import Mast3r
from excavatwin.backbones.reconstructors.pairwise import graph
from excavatwin.backbones.reconstructors.unprojection import camera_to_world
from excavatwin.errors import InputError, ReconstructionError

CPU = Device(name="cpu")
SETTINGS = {"output_mode": "pts3d", "head_type": "dpt", "enc_depth": 24}


def test_every_pair_up_to_a_number_of_images():
    assert set(graph(4, 12, 2)) == {(i, j) for i in range(4) for j in range(4) if i != j}


def test_above_it_only_images_that_follow_each_other():
    pairs = graph(30, 12, 3)
    assert max(abs(i - j) for i, j in pairs) == 3
    assert {i for i, _ in pairs} == set(range(30))
    assert len(pairs) == len(set(pairs)) == 2 * (30 * 3 - 3 * 4 // 2)
    assert set(pairs) == {(j, i) for i, j in pairs}


def test_memory_grows_with_the_pairs():
    network = Dust3r()
    assert network.memory(1, 384, 512) == network.memory(2, 384, 512) < network.memory(12, 384, 512)
    each = 384 * 512 * 46 * 4
    assert math.isclose(network.memory(12, 384, 512) - network.memory(2, 384, 512), (12 * 11 - 2) * each)


def test_other_precisions_are_refused():
    with pytest.raises(InputError, match="computes in float32"):
        Dust3r(device=Device(precision="bfloat16")).open()


class TestOnStandIns:
    """With torch."""

    @pytest.fixture(autouse=True)
    def _stand_ins(self):
        pytest.importorskip("torch", reason="needs torch: make test-backbones")
        pytest.importorskip("safetensors", reason="needs safetensors: make test-backbones")
        from networks_on_truth import stand_ins

        with stand_ins():
            yield

    @pytest.mark.parametrize("stage", [Dust3r, Mast3r])
    @pytest.mark.parametrize(("size", "exhaustive"), [((160, 112), 12), ((112, 160), 2)])
    def test_prediction_is_the_truth(self, tmp_path, stage, size, exhaustive):
        from networks_on_truth import assert_true, truth_on_lattice, weights_folder

        truth = truth_on_lattice(*size, 160, 16)
        folder = weights_folder(tmp_path, truth, SETTINGS)
        network = stage(weights=folder, device=CPU, exhaustive=exhaustive, window=1).open()
        prediction = network(truth.pictures)
        assert_true(prediction, truth, metric=stage is Mast3r)
        assert prediction.confidence.min() >= 1

    def test_one_image_alone(self, tmp_path):
        from networks_on_truth import assert_true, truth_on_lattice, weights_folder

        truth = truth_on_lattice(160, 112, 160, 16)
        network = Mast3r(weights=weights_folder(tmp_path, truth, SETTINGS), device=CPU).open()
        alone = type(truth)(truth.pictures[1:2], truth.depth[1:2], truth.T[1:2], truth.K[1:2])
        prediction = network(alone.pictures)
        assert prediction.points.shape == (1, 112, 160, 3)
        assert_true(prediction, alone, metric=True)

    @pytest.mark.parametrize(
        ("name", "mistake"),
        [("rigid", camera_to_world), ("centred", lambda K: K.astype(float)), ("pictures", None)],
        ids=["pose inverted", "half pixel forgotten", "BGR"],
    )
    def test_mistakes_of_convention_do_not_pass(self, tmp_path, monkeypatch, name, mistake):
        from networks_on_truth import assert_true, swapped_channels, truth_on_lattice, weights_folder

        truth = truth_on_lattice(160, 112, 160, 16)
        network = Dust3r(weights=weights_folder(tmp_path, truth, SETTINGS), device=CPU).open()
        monkeypatch.setattr(adapter, name, mistake or swapped_channels)
        with pytest.raises(AssertionError):
            assert_true(network(truth.pictures), truth)

    def test_an_alignment_that_diverges_is_an_error(self, tmp_path, monkeypatch):
        from dust3r.cloud_opt import Scene

        from networks_on_truth import truth_on_lattice, weights_folder

        truth = truth_on_lattice(160, 112, 160, 16)
        network = Dust3r(weights=weights_folder(tmp_path, truth, SETTINGS), device=CPU).open()
        monkeypatch.setattr(Scene, "compute_global_alignment", lambda self, **given: float("nan"))
        with pytest.raises(ReconstructionError, match="could not put its pairs together"):
            network(truth.pictures)

    def test_checkpoints_that_hold_python_text_are_refused(self, tmp_path):
        (tmp_path / "DUSt3R.pth").write_bytes(b"PK")
        with pytest.raises(InputError, match=r"no config\.json beside .*give the folder as the hub keeps it"):
            Dust3r(weights=str(tmp_path / "DUSt3R.pth"), device=CPU).open()
