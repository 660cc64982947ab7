"""Ultralytics' YOLOE network: imported quietly, opened from files of this machine, asked directly.

Ultralytics reports usage, installs packages and downloads files by itself. We import it with all of that switched off
and call the network without its predictors, so that we know where every pixel goes and nothing is sent.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64, Int

from excavatwin.backbones.segmenters.preparation import read_json
from excavatwin.backbones.segmenters.pretrained import first_line
from excavatwin.errors import InputError

#: Read by Ultralytics when it is imported.
_QUIET = {
    "YOLO_OFFLINE": "1",
    "YOLO_AUTOINSTALL": "false",
    "YOLO_VERBOSE": "false",
    "ULTRALYTICS_SAFE_LOAD": "true",
}


@dataclass(frozen=True)
class Detections:
    """What the network found in its input, after suppression of overlapping boxes."""

    boxes: Float64[np.ndarray, "n 4"]
    """x0, y0, x1, y1 [px of the input]."""
    scores: Float32[np.ndarray, "n"]
    classes: Int[np.ndarray, "n"]
    """Index of the prompt, or of the class of a prompt-free network."""
    masks: Float32[np.ndarray, "n h w"]
    """Mask logits over the whole input, on a coarser grid."""


def quietly() -> None:
    """Import Ultralytics without telemetry, installs, downloads, messages, and without settings outside this process.

    A user's ``YOLO_CONFIG_DIR`` is left in force. Somebody else's earlier import in this process is left as it is, but
    for Pillow's ``Image.open``: Ultralytics puts its own in its place, which asks for pi_heif where a file is no image.
    """
    from PIL import Image

    if "ultralytics" in sys.modules:
        Image.open = getattr(sys.modules.get("ultralytics.utils.patches"), "_image_open", Image.open)
        return
    unpatched = Image.open
    with TemporaryDirectory(prefix="excavatwin-yolo-") as folder, _environment(_QUIET, {"YOLO_CONFIG_DIR": folder}):
        import ultralytics.nn.tasks  # noqa: F401
    Image.open = unpatched


@lru_cache(maxsize=2)
def opened(path: Path, stamp: str, device: Any, trusted: bool) -> Any:
    """The network in evaluation mode on its device.

    Args:
        path: .pt file of Ultralytics, or folder with config.json and a .safetensors file (jameslahm's on the hub).
        stamp: fingerprint of the content, so that changed weights are loaded anew.
        device: ``torch.device``.
        trusted: unpickle whatever a .pt file contains, which may run code of whoever made it.

    Raises:
        InputError: no such files, damaged ones, or another kind of network.
    """
    quietly()
    from ultralytics.nn.tasks import YOLOESegModel

    file = _file(path)
    network = _unpickled(file, trusted) if file.suffix == ".pt" else _filled(file)
    if not isinstance(network, YOLOESegModel):
        raise InputError(f"{file} is a {type(network).__name__}, not a YOLOE network with masks; give a yoloe-...-seg.")
    return network.float().eval().requires_grad_(False).to(device)


def head(network: Any) -> Any:
    """The last layer, in which prompts meet features."""
    return network.model[-1]


def own_classes(network: Any) -> tuple[str, ...]:
    """Classes of a prompt-free network, whose vocabulary is built in; empty for one that takes prompts."""
    if "lrpc" not in dict(head(network).named_children()):
        return ()
    names = network.names
    return tuple(names[index] for index in sorted(names)) if isinstance(names, dict) else tuple(names)


def detect(network: Any, pixels: Any, prompts: Any, count: int, score: float, overlap: float, most: int) -> Detections:
    """Run the network on one input.

    Args:
        network: from ``opened``.
        pixels: (1, 3, H, W) RGB in 0..1, sides multiples of 32, on its device.
        prompts: embeddings (1, P, D), or None for a prompt-free network.
        count: how many classes there are.
        score: least score.
        overlap: boxes that overlap more (IoU) are one thing, whatever their classes.
        most: most detections.
    """
    import torch
    from ultralytics.utils.nms import non_max_suppression

    head(network).max_det = most  # of the heads that suppress by themselves
    (answer, grids), _ = network(pixels) if prompts is None else network(pixels, vpe=prompts)
    found = non_max_suppression(
        answer.float(), score, overlap, agnostic=True, max_det=most, nc=count, end2end=head(network).end2end
    )[0]
    with torch.autocast(pixels.device.type, enabled=False):
        grid = grids[0].float()
        masks = (found[:, 6:] @ grid.flatten(1)).unflatten(1, grid.shape[1:])
    table = found[:, :6].cpu().numpy()
    return Detections(
        boxes=table[:, :4].astype(float),
        scores=table[:, 4].astype(np.float32),
        classes=table[:, 5].astype(np.intp),
        masks=masks.cpu().numpy(),
    )


def _file(path: Path) -> Path:
    """The one file of weights in a folder, or the file itself."""
    if path.is_file() and path.suffix in (".pt", ".safetensors"):
        return path
    files = sorted(file for file in path.glob("*") if file.suffix in (".pt", ".safetensors")) if path.is_dir() else []
    if len(files) != 1:
        named = ", ".join(file.name for file in files) or "none"
        raise InputError(f"{path} must be one .pt or .safetensors file of YOLOE, or hold one; found: {named}.")
    return files[0]


def _unpickled(file: Path, trusted: bool) -> Any:
    from ultralytics.nn.tasks import torch_safe_load

    try:
        checkpoint, _ = torch_safe_load(str(file), safe_only=not trusted)
    except Exception as error:  # whatever the library raises, the file cannot be used
        advice = "download it again" if trusted else "if you trust its origin, set --yoloe.trusted true"
        raise InputError(f"{file} cannot be opened ({first_line(error)}); {advice}.") from error
    return checkpoint.get("ema") or checkpoint.get("model")


def _filled(file: Path) -> Any:
    """Architecture by its name in config.json, tensors from the file: nothing is unpickled."""
    from safetensors import SafetensorError
    from safetensors.torch import load_file
    from ultralytics.nn.tasks import YOLOESegModel

    named = str((read_json(file.parent / "config.json") or {}).get("model", ""))
    if not re.fullmatch(r"yoloe-\w+-seg\.yaml", named):
        raise InputError(
            f"{file.parent / 'config.json'} must name the architecture, such as "
            f'{{"model": "yoloe-11l-seg.yaml"}}; found {named!r}.'
        )
    try:
        network = YOLOESegModel(named, verbose=False)
        tensors = {_plain(name): tensor for name, tensor in load_file(file).items()}
        report = network.load_state_dict(tensors, strict=False)
    except (SafetensorError, RuntimeError, OSError, SyntaxError) as error:
        raise InputError(f"{file} does not fill {named} ({first_line(error)}); download it again.") from error
    if report.missing_keys:
        absent = report.missing_keys
        raise InputError(f"{file} lacks {len(absent)} tensors of {named}, such as {absent[0]}; give other weights.")
    return network


def _plain(name: str) -> str:
    """A tensor's name in the network; the hub's files were saved with the wrapper around it."""
    return name.removeprefix("model.") if name.startswith("model.model.") else name


@contextmanager
def _environment(wanted: dict[str, str], unless_set: dict[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in wanted | unless_set}
    os.environ.update(wanted | {name: os.environ.get(name, value) for name, value in unless_set.items()})
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
