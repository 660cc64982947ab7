"""Mask2Former, OneFormer, EoMT and SegFormer: transformers' own code with small random weights, whole adapters."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from excavatwin.backbones.device import Device
from excavatwin.backbones.protocols import Picture, Segmenter
from excavatwin.backbones.segmenters.eomt import Eomt
from excavatwin.backbones.segmenters.mask2former import Mask2Former
from excavatwin.backbones.segmenters.oneformer import TASK, OneFormer, task_tokens
from excavatwin.backbones.segmenters.pretrained import opened
from excavatwin.backbones.segmenters.readings import ClassLogits, ClassMasks
from excavatwin.backbones.segmenters.resampling import bilinear, centres
from excavatwin.backbones.segmenters.segformer import Segformer
from excavatwin.backbones.segmenters.windows import Window, gathered, split
from excavatwin.errors import InputError
from excavatwin.scene.taxonomy import TaskClass
from excavatwin.vocabularies import resolve

torch = pytest.importorskip("torch", reason="needs torch: make test-backbones")
pytest.importorskip("transformers", reason="needs transformers: make test-backbones")

import closed_vocabulary_networks as networks  # noqa: E402

# huggingface_hub leaves config.json to the garbage collector to close.
pytestmark = pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")

ADAPTERS = {
    "mask2former": Mask2Former,
    "oneformer": OneFormer,
    "segformer": Segformer,
    "eomt": Eomt,
    "eomt_dinov3": Eomt,
}
CPU = Device("cpu", "float32")


@pytest.fixture(scope="module")
def shelf(tmp_path_factory) -> Mapping[str, Path]:
    """Weights of every network."""
    return {kind: networks.save(kind, tmp_path_factory.mktemp(kind)) for kind in ADAPTERS}


@pytest.fixture
def image() -> np.ndarray:
    """A picture of the size of a VGGT lattice, with large and small things in it."""
    rng = np.random.default_rng(3)
    coarse = np.kron(rng.integers(0, 256, (8, 10, 3)), np.ones((50, 52, 1)))[:393, :518]
    return np.clip(coarse + rng.normal(0, 20, coarse.shape), 0, 255).astype(np.uint8)


def adapter(kind: str, folder: Path, **fields: Any) -> Any:
    return ADAPTERS[kind](weights=str(folder), device=fields.pop("device", CPU), **fields)


def network(one: Any) -> Any:
    """The module that the adapter asks."""
    from excavatwin.backbones import weights

    folder = weights.need(one.card, one.weights)
    kind = one.kinds[json.loads((folder / "config.json").read_text())["model_type"]]
    return opened(kind, folder, weights.fingerprint(one.card, one.weights), "cpu").model


# --- the whole adapter


@pytest.mark.parametrize("kind", ADAPTERS)
@pytest.mark.parametrize("size", [(393, 518), (97, 41), (60, 260)])
def test_evidence_lies_on_the_pixels_of_the_picture_and_is_evidence(kind, size, shelf, image):
    one = adapter(kind, shelf[kind])
    assert isinstance(one, Segmenter)
    seen = one(Picture(image[: size[0], : size[1]]))
    assert seen.evidence.shape == (*size, 5)
    assert seen.evidence.dtype == np.float32
    assert seen.no_surface.shape == size
    assert seen.no_surface.dtype == bool
    assert np.isfinite(seen.evidence).all()
    assert seen.evidence.min() >= 0
    assert seen.evidence.sum(-1).max() <= 1 + 1e-6
    assert seen.evidence.std() > 1e-3  # the networks are alive
    assert (seen.evidence[seen.no_surface] == 0).all()
    assert seen.doubts == ()


@pytest.mark.parametrize("kind", ADAPTERS)
def test_the_same_picture_gives_the_same_evidence_also_from_a_network_opened_anew(kind, shelf, image):
    one = adapter(kind, shelf[kind])
    first = one(Picture(image))
    again = one(Picture(image))
    opened.cache_clear()
    anew = one(Picture(image))
    assert np.array_equal(first.evidence, again.evidence)
    assert np.array_equal(first.evidence, anew.evidence)


def test_a_network_is_opened_once_for_all_pictures_and_two_are_kept(shelf, image):
    opened.cache_clear()
    small = image[:40, :50]
    for _ in range(2):
        for kind in ("mask2former", "segformer"):
            adapter(kind, shelf[kind])(Picture(small))
    assert opened.cache_info().misses == 2
    assert opened.cache_info().maxsize == 2


@pytest.mark.parametrize("kind", ADAPTERS)
def test_bfloat16_says_the_same_but_for_rounding(kind, shelf, image):
    full = adapter(kind, shelf[kind])(Picture(image[:120, :160])).evidence
    half = adapter(kind, shelf[kind], device=Device("cpu", "bfloat16"))(Picture(image[:120, :160])).evidence
    assert np.abs(full - half).mean() < 0.02
    assert not np.array_equal(full, half)


# --- the naive twin: everything at full size, one loop per formula


def naive(kind: str, one: Any, image: np.ndarray) -> np.ndarray:
    """p(v) on the pixels of a picture (H, W, V), from the network's own output."""
    with torch.inference_mode():
        model, seen = network(one), torch.from_numpy(one.prepare(image))[None]
        size = image.shape[:2]
        if kind == "segformer":
            logits = torch.nn.functional.interpolate(
                model(pixel_values=seen).logits, size=size, mode="bilinear", align_corners=False
            )
            return logits[0].softmax(0).permute(1, 2, 0).numpy()
        more = {}
        if kind == "oneformer":
            more = {"task_inputs": torch.from_numpy(task_tokens(Path(one.weights), 77))[None]}
        told = model(pixel_values=seen, **more)
        masks = torch.nn.functional.interpolate(
            told.masks_queries_logits, size=size, mode="bilinear", align_corners=False
        )
        return naive_masks(told.class_queries_logits[0].numpy(), masks[0].numpy())


