"""YOLOE: Ultralytics' real network (random weights) from its YAML, by words, reference photos and built-in words."""

import os
import pickle
import socket
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import text_networks
from excavatwin.backbones.device import Device
from excavatwin.backbones.protocols import Picture
from excavatwin.backbones.segmenters import sight, yoloe_network, yoloe_prompts
from excavatwin.backbones.segmenters.prompts import read_prompts
from excavatwin.backbones.segmenters.yoloe import Yoloe, inside
from excavatwin.errors import InputError, MissingExtraError
from excavatwin.scene.taxonomy import K, TaskClass

torch = pytest.importorskip("torch", reason="needs torch: make test-backbones")
pytest.importorskip("ultralytics", reason="needs ultralytics: make test-backbones")

#: The text encoder is TorchScript, as Ultralytics publishes it; making one for the test is deprecated by torch.
pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit:FutureWarning")

TEXTS = ("dirt", "soil", "road", "grass", "excavator", "zygote", "traffic cone", "sky")
SIZE = 160


@pytest.fixture(autouse=True)
def _no_network(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("a segmenter reached for the network")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    monkeypatch.setattr(socket, "getaddrinfo", refuse)


class _Encoder(torch.nn.Module):
    """A text encoder: tokens to unit vectors, different for every text."""

    def __init__(self) -> None:
        super().__init__()
        self.waves = torch.nn.Parameter(torch.rand(512) * 3)

    def forward(self, tokens: Any) -> Any:
        place = torch.arange(1, tokens.shape[1] + 1, device=tokens.device)[None, :, None]
        waves = torch.sin((tokens[..., None] + place) * self.waves)[:, 1:]  # all texts begin alike
        return torch.nn.functional.normalize((waves * (tokens[:, 1:, None] > 0)).sum(1), dim=-1)


def lively(network: Any) -> Any:
    """Scores around one half that depend on the place: a fresh network says 0.0001 everywhere."""
    head = network.model[-1]
    for name, parameter in network.named_parameters():
        if parameter.ndim == 4 and "dfl" not in name:
            torch.nn.init.kaiming_normal_(parameter)
    for branch in (*head.cv2, *(getattr(head, "one2one_cv2", None) or ())):  # boxes of six cells, more or less
        torch.nn.init.normal_(branch[-1].weight, 0, 0.01)
        bins = -3 * (torch.arange(16) - 3).abs().float() if head.reg_max > 1 else torch.full((1,), 3.0)
        branch[-1].bias.data.copy_(bins.repeat(4))
    for branch in ("cv4", "one2one_cv4"):
        for layer in getattr(head, branch, None) or ():
            layer.bias.data.fill_(0)
            layer.logit_scale.data.fill_(3)
    return network


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with weights of three kinds, a text encoder and prompts."""
    yoloe_network.quietly()
    from safetensors.torch import save_file
    from ultralytics import YOLOE

    folder = tmp_path_factory.mktemp("yoloe")
    (folder / "prompts.toml").write_text(text_networks.PROMPTS)
    torch.manual_seed(0)
    example = torch.zeros(2, 77, dtype=torch.long)
    torch.jit.trace(_Encoder().eval(), example).save(folder / "mobileclip_blt.ts")
    promptable = YOLOE("yoloe-11n-seg.yaml")
    lively(promptable.model)
    promptable.save(folder / "yoloe-11n-seg.pt")
    (folder / "hub").mkdir()
    (folder / "hub" / "config.json").write_text('{"model": "yoloe-11n-seg.yaml"}')
    saved = promptable.model.half().float().state_dict()  # .pt files are saved in half precision
    save_file({f"model.{name}": value.contiguous() for name, value in saved.items()}, folder / "hub/model.safetensors")
    embeddings = torch.nn.functional.normalize(torch.randn(1, len(TEXTS), 512), dim=-1)
    free = YOLOE("yoloe-11n-seg.yaml")
    lively(free.model).eval()
    free.model.set_classes(list(TEXTS), embeddings)
    free.model.model[-1].fuse(free.model.pe)
    vocabulary = torch.nn.ModuleList(branch[-1] for branch in free.model.model[-1].cv3)
    free.model.args = {**(free.model.args if isinstance(free.model.args, dict) else vars(free.model.args)), "imgsz": 64}
    free.model.set_vocab(vocabulary, list(TEXTS))
    free.save(folder / "yoloe-11n-seg-pf.pt")
    newer = YOLOE("yoloe-26n-seg.yaml")
    lively(newer.model).model[-1].end2end = True  # suppresses repeated boxes by itself
    newer.save(folder / "yoloe-26n-seg.pt")
    (folder / "mobileclip2_b.ts").write_bytes((folder / "mobileclip_blt.ts").read_bytes())
    yield folder
    for cache in (yoloe_network.opened, yoloe_prompts.worded, yoloe_prompts.referenced):
        cache.cache_clear()


def yoloe(home: Path, name: str = "yoloe-11n-seg.pt", **fields: Any) -> Yoloe:
    given: dict[str, Any] = {"prompts": str(home / "prompts.toml"), "score": 0.5, "long_side": SIZE, "most": 300}
    return Yoloe(str(home / name), device=Device("cpu"), **(given | fields))


def photo(height: int = 53, width: int = 71) -> np.ndarray:
    rng = np.random.default_rng(2)
    image = rng.integers(0, 60, (height, width, 3), dtype=np.uint8)
    image[height // 3 : height // 2, width // 4 : width // 2] += np.array([180, 120, 10], np.uint8)
    image[: height // 4] += np.array([90, 130, 190], np.uint8)
    return image


def check(seen: Any, shape: tuple[int, int], least: float = 0.3) -> None:
    assert seen.evidence.shape == (*shape, K)
    assert seen.evidence.dtype == np.float32
    assert (seen.evidence >= 0).all()
    assert (seen.evidence.sum(-1) <= 1).all()
    assert seen.no_surface.shape == shape
    assert seen.evidence.max() >= least


def test_memory_that_runs_out_means_a_smaller_input_and_is_said(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real, sides = yoloe_network.detect, []

    def small(network: Any, pixels: Any, *more: Any) -> Any:
        sides.append(max(pixels.shape[-2:]))
        if sides[-1] > 256:
            raise torch.OutOfMemoryError("CUDA out of memory (injected)")
        return real(network, pixels, *more)

    monkeypatch.setattr(yoloe_network, "detect", small)
    seen = yoloe(home, long_side=512)(Picture(photo()))
    assert sides == [512, 256]
    assert seen.doubts[0] == (
        "memory ran out with 16 x 32 px on the long side of the network's input; going on with 8."
    )
    monkeypatch.setattr(yoloe_network, "detect", lambda *_: small(None, torch.empty(1, 3, 512, 512)))
    with pytest.raises(InputError, match="memory ran out with 5 x 32 px"):
        yoloe(home)(Picture(photo()))


def references(home: Path, tmp_path: Path) -> str:
    from PIL import Image

    for name in ("a", "b"):
        Image.fromarray(photo(60, 90)).save(tmp_path / f"{name}.png")
    text = """
        [[reference]]
        image = "a.png"
        obstacle = [[5, 5, 30, 30], [60, 20, 85, 55]]
        excavator = [[20, 20, 50, 45]]
        [[reference]]
        image = "b.png"
        no_surface = [[0, 0, 90, 16]]
    """
    (tmp_path / "references.toml").write_text(text)
    return str(tmp_path / "references.toml")


@pytest.mark.parametrize("name", ["yoloe-11n-seg.pt", "hub", "yoloe-26n-seg.pt"])
@pytest.mark.parametrize("shape", [(53, 71), (90, 41)])
def test_words_to_evidence(name: str, shape: tuple[int, int], home: Path) -> None:
    encoder = str(home / "mobileclip_blt.ts") if name == "hub" else ""
    model = yoloe(home, name, text_encoder=encoder, score=0.3)
    seen = model(Picture(photo(*shape), "a.jpg"))
    check(seen, shape, 0.3 if "11" in name or name == "hub" else 0)
    again = yoloe(home, name, text_encoder=encoder, score=0.3)(Picture(photo(*shape)))
    assert (again.evidence == seen.evidence).all()


def test_hub_files_and_ultralytics_files_are_the_same_network(home: Path) -> None:
    mine = yoloe(home)(Picture(photo()))
    theirs = yoloe(home, "hub", text_encoder=str(home / "mobileclip_blt.ts"))(Picture(photo()))
    np.testing.assert_allclose(mine.evidence, theirs.evidence, atol=1e-4)


def test_detections_and_masks_are_those_of_ultralytics(home: Path) -> None:
    """Their predictor gets BGR, as it expects, letterboxes, suppresses and brings masks back by itself."""
    from ultralytics import YOLOE

    model = yoloe(home)
    network, image = model._network(), photo(60, 90)
    prompts = read_prompts(model.prompts)
    embeddings = model._words(network, prompts.texts)
    theirs = YOLOE(str(home / "yoloe-11n-seg.pt"))
    theirs.set_classes(list(prompts.texts), embeddings)
    options = {"imgsz": SIZE, "conf": 0.5, "iou": 0.7, "max_det": 300, "retina_masks": True, "device": "cpu"}
    (answer,) = theirs.predict(np.ascontiguousarray(image[..., ::-1]), save=False, verbose=False, **options)
    seen_by_them = theirs.predictor.preprocess([np.ascontiguousarray(image[..., ::-1])])[0].numpy()
    np.testing.assert_allclose(model.prepare(image), seen_by_them, atol=1e-6)
    fit = sight.letterbox((90, 60), SIZE, 32)
    with Device("cpu").inference():
        pixels = torch.from_numpy(model.prepare(image))[None]
        found = yoloe_network.detect(network, pixels, embeddings, len(prompts.texts), 0.5, 0.7, 300)
    assert len(answer) > 20
    boxes = sight.from_input(found.boxes, fit).clip(0, [90, 60] * 2)
    wrong = dict.fromkeys([(0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)], 0)
    for box, score, owner, theirs_mask in zip(
        answer.boxes.xyxy.numpy(),
        answer.boxes.conf.numpy(),
        answer.boxes.cls,
        answer.masks.data.numpy() > 0,
        strict=True,
    ):
        index = int(np.argmin(abs(found.scores - score) + abs(boxes - box).max(-1)))
        assert found.scores[index] == pytest.approx(score, abs=1e-4)
        assert found.classes[index] == int(owner)
        np.testing.assert_allclose(boxes[index], box, atol=1e-2)
        ours = sight.returned(found.masks[index], fit) > 0
        x0, y0, x1, y1 = (box + np.array([2, 2, -2, -2])).astype(int)  # they cut at other halves of pixels
        for shift in wrong:
            shifted = np.roll(ours, shift, (0, 1))
            wrong[shift] += int((shifted != theirs_mask)[max(y0, 2) : y1, max(x0, 2) : x1].sum())
    assert 4 * wrong.pop((0, 0)) < min(wrong.values())  # a shift of one pixel would show


def test_heads_without_suppression(home: Path) -> None:
    """YOLOE-26 suppresses repeated boxes in its head and delivers finished boxes."""
    model = yoloe(home, "yoloe-26n-seg.pt")
    network = model._network()
    assert yoloe_network.head(network).end2end
    with Device("cpu").inference():
        embeddings = model._words(network, read_prompts(model.prompts).texts)
        pixels = torch.from_numpy(model.prepare(photo()))[None]
        (answer, _), _ = network(pixels, vpe=embeddings)
        found = yoloe_network.detect(network, pixels, embeddings, 8, 0.5, 0.7, 12)
    assert answer.shape[-1] == 4 + 1 + 1 + 32
    assert len(found.scores) == 12
    assert (found.scores > 0.5).all()
    assert (np.diff(found.scores) <= 0).all()
    assert found.masks.shape == (12, 32, 40)
    assert found.classes.max() < 8


def test_the_network_sees_red_as_red(home: Path) -> None:
    red = np.zeros((40, 60, 3), np.uint8)
    red[..., 0] = 255
    seen = yoloe(home).prepare(red)
    assert seen.shape == (3, 128, 160)
    assert seen.dtype == np.float32
    assert seen[:, 64, 80].tolist() == [1, 0, 0]
    assert seen[:, 0, 0] == pytest.approx(114 / 255)


def test_masks_end_at_their_boxes() -> None:
    fit = sight.letterbox((40, 30), 160, 32)  # four pixels of the input for one, 4 rows of padding above
    mask = inside(np.array([8.0, 4 + 12, 20, 4 + 29]), fit)
    expected = np.zeros((30, 40), bool)
    expected[3:7, 2:5] = True
    assert (mask == expected).all()


def test_prompts_decide_the_class(home: Path, tmp_path: Path) -> None:
    seen = yoloe(home)(Picture(photo())).evidence
    other = tmp_path / "swapped.toml"
    other.write_text(
        text_networks.PROMPTS.replace("excavator =", "x =")
        .replace("obstacle =", "excavator =")
        .replace("x =", "obstacle =")
    )
    swapped = yoloe(home, prompts=str(other))(Picture(photo())).evidence
    a, b = TaskClass.EXCAVATOR - 1, TaskClass.OBSTACLE - 1
    assert seen[..., [a, b]].any()
    np.testing.assert_allclose(seen[..., a], swapped[..., b], atol=1e-5)


def test_embeddings_instead_of_a_text_encoder(home: Path, tmp_path: Path) -> None:
    from ultralytics import YOLOE

    with_encoder = yoloe(home)
    with_encoder.save_embeddings(tmp_path / "own.npz")
    theirs = YOLOE(str(home / "yoloe-11n-seg.pt"))
    theirs.load_prompt_embeddings(tmp_path / "own.npz")  # our file is one of theirs
    theirs.save_prompt_embeddings(tmp_path / "theirs.npz")
    alone = tmp_path / "yoloe-11n-seg.pt"
    alone.write_bytes((home / "yoloe-11n-seg.pt").read_bytes())
    for name in ("own.npz", "theirs.npz"):
        model = replace(with_encoder, weights=str(alone), embeddings=str(tmp_path / name))
        np.testing.assert_allclose(model(Picture(photo())).evidence, with_encoder(Picture(photo())).evidence, atol=1e-5)
    (tmp_path / "more.toml").write_text(text_networks.PROMPTS.replace('"soil"', '"soil", "clay", "peat"'))
    with pytest.raises(InputError, match="lack the prompts 'clay', 'peat'"):
        replace(model, prompts=str(tmp_path / "more.toml"))(Picture(photo()))
    with pytest.raises(InputError, match="were made for yoloe-11n, the weights are yoloe-26n"):
        replace(model, weights=str(home / "yoloe-26n-seg.pt"))(Picture(photo()))
    (tmp_path / "junk.npz").write_bytes(b"junk")
    with pytest.raises(InputError, match="is not a file of prompt embeddings"):
        replace(model, embeddings=str(tmp_path / "junk.npz"))(Picture(photo()))


def test_without_text_encoder_it_says_where_to_get_it(home: Path, tmp_path: Path) -> None:
    alone = tmp_path / "yoloe-11n-seg.pt"
    alone.write_bytes((home / "yoloe-11n-seg.pt").read_bytes())
    with pytest.raises(InputError, match=r"mobileclip_blt\.ts from https://github.com/ultralytics/assets.*embeddings"):
        yoloe(tmp_path, prompts="excavation")(Picture(photo()))
    (tmp_path / "mobileclip_blt.ts").write_bytes(b"junk")
    with pytest.raises(InputError, match="is not a TorchScript text encoder"):
        yoloe(tmp_path, prompts="excavation")(Picture(photo()))


def test_without_tokenizer_it_says_what_to_install(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "open_clip.tokenizer", None)
    with pytest.raises(MissingExtraError, match=r'open_clip.*pip install "excavatwin\[yoloe\]"'):
        yoloe(home, prompts="excavation")(Picture(photo()))


def test_own_words_of_prompt_free_weights(home: Path) -> None:
    remap = dict.fromkeys(TEXTS, "nothing") | {
        "excavator": "excavator",
        "dirt": "construction_terrain:0.5+obstacle:0.3",
    }
    seen = yoloe(home, "yoloe-11n-seg-pf.pt", remap=remap, score=0.01)(Picture(photo()))
    assert seen.evidence[..., [1, 2]].sum() == 0
    assert seen.evidence.sum() > 0
    with pytest.raises(InputError, match=r"'zygote'.*--map"):
        yoloe(home, "yoloe-11n-seg-pf.pt", remap={"excavator": "excavator"}, score=0.01)(Picture(photo()))


def test_reference_photos(home: Path, tmp_path: Path) -> None:
    model = yoloe(home, references=references(home, tmp_path), score=0.3)
    seen = model(Picture(photo()))
    check(seen, (53, 71))
    assert seen.evidence[..., [0, 1, 2]].sum() == 0  # nothing else was shown
    known = model.identity()
    (tmp_path / "b.png").write_bytes((tmp_path / "a.png").read_bytes() + b" ")
    assert model.identity() != known
    with pytest.raises(InputError, match="prompt-free weights of yoloe take no references"):
        replace(model, weights=str(home / "yoloe-11n-seg-pf.pt"))(Picture(photo()))


def test_embeddings_of_reference_photos_are_those_of_ultralytics(home: Path, tmp_path: Path) -> None:
    from ultralytics import YOLOE
    from ultralytics.models.yolo.yoloe import YOLOEVPSegPredictor

    file = Path(references(home, tmp_path))
    with Device("cpu").inference():
        prompts, ours = yoloe_prompts.referenced(yoloe(home)._network(), file, "once", SIZE)
    assert prompts.texts == ("obstacle in a.png", "excavator in a.png", "no_surface in b.png")
    theirs = YOLOE(str(home / "yoloe-11n-seg.pt"))
    options = {"imgsz": SIZE, "rect": True, "task": "segment", "device": "cpu", "verbose": False}
    predictor = YOLOEVPSegPredictor(overrides=options)
    boxes = np.array([[5, 5, 30, 30], [60, 20, 85, 55], [20, 20, 50, 45]], float)
    predictor.set_prompts({"bboxes": boxes, "cls": np.array([0, 0, 1])})
    predictor.setup_model(theirs.model, verbose=False)
    expected = predictor.get_vpe(np.ascontiguousarray(photo(60, 90)[..., ::-1]))
    np.testing.assert_allclose(ours[:, :2].numpy(), expected.numpy(), atol=1e-4)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[[reference]]\nimage = "a.png"\nmachine = [[0, 0, 5, 5]]', "'machine' is not a task class"),
        ('[[reference]]\nimage = "a.png"\nexcavator = [0, 0, 5, 5]', r"excavator must be a list of boxes"),
        ('[[reference]]\nimage = "a.png"\nexcavator = [[9, 0, 5, 5]]', r"with x0 < x1"),
        ('[[reference]]\nimage = "a.png"\nexcavator = [[0, 0, 500, 5]]', r"lie outside a\.png"),
        ('[[reference]]\nimage = "a.png"\nexcavator = [[1, 1, 1.2, 1.2]]', r"too small to be seen"),
        ('[[reference]]\nimage = "a.png"', "each entry needs a photo and boxes"),
        ('[[reference]]\nimage = "c.png"\nexcavator = [[0, 0, 5, 5]]', r"c\.png cannot be read"),
        ("", "hold no photo"),
        ("[[", "cannot be read"),
    ],
)
def test_wrong_references_are_refused(text: str, said: str, home: Path, tmp_path: Path) -> None:
    file = Path(references(home, tmp_path))
    file.write_text(text)
    with pytest.raises(InputError, match=said):
        yoloe(home, references=str(file))(Picture(photo()))


def test_half_precision_runs(home: Path) -> None:
    model = replace(yoloe(home, score=0.3), device=Device("cpu", "bfloat16"))
    check(model(Picture(photo())), (53, 71))


class _Code:
    """Runs when it is unpickled."""

    def __reduce__(self) -> Any:
        return os.mkdir, ("run-by-a-pickle",)


def test_files_that_run_code_are_refused(home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    torch.save({"model": _Code()}, tmp_path / "yoloe-bad-seg.pt")
    with pytest.raises(InputError, match=r"cannot be opened .*--yoloe\.trusted"):
        yoloe(tmp_path, "yoloe-bad-seg.pt")(Picture(photo()))
    assert not (tmp_path / "run-by-a-pickle").exists()
    (tmp_path / "yoloe-junk-seg.pt").write_bytes(pickle.dumps(3))
    with pytest.raises(InputError, match="cannot be opened"):
        yoloe(tmp_path, "yoloe-junk-seg.pt", trusted=True)(Picture(photo()))


def test_other_networks_and_files_are_refused(home: Path, tmp_path: Path) -> None:
    from ultralytics import YOLO

    YOLO("yolo11n-seg.yaml").save(tmp_path / "yolo11n-seg.pt")
    with pytest.raises(InputError, match="is a SegmentationModel, not a YOLOE network with masks"):
        yoloe(tmp_path, "yolo11n-seg.pt")(Picture(photo()))
    with pytest.raises(InputError, match=r"there is no file .*yoloe-11l-seg\.pt; download it from https://github.com"):
        Yoloe("yoloe-11l-seg.pt")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"must be one \.pt or \.safetensors file.*found: none"):
        yoloe(tmp_path, "empty")(Picture(photo()))
    with pytest.raises(InputError, match="expected a multiple of 32"):
        Yoloe(long_side=600)


def test_incomplete_weights_are_refused(home: Path, tmp_path: Path) -> None:
    from safetensors.torch import load_file, save_file

    tensors = load_file(home / "hub/model.safetensors")
    lost = next(name for name in tensors if "savpe" in name and name.endswith("conv.weight"))
    save_file({name: value for name, value in tensors.items() if name != lost}, tmp_path / "model.safetensors")
    with pytest.raises(InputError, match="must name the architecture"):
        yoloe(tmp_path, ".", prompts="excavation")(Picture(photo()))
    (tmp_path / "config.json").write_text('{"model": "yoloe-11n-seg.yaml"}')
    with pytest.raises(InputError, match=r"lacks 1 tensors of yoloe-11n-seg\.yaml, such as model\.23\.savpe"):
        yoloe(tmp_path, ".", prompts="excavation")(Picture(photo()))
    (tmp_path / "config.json").write_text('{"model": "yoloe-11s-seg.yaml"}')
    with pytest.raises(InputError, match=r"does not fill yoloe-11s-seg\.yaml"):
        yoloe(tmp_path, ".", prompts="excavation")(Picture(photo()))


def test_importing_ultralytics_leaves_nothing_behind(tmp_path: Path) -> None:
    code = (
        "import socket\n"
        "def refuse(*a, **k): raise SystemExit('network')\n"
        "socket.getaddrinfo = socket.socket.connect = refuse\n"
        "import os\n"
        "before = dict(os.environ)\n"
        "from excavatwin.backbones.segmenters.yoloe_network import quietly\n"
        "quietly()\n"
        "import ultralytics.utils as u\n"
        "assert not u.ONLINE and not u.AUTOINSTALL\n"
        "assert {k: v for k, v in os.environ.items() if k.startswith(('YOLO', 'ULTRA'))} == {}\n"
    )
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("YOLO", "ULTRA"))}
    environment |= {"HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path / "config"), "TMPDIR": str(tmp_path)}
    ran = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout == ""
    left = [path for path in tmp_path.rglob("*") if "ltralytics" in path.name or "yolo" in path.name]
    assert left == []
