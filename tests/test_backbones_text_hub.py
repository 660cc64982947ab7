"""SAM 3, Grounding DINO with SAM, CLIPSeg: real code of transformers, tiny networks, from pixels to evidence."""

import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import text_networks
from excavatwin.backbones.device import Device
from excavatwin.backbones.protocols import Picture, Segmentation
from excavatwin.backbones.segmenters.box_masks import BoxMasks, placed, shown
from excavatwin.backbones.segmenters.clipseg import ClipSeg
from excavatwin.backbones.segmenters.grounded_sam import GroundedSam, passes, phrases
from excavatwin.backbones.segmenters.instances import Tally
from excavatwin.backbones.segmenters.prompts import read_prompts
from excavatwin.backbones.segmenters.sam3 import Sam3
from excavatwin.errors import InputError
from excavatwin.scene.taxonomy import K

torch = pytest.importorskip("torch", reason="needs torch: make test-backbones")
transformers = pytest.importorskip("transformers", reason="needs transformers: make test-backbones")

Folder = Callable[[str], str]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    made: dict[str, str] = {}

    def made_once(name: str) -> str:
        if name not in made:
            made[name] = str(getattr(text_networks, name)(tmp_path_factory.mktemp(name)))
        return made[name]

    return made_once


@pytest.fixture(scope="module")
def words(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("prompts") / "own.toml"
    path.write_text(text_networks.PROMPTS)
    return str(path)


@pytest.fixture(autouse=True)
def _no_network(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("a segmenter reached for the network")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    monkeypatch.setattr(socket, "getaddrinfo", refuse)


NAMES = ("sam3", "clipseg", "grounded-sam 1", "grounded-sam 2")


def segmenter(name: str, folder: Folder, words: str, precision: str = "float32") -> Any:
    device = Device("cpu", precision)  # type: ignore[arg-type]
    if name == "sam3":
        return Sam3(folder("sam3"), words, score=0.05, device=device)
    if name == "clipseg":
        return ClipSeg(folder("clipseg"), words, side=64, threshold=0.1, batch=3, device=device)
    masks = folder("sam") if name.endswith("1") else folder("sam2")
    sides = {"short_side": 96, "long_side": 160}
    return GroundedSam(folder("grounding_dino"), masks, words, score=0.05, device=device, **sides)


def photo(height: int = 53, width: int = 71) -> np.ndarray:
    """Something with edges and colours."""
    rng = np.random.default_rng(1)
    image = rng.integers(0, 60, (height, width, 3), dtype=np.uint8)
    image[height // 3 : height // 2, width // 4 : width // 2] += np.array([180, 120, 10], np.uint8)
    image[: height // 4] += np.array([90, 130, 190], np.uint8)
    return image


def check(seen: Segmentation, shape: tuple[int, int]) -> None:
    assert seen.evidence.shape == (*shape, K)
    assert seen.evidence.dtype == np.float32
    assert (seen.evidence >= 0).all()
    assert (seen.evidence.sum(-1) <= 1).all()
    assert seen.no_surface.shape == shape
    assert seen.no_surface.dtype == bool
    assert not seen.evidence[seen.no_surface].any()


@pytest.mark.parametrize("name", NAMES)
def test_pixels_to_evidence(name: str, folder: Folder, words: str) -> None:
    model = segmenter(name, folder, words)
    for shape in ((53, 71), (64, 31)):
        seen = model(Picture(photo(*shape), "a.jpg"))
        check(seen, shape)
        assert seen.evidence.max() > 0.05
        assert len(np.unique(seen.evidence)) > 2  # not one value everywhere
        again = segmenter(name, folder, words)(Picture(photo(*shape), "a.jpg"))
        assert (again.evidence == seen.evidence).all()


@pytest.mark.parametrize(
    ("name", "kind", "method", "given"),
    [
        ("clipseg", "CLIPSegForImageSegmentation", "get_conditional_embeddings", "input_ids"),
        ("grounded-sam 1", "SamModel", "forward", "input_boxes"),
        ("grounded-sam 2", "Sam2Model", "forward", "input_boxes"),
    ],
)
def test_memory_that_runs_out_means_fewer_at_a_time_and_is_said(
    name: str, kind: str, method: str, given: str, folder: Folder, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = segmenter(name, folder, words)
    whole = model(Picture(photo()))
    home = getattr(transformers, kind)
    real = getattr(home, method)

    def small(self: Any, *more: Any, **named: Any) -> Any:
        if named[given].shape[1 if given == "input_boxes" else 0] > 1:
            raise torch.OutOfMemoryError("CUDA out of memory (injected)")
        return real(self, *more, **named)

    monkeypatch.setattr(home, method, small)
    seen = model(Picture(photo()))
    np.testing.assert_allclose(seen.evidence, whole.evidence, atol=1e-3)  # logits of random networks are large
    assert seen.doubts
    assert all(sentence.startswith("memory ran out with ") for sentence in seen.doubts)
    assert seen.doubts[-1].endswith("at a time; going on with 1.")
    assert not whole.doubts


@pytest.mark.parametrize("name", NAMES)
def test_half_precision_runs(name: str, folder: Folder, words: str) -> None:
    half = segmenter(name, folder, words, "bfloat16")(Picture(photo()))
    check(half, (53, 71))
    assert half.evidence.any()


@pytest.mark.parametrize("name", NAMES)
def test_networks_see_red_as_red(name: str, folder: Folder, words: str) -> None:
    red = np.zeros((40, 60, 3), np.uint8)
    red[..., 0] = 255
    seen = segmenter(name, folder, words).prepare(red)
    assert seen.dtype == np.float32
    assert seen.shape[0] == 3
    assert (seen[0] > seen[1]).all()
    assert (seen[0] > seen[2]).all()


def test_inputs_are_those_of_the_library(folder: Folder, words: str) -> None:
    processors = {
        "sam3": transformers.Sam3ImageProcessor(size={"height": 112, "width": 112}),
        "clipseg": transformers.ViTImageProcessor(
            size={"height": 64, "width": 64}, image_mean=[0.485, 0.456, 0.406], image_std=[0.229, 0.224, 0.225]
        ),
        "grounded-sam 1": transformers.GroundingDinoImageProcessor(size={"shortest_edge": 96, "longest_edge": 160}),
    }
    for shape in ((53, 71), (81, 40)):
        for name, processor in processors.items():
            theirs = processor(images=[photo(*shape)], return_tensors="np")["pixel_values"][0]
            ours = segmenter(name, folder, words).prepare(photo(*shape))
            assert ours.shape == theirs.shape
            assert abs(ours - theirs).max() < 0.03  # two grey levels: roundings of two resizers
        sam = transformers.SamImageProcessor(
            size={"longest_edge": 64}, pad_size={"height": 64, "width": 64}, mask_size={"longest_edge": 16}
        )
        sam2 = transformers.Sam2ImageProcessor(size={"height": 64, "width": 64})
        for kind, processor in (("SamModel", sam), ("Sam2Model", sam2)):
            theirs = processor(images=[photo(*shape)], return_tensors="np")["pixel_values"][0]
            ours = shown(photo(*shape), placed(kind, shape[::-1], 64))
            assert abs(ours - theirs).max() < 0.03


def test_sam3_agrees_with_the_librarys_own_way(folder: Folder, words: str) -> None:
    """Every prompt by a whole forward pass, scores by the library's postprocessing, masks by torch's interpolation."""
    path, prompts = folder("sam3"), read_prompts(words)
    network = transformers.Sam3Model.from_pretrained(path).eval()
    processor = transformers.Sam3Processor(
        transformers.Sam3ImageProcessor(size={"height": 112, "width": 112}),
        transformers.AutoTokenizer.from_pretrained(path),
    )
    model = Sam3(path, words, score=0.2, semantic=False, device=Device("cpu"))
    tally, semantic = Tally.empty((53, 71)), Tally.empty((53, 71))
    with torch.inference_mode():
        pixels = torch.from_numpy(model.prepare(photo()))[None]
        for text, votes in zip(prompts.texts, prompts.votes, strict=True):
            answer = network(pixel_values=pixels, **processor(text=text, return_tensors="pt"))
            (found,) = processor.post_process_instance_segmentation(answer, 0.2, 0.5)
            kept = (answer.pred_logits[0].sigmoid() * answer.presence_logits[0].sigmoid()) > 0.2
            large = torch.nn.functional.interpolate(answer.pred_masks, (53, 71), mode="bilinear")[0, kept]
            assert len(large) == len(found["scores"])
            for logits, score in zip(large, found["scores"], strict=True):
                tally.claim_instance(votes, logits.numpy() > 0, float(score))
            (stuff,) = processor.post_process_semantic_segmentation(answer, [(53, 71)], return_segmentation_scores=True)
            belief = stuff["segmentation_scores"][0].numpy() * float(answer.presence_logits.sigmoid())
            semantic.claim(votes, belief)
    theirs = tally.segmentation()
    ours = model(Picture(photo()))
    assert theirs.evidence.max() > 0.2
    assert (abs(ours.evidence - theirs.evidence).max(-1) < 1e-3).mean() > 0.995
    both = Sam3(path, words, score=0.2, device=Device("cpu"))(Picture(photo())).evidence
    assert (both != ours.evidence).any()
    assert (both.sum(-1) <= np.maximum(tally.strongest, semantic.strongest) + 1e-4).mean() > 0.99


def test_clipseg_agrees_with_the_librarys_own_forward(folder: Folder, words: str) -> None:
    model = segmenter("clipseg", folder, words)
    texts, pixels = read_prompts(words).texts, model.prepare(photo())
    network = transformers.CLIPSegForImageSegmentation.from_pretrained(folder("clipseg")).eval()
    tokens = transformers.AutoTokenizer.from_pretrained(folder("clipseg"))(
        list(texts), padding=True, return_tensors="pt"
    )
    with torch.inference_mode():
        images = torch.from_numpy(pixels)[None].expand(len(texts), -1, -1, -1)
        logits = network(
            pixel_values=images, input_ids=tokens["input_ids"], attention_mask=tokens["attention_mask"]
        ).logits
    np.testing.assert_allclose(model._logits(pixels, texts, 3), logits.numpy(), atol=1e-3, rtol=1e-3)


def test_boxes_are_those_of_the_library(folder: Folder, words: str) -> None:
    model, texts = segmenter("grounded-sam 1", folder, words), ("dirt", "road", "digger arm", "traffic cone")
    network = transformers.GroundingDinoForObjectDetection.from_pretrained(folder("grounding_dino")).eval()
    read = transformers.AutoTokenizer.from_pretrained(folder("grounding_dino"))
    processor = transformers.GroundingDinoProcessor(transformers.GroundingDinoImageProcessor(), read)
    tokens = read("dirt. road. digger arm. traffic cone.", return_tensors="pt")
    with torch.inference_mode():
        answer = network(pixel_values=torch.from_numpy(model.prepare(photo()))[None], **tokens)
    (theirs,) = processor.post_process_grounded_object_detection(answer, tokens["input_ids"], 0.0, 0.0, [(53, 71)])
    boxes, scores, owners = model._boxes(photo(), texts)
    assert len(boxes) == len(theirs["boxes"]) == 9
    probabilities = answer.logits[0].sigmoid().numpy()
    places = {"dirt": [1], "road": [3], "digger arm": [5, 6], "traffic cone": [8, 9]}
    expected = np.stack([probabilities[:, place].mean(-1) for place in places.values()], -1)
    order = np.argsort(-expected.max(-1), kind="stable")
    np.testing.assert_allclose(boxes, theirs["boxes"].numpy()[order].clip(0, [71, 53] * 2), atol=1e-3)
    np.testing.assert_allclose(scores, expected.max(-1)[order], atol=1e-5)
    assert owners.tolist() == expected.argmax(-1)[order].tolist()


def test_prompts_are_read_in_passes_that_fit(folder: Folder) -> None:
    read = transformers.AutoTokenizer.from_pretrained(folder("grounding_dino"))
    texts = ("dirt", "digger arm", "road", "traffic cone", "sky")
    cut = list(passes(texts, read, 9))
    assert [first for first, _ in cut] == [0, 3]
    assert all(len(ids) <= 9 for _, ids in cut)
    assert [phrases(ids, 1012) for _, ids in cut] == [[(1, 2), (3, 5), (6, 7)], [(1, 3), (4, 5)]]
    with pytest.raises(InputError, match="'digger arm' has more than 4 tokens"):
        list(passes(texts, read, 4))
    with pytest.raises(InputError, match=r"'e\.g\. dirt' contains a full stop"):
        list(passes(("e.g. dirt",), read, 99))


@pytest.mark.parametrize(("name", "kind"), [("sam", "SamModel"), ("sam2", "Sam2Model")])
def test_masks_of_boxes_are_those_of_the_library(name: str, kind: str, folder: Folder) -> None:
    boxes = np.array([[10.0, 8, 40, 30], [30, 5, 70, 50], [0, 0, 20, 53]])
    model = BoxMasks(Path(folder(name)), "once", Device("cpu"), batch=2)
    ours = {index: (mask, quality) for index, mask, quality in model(photo(), boxes)}
    assert sorted(ours) == [0, 1, 2]
    network = getattr(transformers, kind).from_pretrained(folder(name)).eval()
    fit = placed(kind, (71, 53), 64)
    given = boxes * np.tile([fit.resized[0] / 71, fit.resized[1] / 53], 2) - 0.5
    with torch.inference_mode():
        pixels = torch.from_numpy(shown(photo(), fit))[None]
        answer = network(pixels, input_boxes=torch.tensor(given, dtype=torch.float32)[None], multimask_output=False)
    if kind == "SamModel":
        processor = transformers.SamImageProcessor(pad_size={"height": 64, "width": 64})
        sizes = ([(53, 71)], [(fit.resized[1], fit.resized[0])])
        (masks,) = processor.post_process_masks(answer.pred_masks, *sizes)
    else:
        (masks,) = transformers.Sam2ImageProcessor().post_process_masks(answer.pred_masks, [(53, 71)])
    for index, (mask, quality) in ours.items():
        assert quality == pytest.approx(float(answer.iou_scores[0, index, 0].clamp(0, 1)), abs=1e-4)
        assert (mask == masks[index, 0].numpy()).mean() > 0.97  # SAM 1 interpolates twice, through 64 px


def test_masks_need_a_sam(folder: Folder, words: str) -> None:
    model = GroundedSam(folder("grounding_dino"), folder("clipseg"), words, score=0.05, short_side=96, long_side=160)
    with pytest.raises(InputError, match=r"network of type clipseg.*sam, sam2"):
        model(Picture(photo()))


def test_incomplete_weights_are_refused(folder: Folder, words: str, tmp_path: Path) -> None:
    from safetensors.torch import load_file, save_file

    for file in Path(folder("clipseg")).iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    tensors = load_file(tmp_path / "model.safetensors")
    lost = next(name for name in tensors if name.startswith("decoder.layers.0"))
    save_file({k: v for k, v in tensors.items() if k != lost}, tmp_path / "model.safetensors", {"format": "pt"})
    with pytest.raises(InputError, match=f"lack 1 of the parameters of CLIPSegForImageSegmentation.*{lost}"):
        ClipSeg(str(tmp_path), words, side=64)(Picture(photo()))
    (tmp_path / "model.safetensors").write_bytes(b"nonsense")
    with pytest.raises(InputError, match="cannot be read as CLIPSegForImageSegmentation"):
        ClipSeg(str(tmp_path), words, side=64)(Picture(photo()))
    (tmp_path / "config.json").unlink()
    with pytest.raises(InputError, match=r"holds no config\.json"):
        ClipSeg(str(tmp_path), words, side=64)(Picture(photo()))


def test_a_folder_without_tokenizer_is_said(folder: Folder, words: str, tmp_path: Path) -> None:
    for name in ("config.json", "model.safetensors"):
        (tmp_path / name).write_bytes((Path(folder("clipseg")) / name).read_bytes())
    with pytest.raises(InputError, match="holds no tokenizer"):
        ClipSeg(str(tmp_path), words, side=64)(Picture(photo()))


@pytest.mark.parametrize("name", ["sam3", "grounded-sam 2"])
def test_identity_names_libraries_weights_and_prompts(name: str, folder: Folder, words: str, tmp_path: Path) -> None:
    known = segmenter(name, folder, words).identity()
    assert "transformers" in known
    assert "model.safetensors" in known
    other = tmp_path / "own.toml"
    other.write_text(text_networks.PROMPTS.replace("soil", "mud"))
    assert segmenter(name, folder, str(other)).identity() != known