def naive_masks(classes: np.ndarray, masks: np.ndarray) -> np.ndarray:
    """S_v = sum_q P_q(v) m_q, divided where the classes share out more than 1; query by query, class by class."""
    H, W = masks.shape[1:]
    V = classes.shape[1] - 1
    S = np.zeros((H, W, V))
    for q in range(len(classes)):
        e = np.exp(classes[q].astype(float) - classes[q].max())
        m = 0.5 * (1 + np.tanh(masks[q].astype(float) / 2))
        for v in range(V):
            S[..., v] += e[v] / e.sum() * m
    return S / np.maximum(S.sum(-1, keepdims=True), 1)


@pytest.mark.parametrize("kind", ["mask2former", "oneformer", "segformer"])
@pytest.mark.parametrize("size", [(131, 173), (60, 44)])
def test_evidence_is_what_the_naive_twin_says(kind, size, shelf, image):
    one = adapter(kind, shelf[kind])
    image = image[: size[0], : size[1]]
    meaning = resolve(tuple(networks.ADE.values()))
    p = naive(kind, one, image)
    none = p @ meaning.no_surface > 0.5
    expected = np.where(none[..., None], 0, p @ meaning.weights)
    seen = one(Picture(image))
    np.testing.assert_allclose(seen.evidence, expected, atol=2e-4)
    assert np.array_equal(seen.no_surface, none)


def test_windows_of_eomt_are_averaged_as_the_naive_twin_does(shelf, image):
    image = np.asarray(image[:64, :150])  # at the network's own scale: windows at 0, 43 and 86
    one = adapter("eomt", shelf["eomt"])
    seen = torch.from_numpy(one.prepare(image))[None]
    assert seen.shape[-2:] == (64, 150)
    total, times = np.zeros((64, 150, 150)), np.zeros((64, 150, 1))
    with torch.inference_mode():
        for start in (0, 43, 86):
            told = network(one)(pixel_values=seen[..., start : start + 64])
            masks = torch.nn.functional.interpolate(
                told.masks_queries_logits, size=(64, 64), mode="bilinear", align_corners=False
            )
            total[:, start : start + 64] += naive_masks(told.class_queries_logits[0].numpy(), masks[0].numpy())
            times[:, start : start + 64] += 1
    meaning = resolve(tuple(networks.ADE.values()))
    p = total / times
    expected = np.where((p @ meaning.no_surface > 0.5)[..., None], 0, p @ meaning.weights)
    np.testing.assert_allclose(one(Picture(image)).evidence, expected, atol=2e-4)


