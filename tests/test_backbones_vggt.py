"""VGGT: the adapter on a stand-in that answers rendered pictures with their truth in VGGT's conventions."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pytest
from PIL import Image

from excavatwin.backbones.device import Device
from excavatwin.backbones.reconstructors import vggt as adapter
from excavatwin.backbones.reconstructors.unprojection import rigid
from excavatwin.backbones.reconstructors.vggt import Vggt
from excavatwin.backbones.sequence.chunking import Chunking
from excavatwin.capture import find_photos
from excavatwin.errors import InputError, MissingExtraError
from excavatwin.scene.frames import umeyama
from excavatwin.scene.progress import silent

torch = pytest.importorskip("torch", reason="needs torch: make test-backbones")
pytest.importorskip("safetensors", reason="needs safetensors: make test-backbones")

from networks_on_truth import (  # noqa: E402
    assert_true,
    photos,
    stand_ins,
    swapped_channels,
    truth_on_lattice,
    weights_folder,
)

CPU = Device(name="cpu")
SETTINGS = {"img_size": 518, "patch_size": 14, "embed_dim": 1024}


@pytest.fixture(autouse=True)
def _stand_ins(request):
    with nullcontext() if "absent" in request.node.name else stand_ins():
        yield


@pytest.mark.parametrize(
    ("size", "shape", "mode"),
    [
        ((518, 424), (420, 518), "crop"),
        ((518, 390), (518, 518), "pad"),
        ((424, 518), (518, 420), "crop"),
    ],
    ids=["width 518, cropped", "padded to 518 x 518", "portrait"],
)
def test_prediction_is_the_truth(tmp_path, size, shape, mode):
    truth = truth_on_lattice(*size, 518, mode=mode, views=2)
    assert truth.pictures.shape[1:3] == shape
    network = Vggt(weights=weights_folder(tmp_path, truth, SETTINGS), device=CPU).open()
    prediction = network(truth.pictures)
    assert_true(prediction, truth)
    assert prediction.confidence.min() >= 1
    assert np.allclose(prediction.T_world_cam[0], np.eye(4), atol=1e-6), "its world is the first camera"


def test_own_points_and_another_order(tmp_path):
    truth = truth_on_lattice(140, 112, 140)
    network = Vggt(weights=weights_folder(tmp_path, truth, SETTINGS), device=CPU, head="points").open()
    order = [2, 0, 1]
    prediction = network(truth.pictures[order])
    assert_true(prediction, type(truth)(*(part[order] for part in (truth.pictures, truth.depth, truth.T, truth.K))))


def test_checkpoint_without_folder(tmp_path):
    truth = truth_on_lattice(140, 112, 140)
    torch.save({"model": truth.state()}, tmp_path / "vggt_1B_commercial.pt")
    network = Vggt(weights=str(tmp_path / "vggt_1B_commercial.pt"), device=CPU).open()
    assert_true(network(truth.pictures), truth)


@pytest.mark.parametrize(
    ("name", "mistake"),
    [
        ("camera_to_world", rigid),
        ("centred", lambda K: K.astype(float)),
        ("pictures", swapped_channels),
        ("pictures", lambda images, device: 255 * swapped_channels(images[..., ::-1], device)),
        ("pictures", lambda images, device: swapped_channels(images[..., ::-1].swapaxes(1, 2), device)),
    ],
    ids=["pose not inverted", "half pixel forgotten", "BGR", "0..255", "H and W swapped"],
)
def test_mistakes_of_convention_do_not_pass(tmp_path, monkeypatch, name, mistake):
    truth = truth_on_lattice(140, 112, 140)
    network = Vggt(weights=weights_folder(tmp_path, truth, SETTINGS), device=CPU).open()
    monkeypatch.setattr(adapter, name, mistake)
    with pytest.raises(AssertionError):
        assert_true(network(truth.pictures), truth)


def test_when_its_code_is_absent_the_install_line_is_given():
    with pytest.raises(MissingExtraError, match="facebookresearch/vggt"):
        Vggt().open()


def test_when_weights_are_missing_size_and_licence_are_given(monkeypatch, tmp_path):
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path))
    with pytest.raises(
        InputError, match=r"facebook/VGGT-1B, 5\.0 GB, licence CC-BY-NC-4\.0, which restricts commercial use"
    ):
        Vggt().open()


def test_photos_become_observations_in_chunks(tmp_path, monkeypatch):
    """Through the whole driver: photos that do not fit the lattice are cropped, three chunks are put together."""
    truth = truth_on_lattice(140, 118, 140, views=6)
    folder = tmp_path / "photos"
    folder.mkdir()
    images = photos(140, 118, 6)[0]
    for s, image in enumerate(images):
        Image.fromarray(image).save(folder / f"{s}.png")
    settings = Chunking(size=4, shared=3)
    network = Vggt(weights=weights_folder(tmp_path / "w", truth, SETTINGS), device=CPU, lattice=140, chunking=settings)
    (tmp_path / "scratch").mkdir()
    found = network(find_photos(folder), silent, tmp_path / "scratch")
    assert len(found.views) == 6
    known = np.stack([truth.points(s) for s in range(6)])
    there = np.stack([view.points for view in found.views])
    use = np.isfinite(known).all(-1) & np.isfinite(there).all(-1)
    assert use.mean() > 0.9
    s, R, t = umeyama(there[use][::31].astype(float), known[use][::31], np.ones(len(there[use][::31])))
    assert np.linalg.norm(s * there[use] @ R.T + t - known[use], axis=-1).max() < 0.02
    for view, K in zip(found.views, truth.K, strict=True):
        assert view.lattice is not None
        assert np.allclose(view.K_cam, K, rtol=1e-3, atol=0.05)
        assert np.allclose(view.lattice.K_photo[:2, 2], (70.5, 59.5), atol=0.05), "the middle of the photo, and a half"
