"""Real, tiny ONNX models through the whole adapter: colours, layouts, grids, and mistakes that are named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from excavatwin.backbones.catalogue import make
from excavatwin.backbones.lattices import IMAGENET
from excavatwin.backbones.protocols import Picture
from excavatwin.backbones.segmenters.onnx import Onnx
from excavatwin.errors import InputError

pytest.importorskip("onnxruntime", reason="needs onnxruntime: make test-backbones")
onnx = pytest.importorskip("onnx", reason="needs onnx: make test-backbones")

# onnx.helper of onnx 1.2x still calls functions of its own that it has deprecated
pytestmark = pytest.mark.filterwarnings("ignore::FutureWarning:onnx")

CLASSES = ["soil", "low_grass", "heavy_machinery"]  # of GOOSE: channels 1, 3 and 4; here they are red, green and blue
RED, GREEN, BLUE = (220, 30, 30), (30, 220, 30), (30, 30, 220)


def export(
    path: Path,
    weights: np.ndarray,
    size: tuple[int | str, int | str] = (32, 48),
    stride: int = 1,
    layout: str = "NCHW",
    tail: str = "",
    kind: int = 1,
    batch: int = 1,
) -> Path:
    """A file with one 1 x 1 convolution (V, 3) on the colours, pooled by ``stride``, then ``tail``."""
    from onnx import TensorProto, helper, numpy_helper

    h, w = size
    V = len(weights)
    nodes, last = [], "image"
    if kind != 1:
        nodes.append(helper.make_node("Cast", [last], ["floats"], to=1))
        last = "floats"
    if layout == "NHWC":
        nodes.append(helper.make_node("Transpose", [last], ["turned"], perm=[0, 3, 1, 2]))
        last = "turned"
    nodes.append(helper.make_node("Conv", [last, "w"], ["mixed"]))
    last = "mixed"
    if stride > 1:
        nodes.append(
            helper.make_node("AveragePool", [last], ["pooled"], kernel_shape=[stride] * 2, strides=[stride] * 2)
        )
        last = "pooled"
    if tail == "argmax":
        nodes.append(helper.make_node("ArgMax", [last], ["out"], axis=1, keepdims=0))
    elif tail == "softmax":
        nodes.append(helper.make_node("Softmax", [last], ["out"], axis=1))
    elif layout == "NHWC":
        nodes.append(helper.make_node("Transpose", [last], ["out"], perm=[0, 2, 3, 1]))
    else:
        nodes.append(helper.make_node("Identity", [last], ["out"]))
    shape = [batch, 3, h, w] if layout == "NCHW" else [batch, h, w, 3]
    out = helper.make_tensor_value_info("out", TensorProto.INT64 if tail == "argmax" else TensorProto.FLOAT, None)
    graph = helper.make_graph(
        nodes,
        "colours",
        [helper.make_tensor_value_info("image", kind, shape)],
        [out],
        [numpy_helper.from_array(weights.astype(np.float32).reshape(V, 3, 1, 1), "w")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    onnx.save(model, path)
    return path


def described(folder: Path, text: str = "", classes: list[str] | str = CLASSES) -> Onnx:
    import json

    (folder / "model.toml").write_text(f'model = "model.onnx"\nclasses = {json.dumps(classes)}\n{text}\n')
    return make("segmenter", f"onnx:{folder / 'model.toml'}")


def thirds(height: int = 64, width: int = 96) -> np.ndarray:
    """Red, green and blue stripes from left to right."""
    image = np.zeros((height, width, 3), np.uint8)
    for part, colour in enumerate((RED, GREEN, BLUE)):
        image[:, part * width // 3 : (part + 1) * width // 3] = colour
    return image


def winner(evidence: np.ndarray) -> list[int]:
    """Class in the middle of each third."""
    H, W = evidence.shape[:2]
    return [int(evidence[H // 2, int(W * x)].argmax()) + 1 for x in (1 / 6, 0.5, 5 / 6)]


def test_evidence_comes_back_to_the_pixels_of_the_picture(tmp_path):
    export(tmp_path / "model.onnx", 20 * np.eye(3), stride=4)
    seen = described(tmp_path)(Picture(thirds()))
    assert seen.evidence.shape == (64, 96, 5)
    assert seen.evidence.dtype == np.float32
    assert winner(seen.evidence) == [1, 3, 4]
    assert seen.evidence.min() >= 0
    assert seen.evidence.sum(-1).max() <= 1 + 1e-6
    border = np.flatnonzero(np.diff(seen.evidence[32].argmax(-1)))
    assert border.tolist() == [31, 63]
    assert not seen.no_surface.any()


@pytest.mark.parametrize("stride", [1, 4])
@pytest.mark.parametrize(
    ("resize", "size"), [("stretch", (32, 48)), ("stretch", (64, 64)), ("pad", (96, 96)), ("crop", (64, 64))]
)
def test_no_half_pixel_is_lost_on_the_way(tmp_path, resize, size, stride):
    """The network gives red and green as probabilities, and the picture is a ramp: it must come back as it was."""
    export(tmp_path / "model.onnx", np.array([[1.0, 0, 0], [0, 1, 0]]), size, stride)
    ramp = np.zeros((64, 96, 3), np.uint8)
    ramp[..., 0] = np.linspace(10, 120, 96).round()
    ramp[..., 1] = np.linspace(10, 120, 64).round()[:, None]
    text = f'kind = "probabilities"\nresize = "{resize}"\n'
    seen = described(tmp_path, text, ["soil", "low_grass"])(Picture(ramp))
    inner = np.zeros((64, 96), bool)
    inner[8:-8, 24 if resize == "crop" else 8 : -24 if resize == "crop" else -8] = True
    for k, channel in ((0, 0), (2, 1)):
        error = (seen.evidence[..., k] * 255 - ramp[..., channel])[inner]
        slope = 110 / (96 if channel == 0 else 64)
        assert np.abs(error).max() < 0.75  # rounding to bytes
        assert abs(error.mean()) < 0.1 * slope  # of a pixel
    assert bool(seen.doubts) == (resize == "crop")
    if resize == "crop":
        assert "sees 67% of the photo" in seen.doubts[0]
        assert not seen.evidence[:, :15].any()
        assert not seen.evidence[:, -15:].any()


@pytest.mark.parametrize(("colours", "expected"), [("rgb", [1, 3, 4]), ("bgr", [4, 3, 1])])
def test_colour_order(tmp_path, colours, expected):
    export(tmp_path / "model.onnx", 20 * np.eye(3))
    assert winner(described(tmp_path, f'colours = "{colours}"')(Picture(thirds())).evidence) == expected


def test_means_are_red_green_blue_whatever_the_order_of_the_channels(tmp_path):
    mean, std = IMAGENET
    export(tmp_path / "model.onnx", np.eye(3))
    red = np.full((32, 48, 3), RED, np.uint8)
    text = f'mean = {list(mean)}\nstd = {list(std)}\ncolours = "bgr"'
    found = described(tmp_path, text)(Picture(red)).evidence[5, 5]
    z = ((np.array(RED) / 255 - mean) / std)[::-1]
    p = np.exp(z) / np.exp(z).sum()
    np.testing.assert_allclose(found[[0, 2, 3]], p, rtol=1e-4)


def test_channels_last(tmp_path):
    export(tmp_path / "model.onnx", 20 * np.eye(3), layout="NHWC")
    assert winner(described(tmp_path, 'layout = "NHWC"')(Picture(thirds())).evidence) == [1, 3, 4]


def test_any_size(tmp_path):
    export(tmp_path / "model.onnx", 20 * np.eye(3), ("h", "w"), stride=4)
    for text in ("long_side = 64\nmultiple = 16", "size = [64, 80]", 'long_side = 96\nresize = "pad"'):
        assert winner(described(tmp_path, text)(Picture(thirds())).evidence) == [1, 3, 4]


def test_labels_probabilities_sigmoids_and_bytes(tmp_path):
    for number, (text, arguments) in enumerate(
        (
            ('kind = "labels"', {"tail": "argmax"}),
            ('kind = "probabilities"', {"tail": "softmax"}),
            ('kind = "sigmoid"\nmean = [0.5, 0.5, 0.5]', {}),
            ("scale = 1", {"kind": 2}),  # uint8
            ("", {"kind": 10}),  # float16
        )
    ):
        folder = tmp_path / str(number)
        folder.mkdir()
        export(folder / "model.onnx", 20 * np.eye(3), **arguments)
        seen = described(folder, text)(Picture(thirds()))
        assert winner(seen.evidence) == [1, 3, 4], text
        assert seen.evidence.sum(-1).max() <= 1 + 1e-6


def test_labels_are_ids_of_the_vocabulary(tmp_path):
    from onnx import TensorProto, helper, numpy_helper

    labels = np.full((1, 8, 8), 33, np.int64)  # mud of RELLIS
    labels[:, 4:] = 255
    nodes = [helper.make_node("Identity", ["labels"], ["out"])]
    graph = helper.make_graph(
        nodes,
        "constant",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, 8, 8])],
        [helper.make_tensor_value_info("out", TensorProto.INT64, [1, 8, 8])],
        [numpy_helper.from_array(labels, "labels")],
    )
    onnx.save(
        helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9), tmp_path / "model.onnx"
    )
    evidence = described(tmp_path, 'kind = "labels"', "rellis-3d")(Picture(np.zeros((8, 8, 3), np.uint8))).evidence
    assert evidence[0, 0].tolist() == [1, 0, 0, 0, 0]
    assert not evidence[7].any()


def test_sky_has_no_surface_and_no_evidence(tmp_path):
    export(tmp_path / "model.onnx", 20 * np.eye(3))
    seen = described(tmp_path, classes=["soil", "low_grass", "sky"])(Picture(thirds()))
    assert seen.no_surface[:, 70:].all()
    assert not seen.no_surface[:, :60].any()
    assert not seen.evidence[seen.no_surface].any()


def test_the_users_own_lines(tmp_path):
    export(tmp_path / "model.onnx", 20 * np.eye(3))
    text = '[remap]\nlow_grass = "other_terrain"\nspoil = "construction_terrain"'
    model = described(tmp_path, text, ["spoil", "low_grass", "heavy_machinery"])
    assert winner(model(Picture(thirds())).evidence) == [1, 2, 4]
    above = Onnx(model.source, remap={"low_grass": "obstacle"})
    assert winner(above(Picture(thirds())).evidence) == [1, 5, 4]


def test_the_identity_follows_the_model_and_its_description(tmp_path):
    export(tmp_path / "model.onnx", np.eye(3))
    first = described(tmp_path).identity()
    assert "onnxruntime" in first
    assert described(tmp_path, 'colours = "bgr"').identity() != first
    export(tmp_path / "model.onnx", 2 * np.eye(3), stride=2)
    assert described(tmp_path).identity() != first


def test_the_identity_follows_the_users_own_mapping(tmp_path):
    export(tmp_path / "model.onnx", np.eye(3))
    own = tmp_path / "own.toml"
    lines = '[classes]\nspoil = "construction_terrain"\nlow_grass = "other_terrain"\nheavy_machinery = "{}"\n'
    source = described(tmp_path, "", ["spoil", "low_grass", "heavy_machinery"]).source
    for mapping in (str(own), f"{own}:own"):
        own.write_text(lines.format("excavator"))
        before = Onnx(source, mapping=mapping).identity()
        own.write_text(lines.format("obstacle"))
        assert Onnx(source, mapping=mapping).identity() != before


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("colour = 'bgr'", "has a key 'colour' that is not known; did you mean colours"),
        ("colours = 'gbr'", "colours is 'gbr'; give one of: rgb, bgr"),
        ("size = [32]", r"size is \[32\]; give \[height, width\]"),
        ("size = [48, 32]", r"declares an input of 32 x 48 px \(H x W\), but its TOML makes 48 x 32"),
        ("layout = 'NHWC'", r"declares the input \[1, 3, 32, 48\], which is not NHWC; write layout = \"NCHW\""),
        ("std = [0, 1, 1]", r"std is \[0, 1, 1\]"),
        ("mean = [123.7, 116.3, 103.5]", "does not fit scale = 255"),
        ("scale = 1\nmean = [0.485, 0.456, 0.406]", "does not fit scale = 1"),
        ("scale = 0", "scale is 0; give a number above 0"),
        ("output = 'logits'", "has no output 'logits'; it has: out"),
        ("kind = 'probabilities'", 'not probabilities; write kind = "logits"'),
        ("kind = 'labels'", r"no label image; write kind = \"logits\""),
        ("output_layout = 'NHWC'", r"another axis; write output_layout = \"NCHW\""),
        ("[remap]\nsole = 'obstacle'", r"'sole' \(did you mean 'soil'\?\)"),
        ("remap = 3", "is 3; write one line per class"),
        ("mapping = 'cityscapes'", "cityscapes says nothing about 3 of 3: 'soil', 'low_grass', 'heavy_machinery'"),
    ],
)
def test_wrong_descriptions_are_named(tmp_path, text, message):
    export(tmp_path / "model.onnx", 20 * np.eye(3))
    with pytest.raises(InputError, match=message):
        described(tmp_path, text)(Picture(thirds()))


@pytest.mark.parametrize(
    ("arguments", "text", "classes", "message"),
    [
        ({"tail": "softmax"}, "", CLASSES, 'are probabilities already; write kind = "probabilities"'),
        ({}, "", CLASSES[:2], "gives 3 channels, but its TOML names 2 classes; is there a background class"),
        ({"size": ("h", "w")}, "", CLASSES, r"takes pictures of any size; write size = \[H, W\] or long_side"),
        ({"batch": 4}, "", CLASSES, "takes batches of 4 pictures"),
        ({"kind": 2}, "", CLASSES, "takes bytes 0..255; write scale = 1"),
        ({"kind": 7}, "", CLASSES, "expected 4 axes of float or uint8"),
        ({"tail": "argmax"}, "kind = 'labels'", CLASSES[:2], "gives the label 2, which none of the 2 classes has"),
    ],
)
def test_models_that_do_not_fit_are_named(tmp_path, arguments, text, classes, message):
    export(tmp_path / "model.onnx", 20 * np.eye(3), **arguments)
    with pytest.raises(InputError, match=message):
        described(tmp_path, text, classes)(Picture(thirds()))


def test_one_channel_of_logits_is_refused(tmp_path):
    export(tmp_path / "model.onnx", np.ones((1, 3)))
    with pytest.raises(InputError, match='one channel of logits is always certain by softmax; write kind = "sigmoid"'):
        described(tmp_path, classes=["soil"])(Picture(thirds()))
    p = described(tmp_path, 'kind = "sigmoid"', ["soil"])(Picture(thirds())).evidence[..., 0]
    np.testing.assert_allclose(p, 1 / (1 + np.exp(-280 / 255)), atol=1e-3)


def test_labels_that_count_from_one_are_named(tmp_path):
    from excavatwin.backbones.segmenters.onnx_description import read_description
    from excavatwin.backbones.segmenters.onnx_session import probabilities

    (tmp_path / "model.onnx").touch()
    described(tmp_path, 'kind = "labels"')
    with pytest.raises(InputError, match=r"gives the label 3, .* count from 1"):
        probabilities(np.array([[[1, 2], [3, 1]]]), read_description(tmp_path / "model.toml"))
    with pytest.raises(InputError, match="not finite"):
        probabilities(np.full((1, 3, 2, 2), np.nan), read_description(tmp_path / "model.toml"))


def test_missing_files_are_named(tmp_path):
    with pytest.raises(InputError, match=r"give --segmenter onnx:FILE\.toml"):
        Onnx()(Picture(thirds()))
    with pytest.raises(InputError, match=r"'nowhere.toml' is not a readable file"):
        Onnx("nowhere.toml")(Picture(thirds()))
    with pytest.raises(InputError, match="but there is no"):
        described(tmp_path)(Picture(thirds()))
    (tmp_path / "model.onnx").write_text("no model")
    with pytest.raises(InputError, match="cannot be opened as an ONNX model"):
        described(tmp_path)(Picture(thirds()))