def test_masks_are_evidence_only_as_far_as_queries_claim_them():
    sure, off = 20.0, -20.0
    classes = torch.tensor([[sure, 0, 0], [0, sure, 0], [0, 0, sure]])  # class 0, class 1, "no object"
    masks = torch.tensor([[[sure, sure, off, off]], [[off, sure, off, off]], [[sure, sure, sure, off]]])
    at = ClassMasks(classes, masks).at(centres(1, 1), centres(4, 4), np.eye(2, dtype=np.float32)).numpy()[:, 0]
    # Alone; two that claim one pixel; only "no object"; nobody. A sure "no object" takes nothing from the others.
    np.testing.assert_allclose(at, [[1, 0.5, 0, 0], [0, 0.5, 0, 0]], atol=1e-5)
    half = ClassMasks(torch.tensor([[1.0, 0, 1.0]]).log(), masks[:1])  # half class 0, half "no object"
    at = half.at(centres(1, 1), centres(4, 4), np.eye(2, dtype=np.float32)).numpy()[:, 0]
    np.testing.assert_allclose(at, [[0.5, 0.5, 0, 0], [0, 0, 0, 0]], atol=1e-5)


# --- alignment


@pytest.mark.parametrize(("cells", "pixels"), [(12, 48), (12, 49), (40, 13), (7, 518), (1, 5), (5, 5)])
def test_resampling_is_torchs_with_pixel_centres_at_one_half(cells, pixels):
    values = torch.randn(2, cells, cells + 3, generator=torch.Generator().manual_seed(0))
    got = bilinear(values, centres(pixels, cells), centres(pixels + 1, cells + 3))
    expected = torch.nn.functional.interpolate(
        values[None], size=(pixels, pixels + 1), mode="bilinear", align_corners=False
    )[0]
    torch.testing.assert_close(got, expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("windows", [[Window(0, 64, 0, 64)], split((64, 150), 64)])
@pytest.mark.parametrize("width", [150, 151, 75, 518])
def test_a_step_between_two_cells_lands_between_the_same_two_pixels(windows, width):
    """Class 1 right of x = 60 of the input, whatever the windows and the picture's size."""
    shape = (64, max(window.right for window in windows))
    edge = 40
    readings = []
    for window in windows:
        cells = window.left + 4 * np.arange((window.right - window.left) // 4) + 2  # centres of the cells, input px
        step = torch.from_numpy(np.clip((cells - edge) / 4, -1, 1)).float()  # 0 exactly at the edge
        readings.append(ClassLogits(torch.stack([-step, step]).unsqueeze(1).expand(2, 16, -1)))
    columns = np.array([[0], [1]], np.float32)
    p = gathered(readings, windows, shape, (48, width), columns)[24, :, 0]
    at = np.interp(0.5, p, np.arange(width) + 0.5)
    assert at == pytest.approx(edge * width / shape[1], abs=1e-3 * width / shape[1] + 1e-3)


def test_the_padding_of_an_input_shows_nothing_of_the_picture():
    """The picture fills the upper 40 of 64 rows; what the network says of the rest must not be read."""
    logits = torch.full((2, 16, 16), -5.0)
    logits[0, :10], logits[1, 10:] = 5.0, 5.0
    p = gathered([ClassLogits(logits)], [Window(0, 64, 0, 64)], (40, 64), (80, 128), np.eye(2, dtype=np.float32))
    assert (p[:76, :, 0] > 0.99).all()
    assert (p[76:, :, 0] >= 0.5 - 1e-3).all()  # the last cell is interpolated with its neighbour in the padding


def test_strips_do_not_change_the_result(monkeypatch):
    from excavatwin.backbones.segmenters import windows

    logits = ClassLogits(torch.randn(3, 9, 11, generator=torch.Generator().manual_seed(1)))
    args = ([Window(0, 36, 0, 44)], (36, 44), (50, 61), np.eye(3, dtype=np.float32))
    at_once = gathered([logits], *args)
    monkeypatch.setattr(windows, "_AT_ONCE", 3 * 61 * 7)
    np.testing.assert_allclose(gathered([logits], *args), at_once, atol=1e-6)


@dataclass(frozen=True)
class Bluish(Segformer):
    """SegFormer whose network is replaced by one that knows what it says: blue is sky, the rest is earth."""

    def look(self, network: Any, pixels: Any, folder: Path) -> ClassLogits:
        blue = torch.nn.functional.avg_pool2d(pixels[0, 2:3] - pixels[0, 0:1], 4)[0]
        logits = torch.full((150, *blue.shape), -30.0)
        ids = {name: number for number, name in networks.ADE.items()}
        between = (normal(BLUE) + normal(BROWN)) / 2
        logits[ids["sky"]], logits[ids["earth"]] = 8 * (blue - between), 8 * (between - blue)
        return ClassLogits(logits)


BLUE, BROWN = (60, 110, 150), (150, 110, 60)


def normal(colour: tuple[int, int, int]) -> float:
    """Blue less red, as the network gets them."""
    red, _, blue = ((np.array(colour) / 255) - [0.485, 0.456, 0.406]) / [0.229, 0.224, 0.225]
    return float(blue - red)


@pytest.mark.parametrize("size", [(393, 518), (392, 518), (97, 301), (640, 480)])
def test_what_the_network_sees_at_a_place_is_said_of_that_place(size, shelf):
    """From the pixels of the picture to the network and back: blue above, brown below."""
    border = size[0] * 2 // 5
    image = np.full((*size, 3), BROWN, np.uint8)
    image[:border] = BLUE
    one = Bluish(str(shelf["segformer"]), CPU)
    seen = one(Picture(image))
    cell = 4 * size[0] / one.prepare(image).shape[1]  # of the network's output, in pixels of the picture
    found = np.argmin(seen.no_surface, axis=0)
    assert np.abs(found - border).max() <= max(0.2 * cell, 1)  # a shift by half a cell is 0.5
    assert seen.evidence[border + int(2 * cell) :, :, TaskClass.CONSTRUCTION_TERRAIN - 1].min() > 0.95


# --- what reaches the network


@pytest.mark.parametrize("kind", ADAPTERS)
@pytest.mark.parametrize(("colour", "channel"), [((255, 0, 0), 0), ((0, 255, 0), 1), ((0, 0, 255), 2)])
def test_the_network_gets_rgb_normalised_as_imagenet(kind, colour, channel, shelf):
    one = adapter(kind, shelf[kind])
    image = np.full((50, 70, 3), colour, np.uint8)
    caught = []
    hook = network(one).register_forward_pre_hook(
        lambda module, args, named: caught.append(named["pixel_values"].clone()), with_kwargs=True
    )
    try:
        one(Picture(image))
    finally:
        hook.remove()
    mean, std = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])
    expected = ((np.arange(3) == channel) - mean) / std
    for seen in caught:
        np.testing.assert_allclose(seen[0].mean((1, 2)).numpy(), expected, rtol=1e-4)
    assert caught[0].shape[-2] == one.prepare(image).shape[1]
    np.testing.assert_allclose(one.prepare(image).mean((1, 2)), expected, rtol=1e-4)


