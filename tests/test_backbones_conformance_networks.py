"""The conformance suite on real networks with small random weights, and on stand-ins that answer with the truth."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from PIL import Image

from excavatwin.backbones.conformance import Outcome, Report, check_reconstructor, check_segmenter
from excavatwin.backbones.conformance.preparing import NAME as PREPARE
from excavatwin.backbones.device import Device
from excavatwin.backbones.protocols import Picture
from excavatwin.backbones.reconstructors.depth_anything_3 import DepthAnything3
from excavatwin.backbones.reconstructors.dust3r import Dust3r
from excavatwin.backbones.reconstructors.map_anything import MapAnything
from excavatwin.backbones.reconstructors.mast3r import Mast3r
from excavatwin.backbones.reconstructors.pi3 import Pi3
from excavatwin.backbones.reconstructors.vggt import Vggt
from excavatwin.backbones.segmenters.clipseg import ClipSeg
from excavatwin.backbones.segmenters.eomt import Eomt
from excavatwin.backbones.segmenters.grounded_sam import GroundedSam
from excavatwin.backbones.segmenters.mask2former import Mask2Former
from excavatwin.backbones.segmenters.oneformer import OneFormer
from excavatwin.backbones.segmenters.sam3 import Sam3
from excavatwin.backbones.segmenters.segformer import Segformer
from excavatwin.backbones.segmenters.yoloe import Yoloe
from excavatwin.capture import find_photos
from finished_site import shots, write_photos

torch = pytest.importorskip("torch", reason="needs torch: make test-backbones")

import closed_vocabulary_networks  # noqa: E402
import text_networks  # noqa: E402

# huggingface_hub leaves config.json to the garbage collector to close.
pytestmark = pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")
CPU = Device("cpu", "float32")
PAIRWISE = {"output_mode": "pts3d", "head_type": "dpt", "enc_depth": 24}
MAP_ANYTHING = {"name": "mapanything", "encoder_config": {"encoder_str": "dinov2", "uses_torch_hub": True}}
CLOSED = {"mask2former": Mask2Former, "oneformer": OneFormer, "segformer": Segformer, "eomt": Eomt}


@pytest.fixture(scope="module")
def pictures() -> list[Picture]:
    return [Picture(shot.image, shot.name) for shot in shots()[:2]]


def green(report: Report) -> None:
    """Every promise kept; random weights may put their classes anywhere, which is told and not refused."""
    assert not report.failed, str(report)
    assert report.row("runs").outcome == Outcome.PASSED, str(report)


@pytest.mark.parametrize("kind", CLOSED)
def test_closed_vocabularies(kind, tmp_path, pictures):
    pytest.importorskip("transformers", reason="needs transformers: make test-backbones")
    folder = closed_vocabulary_networks.save(kind, tmp_path / kind)
    report = check_segmenter(CLOSED[kind](weights=str(folder), device=CPU), pictures)
    green(report)
    assert report.row(PREPARE).outcome == Outcome.PASSED


@pytest.mark.parametrize("kind", ["sam3", "clipseg", "grounded-sam"])
def test_text_prompted(kind, tmp_path, pictures):
    pytest.importorskip("transformers", reason="needs transformers: make test-backbones")
    prompts = tmp_path / "own.toml"
    prompts.write_text(text_networks.PROMPTS)

    def folder(name: str) -> str:
        (tmp_path / name).mkdir()
        return str(getattr(text_networks, name)(tmp_path / name))

    made: dict[str, Any] = {
        "sam3": lambda: Sam3(folder("sam3"), str(prompts), score=0.05, device=CPU),
        "clipseg": lambda: ClipSeg(folder("clipseg"), str(prompts), side=64, threshold=0.1, batch=3, device=CPU),
        "grounded-sam": lambda: GroundedSam(
            folder("grounding_dino"), folder("sam"), str(prompts), score=0.05, device=CPU, short_side=96, long_side=160
        ),
    }
    report = check_segmenter(made[kind](), pictures)
    green(report)
    assert report.row(PREPARE).outcome == Outcome.PASSED


# Its text encoder is TorchScript, as Ultralytics publishes it; making one for the test is deprecated by torch.
@pytest.mark.filterwarnings("ignore:`torch.jit:FutureWarning")
def test_yoloe(tmp_path, pictures):
    pytest.importorskip("ultralytics", reason="needs ultralytics: make test-backbones")
    from ultralytics import YOLOE

    from excavatwin.backbones.segmenters import yoloe_network
    from test_backbones_text_yoloe import _Encoder, lively

    yoloe_network.quietly()
    torch.manual_seed(0)
    torch.jit.trace(_Encoder().eval(), torch.zeros(2, 77, dtype=torch.long)).save(tmp_path / "mobileclip_blt.ts")
    network = YOLOE("yoloe-11n-seg.yaml")
    lively(network.model)
    network.save(tmp_path / "yoloe-11n-seg.pt")
    (tmp_path / "prompts.toml").write_text(text_networks.PROMPTS)
    one = Yoloe(str(tmp_path / "yoloe-11n-seg.pt"), device=CPU, prompts=str(tmp_path / "prompts.toml"), long_side=160)
    report = check_segmenter(one, pictures)
    green(report)
    assert report.row(PREPARE).outcome == Outcome.PASSED


# onnx.helper of onnx 1.2x still calls functions of its own that it has deprecated
@pytest.mark.filterwarnings("ignore::FutureWarning:onnx")
def test_onnx(tmp_path, pictures):
    pytest.importorskip("onnxruntime", reason="needs onnxruntime: make test-backbones")
    pytest.importorskip("onnx", reason="needs onnx: make test-backbones")
    from test_backbones_onnx import described, export

    export(tmp_path / "model.onnx", 20 * np.eye(3), stride=4)
    green(check_segmenter(described(tmp_path), pictures))


def test_depth_anything_3(tmp_path):
    pytest.importorskip("depth_anything_3", reason="needs depth-anything-3: make test-backbones")
    from safetensors.torch import save_model

    from test_backbones_da3 import network_of

    api = torch.nn.Module()
    api.model = network_of("da3-small")
    folder = tmp_path / "weights"
    folder.mkdir()
    save_model(api, str(folder / "model.safetensors"))
    (folder / "config.json").write_text(json.dumps({"model_name": "da3-small"}))
    photos = write_photos(tmp_path / "photos")[:4]
    one = DepthAnything3(weights=str(folder), device=CPU, lattice=112)
    report = check_reconstructor(one, photos, tmp_path / "scratch")
    assert {row.name for row in report.failed} <= {"validated"}, str(report)  # random weights see no common surface
    assert report.row("runs").outcome == Outcome.PASSED


# Stand-ins know the rendered pictures only: of others, such as odd sizes make, they say so by an AssertionError.
@pytest.mark.parametrize(
    ("stage", "size", "multiple", "settings"),
    [
        (Vggt, (140, 118), 14, {"img_size": 518, "patch_size": 14, "embed_dim": 1024}),
        (Pi3, (140, 112), 14, {}),
        (MapAnything, (140, 112), 14, MAP_ANYTHING),
        (Dust3r, (160, 112), 16, PAIRWISE),
        (Mast3r, (160, 112), 16, PAIRWISE),
    ],
)
def test_adapters_whose_network_answers_with_the_truth(stage, size, multiple, settings, tmp_path, monkeypatch):
    pytest.importorskip("safetensors", reason="needs safetensors: make test-backbones")
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))  # MapAnything builds its encoder from a clone there
    (tmp_path / "torch" / "hub" / "facebookresearch_dinov2_main").mkdir(parents=True)
    from networks_on_truth import photos, stand_ins, truth_on_lattice, weights_folder

    with stand_ins():
        truth = truth_on_lattice(*size, max(size), multiple, views=4)
        folder = tmp_path / "photos"
        folder.mkdir()
        for s, image in enumerate(photos(*size, 4)[0]):
            Image.fromarray(image).save(folder / f"{s}.png")
        one = stage(weights=weights_folder(tmp_path / "w", truth, settings), device=CPU, lattice=max(size))
        report = check_reconstructor(one, find_photos(folder), tmp_path / "scratch")
    assert {row.name for row in report.failed} <= {"odd size 517 x 391", "upright by EXIF"}, str(report)
    assert all("AssertionError" in row.sentence for row in report.failed), str(report)
    assert report.row("validated").outcome == Outcome.PASSED, str(report)
    assert report.row("lattice in the photo").outcome == Outcome.PASSED, str(report)