@pytest.mark.parametrize(("kind", "processor"), [("mask2former", "Mask2Former"), ("eomt", "Eomt")])
def test_the_input_is_that_of_the_librarys_own_processor(kind, processor, shelf, image):
    pytest.importorskip("torchvision", reason="the library's processors need torchvision")
    import transformers

    one = adapter(kind, shelf[kind])
    theirs = getattr(transformers, f"{processor}ImageProcessor").from_pretrained(shelf[kind])
    pixels = theirs(images=torch.from_numpy(image.transpose(2, 0, 1)), return_tensors="pt")["pixel_values"]
    ours = one.prepare(image)
    if kind == "eomt":
        ours = np.stack([ours[:, w.rows, w.columns] for w in split(ours.shape[1:], 64)])
        pixels = torch.stack(list(pixels))
    else:
        ours = ours[None]
    assert ours.shape == tuple(pixels.shape)
    assert np.abs(ours - pixels.numpy()).max() < 2.1 / 255 / 0.224  # rounding of two resamplers
    assert np.abs(ours - pixels.numpy()).mean() < 0.01


def test_long_side_sets_the_input_and_0_is_what_the_weights_say(shelf, image):
    assert adapter("mask2former", shelf["mask2former"]).prepare(image).shape == (3, 96, 128)
    one = adapter("mask2former", shelf["mask2former"], long_side=256)
    assert one.prepare(image).shape == (3, 224, 256)  # 194 up to a multiple of 32
    assert one(Picture(image)).evidence.shape == (393, 518, 5)


def test_oneformer_is_told_its_task_in_words(shelf):
    tokens = task_tokens(shelf["oneformer"], 77)
    spelt = TASK.replace(" ", "")
    assert tokens.shape == (77,)
    assert (tokens[len(spelt) + 2 :] == 0).all()
    vocabulary = json.loads((shelf["oneformer"] / "tokenizer.json").read_text())["model"]["vocab"]
    words = {number: word for word, number in vocabulary.items()}
    said = "".join(words[number] for number in tokens[1 : len(spelt) + 1])
    assert said.replace("</w>", " ").strip() == TASK
    assert words[tokens[0]] == "<|startoftext|>"
    assert words[tokens[len(spelt) + 1]] == "<|endoftext|>"


def test_without_its_tokenizer_oneformer_is_refused_and_not_given_an_empty_one(shelf, tmp_path, image):
    bare = shutil.copytree(shelf["oneformer"], tmp_path / "bare")
    for file in bare.glob("tokenizer*"):
        file.unlink()
    with pytest.raises(InputError, match=r"tokenizer.*vocab\.json"):
        adapter("oneformer", bare)(Picture(image[:40, :50]))


# --- classes


def patched(shelf: Mapping[str, Path], kind: str, folder: Path, name: str | None, strength: float = 60.0) -> Path:
    """The network, made sure of one class (None: of "no object") by the bias of its classifier."""
    from safetensors.torch import load_file, save_file

    shutil.copytree(shelf[kind], folder)
    state = load_file(folder / "model.safetensors")
    (bias,) = [key for key in state if key.endswith(BIAS[kind])]
    number = {label: i for i, label in networks.ADE.items()}.get(name or "", 150)
    state[bias][:] = 0
    state[bias][number] = strength
    save_file(state, folder / "model.safetensors", metadata={"format": "pt"})
    return folder


BIAS = {
    "mask2former": "class_predictor.bias",
    "eomt": "class_predictor.bias",
    "segformer": "classifier.bias",
    "oneformer": "decoder.class_embed.bias",
}


@pytest.mark.parametrize("kind", ["mask2former", "oneformer", "eomt"])
def test_no_object_everywhere_is_no_evidence_at_all(kind, shelf, tmp_path, image):
    seen = adapter(kind, patched(shelf, kind, tmp_path / "w", None, 400.0))(Picture(image[:80, :90]))
    assert seen.evidence.max() < 1e-6
    assert not seen.no_surface.any()


def test_sky_has_no_surface_and_earth_is_construction_terrain(shelf, tmp_path, image):
    sky = adapter("segformer", patched(shelf, "segformer", tmp_path / "sky", "sky"))(Picture(image[:80, :90]))
    assert sky.no_surface.all()
    assert (sky.evidence == 0).all()
    earth = adapter("segformer", patched(shelf, "segformer", tmp_path / "earth", "earth"))(Picture(image[:80, :90]))
    assert not earth.no_surface.any()
    assert earth.evidence[..., TaskClass.CONSTRUCTION_TERRAIN - 1].min() > 0.99


def test_the_users_remap_and_mapping_stand_above(shelf, tmp_path, image):
    folder = patched(shelf, "segformer", tmp_path / "earth", "earth")
    own = adapter("segformer", folder, remap={"earth": "obstacle"})
    assert own(Picture(image[:40, :50])).evidence[..., TaskClass.OBSTACLE - 1].min() > 0.99
    plain = adapter("segformer", folder)
    strict = adapter("segformer", folder, mapping="ade20k-150:strict")
    assert len({own.identity(), plain.identity(), strict.identity()}) == 3


def test_identity_tells_weights_apart(shelf, tmp_path):
    other = networks.save("segformer", tmp_path, seed=1)
    assert adapter("segformer", other).identity() != adapter("segformer", shelf["segformer"]).identity()
    assert adapter("segformer", other).identity() == adapter("segformer", other).identity()
    assert "transformers" in adapter("segformer", other).identity()


def test_classes_that_no_mapping_covers_are_all_listed(shelf, tmp_path, image):
    labels = networks.ADE | {3: "flux capacitor", 7: "hoverboard"}
    folder = networks.save("segformer", tmp_path, labels)
    with pytest.raises(InputError, match=r"flux capacitor.*hoverboard.*--map"):
        adapter("segformer", folder)(Picture(image[:40, :50]))
    both = {"flux capacitor": "obstacle", "hoverboard": "nothing"}
    assert adapter("segformer", folder, remap=both)(Picture(image[:40, :50])).evidence.shape == (40, 50, 5)


def test_weights_without_class_names_are_taken_as_the_user_says_and_it_is_told(shelf, tmp_path, image):
    folder = networks.save("eomt", tmp_path, None)
    with pytest.raises(InputError, match=r"do not name their classes.*--eomt\.mapping"):
        adapter("eomt", folder)(Picture(image[:40, :50]))
    seen = adapter("eomt", folder, mapping="ade20k-150")(Picture(image[:40, :50]))
    named = adapter("eomt", shelf["eomt"])(Picture(image[:40, :50]))
    assert np.array_equal(seen.evidence, named.evidence)
    assert any("ade20k-150" in doubt for doubt in seen.doubts)
    strict = adapter("eomt", folder, mapping="ade20k-150:strict")(Picture(image[:40, :50]))
    assert not np.array_equal(strict.evidence, named.evidence)
    with pytest.raises(InputError, match="do not name their classes"):
        adapter("eomt", folder, mapping=":strict").identity()
    with pytest.raises(InputError, match=r"150 classes, but 19"):
        adapter("eomt", folder, mapping="cityscapes")(Picture(image[:40, :50]))


# --- what goes wrong


def test_weights_that_lack_parameters_are_refused_and_not_filled_with_chance(shelf, tmp_path, image):
    from safetensors.torch import load_file, save_file

    folder = shutil.copytree(shelf["segformer"], tmp_path / "w")
    state = load_file(folder / "model.safetensors")
    del state["decode_head.classifier.weight"]
    save_file(state, folder / "model.safetensors", metadata={"format": "pt"})
    with pytest.raises(InputError, match=r"lack 1 .*decode_head\.classifier\.weight"):
        adapter("segformer", folder)(Picture(image[:40, :50]))


def test_damaged_weights_are_named(shelf, tmp_path, image):
    folder = shutil.copytree(shelf["segformer"], tmp_path / "w")
    (folder / "model.safetensors").write_bytes(b"no weights")
    with pytest.raises(InputError, match="cannot be read as Segformer"):
        adapter("segformer", folder)(Picture(image[:40, :50]))


def test_the_file_of_the_weights_may_be_named_and_a_pickle_is_read_too(shelf, tmp_path, image):
    from safetensors.torch import load_file

    folder = shutil.copytree(shelf["segformer"], tmp_path / "w")
    torch.save(load_file(folder / "model.safetensors"), folder / "pytorch_model.bin")
    (folder / "model.safetensors").unlink()
    seen = adapter("segformer", folder / "pytorch_model.bin")(Picture(image))
    assert np.array_equal(seen.evidence, adapter("segformer", shelf["segformer"])(Picture(image)).evidence)


def test_when_memory_runs_out_the_input_is_halved_and_it_is_said(shelf, image):
    one = adapter("mask2former", shelf["mask2former"], long_side=1024)
    hook = network(one).register_forward_pre_hook(_short_of_memory(600), with_kwargs=True)
    try:
        seen = one(Picture(image))
    finally:
        hook.remove()
    assert seen.doubts == ("memory ran out with 1024 px on the long side of the network's input; going on with 512.",)
    assert seen.evidence.shape == (393, 518, 5)
    smaller = adapter("mask2former", shelf["mask2former"], long_side=512)
    assert np.array_equal(seen.evidence, smaller(Picture(image)).evidence)


@pytest.mark.parametrize("kind", ["mask2former", "eomt"])
def test_when_memory_does_not_suffice_at_all_the_error_says_what_to_do(kind, shelf, image):
    one = adapter(kind, shelf[kind])
    hook = network(one).register_forward_pre_hook(_short_of_memory(0), with_kwargs=True)
    try:
        with pytest.raises(InputError, match=r"memory ran out.*device\.name cpu"):
            one(Picture(image))
    finally:
        hook.remove()


def _short_of_memory(limit: int) -> Any:
    def refuse(module: Any, args: Any, named: dict[str, Any]) -> None:
        if max(named["pixel_values"].shape) > limit:
            raise RuntimeError("CUDA out of memory (injected)")

    return refuse


# --- EoMT's own


def test_masked_attention_is_off_unless_the_weights_say_it_is_on(shelf, tmp_path, image):
    from safetensors.torch import load_file, save_file

    state = load_file(shelf["eomt"] / "model.safetensors")
    results = {}
    for name, value in (("on", 1.0), ("off", 0.0), ("between", 0.5), ("unsaid", None)):
        folder = shutil.copytree(shelf["eomt"], tmp_path / name)
        changed = {key: tensor for key, tensor in state.items() if key != "attn_mask_probs"}
        if value is not None:
            changed["attn_mask_probs"] = torch.full_like(state["attn_mask_probs"], value)
        save_file(changed, folder / "model.safetensors", metadata={"format": "pt"})
        results[name] = adapter("eomt", folder)(Picture(image)).evidence
    assert not np.array_equal(results["on"], results["off"])
    assert np.array_equal(results["off"], results["unsaid"])
    assert np.array_equal(results["off"], results["between"])


def test_panoptic_weights_see_the_picture_padded(shelf, tmp_path, image):
    folder = shutil.copytree(shelf["eomt"], tmp_path / "w")
    settings = {"size": {"shortest_edge": 64, "longest_edge": 64}, "do_pad": True, "do_split_image": False}
    (folder / "preprocessor_config.json").write_text(json.dumps(settings))
    one = adapter("eomt", folder)
    seen = one.prepare(image)
    assert seen.shape == (3, 64, 64)
    black = -np.array([0.485, 0.456, 0.406]) / np.array([0.229, 0.224, 0.225])
    np.testing.assert_allclose(seen[:, 49:], np.broadcast_to(black[:, None, None], (3, 15, 64)), rtol=1e-5)
    assert one(Picture(image)).evidence.shape == (393, 518, 5)
    small = np.asarray(image[:49, :64])  # at the network's own scale
    with torch.inference_mode():
        told = network(one)(pixel_values=torch.from_numpy(one.prepare(small))[None])
        masks = torch.nn.functional.interpolate(
            told.masks_queries_logits, size=(64, 64), mode="bilinear", align_corners=False
        )
    p = naive_masks(told.class_queries_logits[0].numpy(), masks[0, :, :49].numpy())
    meaning = resolve(tuple(networks.ADE.values()))
    expected = np.where((p @ meaning.no_surface > 0.5)[..., None], 0, p @ meaning.weights)
    np.testing.assert_allclose(one(Picture(small)).evidence, expected, atol=2e-4)
