"""YOLOE: instances of what is named in words, shown in reference photos, or among the words that it knows itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from excavatwin.backbones import extras, lattices, weights
from excavatwin.backbones.cards import Card, Tried, Weights
from excavatwin.backbones.device import Device, halving
from excavatwin.backbones.lattices import Fit
from excavatwin.backbones.protocols import Picture, Segmentation
from excavatwin.backbones.segmenters import sight, yoloe_network, yoloe_prompts
from excavatwin.backbones.segmenters.instances import Tally, told
from excavatwin.backbones.segmenters.prompts import CHANNELS, NO_SURFACE, read_prompts
from excavatwin.errors import InputError, require
from excavatwin.scene.taxonomy import K
from excavatwin.vocabularies import digest, resolve

#: Sides of the network's input are multiples of this [px].
_STRIDE = 32
#: Inputs are not shrunk below this when memory runs out [px].
_LEAST = 256


@dataclass(frozen=True)
class Yoloe:
    """Wang et al., YOLOE: Real-Time Seeing Anything (ICCV 2025), by Ultralytics' implementation.

    What it looks for follows from what it is given: ``references`` (visual prompts), else the words built into the
    weights (prompt-free, "-pf"; mapped to task classes by ``mapping``), else ``prompts`` (text). Text needs the text
    encoder or a file of embeddings. A pixel's evidence is sparse: mask times score of the instances on it
    (``instances``); YOLOE rarely answers to stuff such as soil, so expect little ground.

    Its code and weights are AGPL-3.0: whoever ships it or offers a service with it must publish the source of the
    whole, or buy a licence from Ultralytics.
    """

    card: ClassVar[Card] = Card(
        name="yoloe",
        kind="segmenter",
        summary="instances of things named in words or shown in photos, quick; from Tsinghua, by Ultralytics",
        tried=Tried.REAL_CODE,
        licence="AGPL-3.0",
        commercial=False,
        modules=("torch", "torchvision", "ultralytics", "safetensors"),
        install='pip install "excavatwin[yoloe]"',
        weights=(
            Weights("jameslahm/yoloe-11l-seg", 1.41e8, "AGPL-3.0", False),
            Weights("jameslahm/yoloe-v8l-seg", 2.14e8, "AGPL-3.0", False),
            Weights("jameslahm/yoloe-v8s-seg", 6.2e7, "AGPL-3.0", False),
        ),
        argument="weights",
        source="https://github.com/THU-MIG/yoloe, https://docs.ultralytics.com/models/yoloe",
    )

    weights: str = ""
    """Name on the hub, path of such a folder, or of a .pt file of Ultralytics; empty for yoloe-11l-seg."""
    prompts: str = "excavation"
    """What is looked for: a shipped set of prompts, or path of an own TOML file of that form."""
    text_encoder: str = ""
    """Path of mobileclip_blt.ts (mobileclip2_b.ts for YOLOE-26); empty to look beside the weights."""
    embeddings: str = ""
    """Path of an .npz with the prompts' embeddings for these weights, instead of a text encoder."""
    references: str = ""
    """Path of a TOML file with reference photos and boxes, instead of words (visual prompts)."""
    mapping: str = ""
    """For prompt-free weights: class mapping of their words, shipped or a TOML file; empty to choose by the words."""
    remap: Mapping[str, str] = field(default_factory=dict)
    """For prompt-free weights: word -> task class, above the mapping."""
    score: float = 0.25
    """Least score of an instance, 0..1."""
    overlap: float = 0.7
    """Boxes that overlap more (IoU) are one instance, of the class with the higher score, 0..1."""
    most: int = 300
    """Most instances in a picture."""
    long_side: int = 640
    """Long side of what the network sees [px]; a multiple of 32."""
    trusted: bool = False
    """Open .pt files that contain more than tensors and known layers: such a file can run code."""
    device: Device = field(default_factory=Device)
    """What the network runs on."""

    def __post_init__(self) -> None:
        require(self, "score", 0, 1)
        require(self, "overlap", 0, 1)
        require(self, "most", 1)
        require(self, "long_side", 32)
        if self.long_side % 32:
            raise InputError(f"Yoloe.long_side is {self.long_side}; expected a multiple of 32, such as 640 or 1280.")
        if self.weights.endswith(".pt") and not Path(self.weights).expanduser().is_file():
            raise InputError(
                f"weights of yoloe: there is no file {self.weights}; download it from {yoloe_prompts.RELEASES} "
                "(or the repository jameslahm/yoloe of the hub) and give its path."
            )

    def identity(self) -> str:
        """Versions of the libraries, which weights, and all that decides what is looked for."""
        parts = [extras.versions(self.card), weights.fingerprint(self.card, self.weights)]
        parts += [_stamp(path) for path in (self.text_encoder, self.embeddings) if path]
        parts += [digest(self.mapping)]
        parts += [self._references()] if self.references else []
        return "; ".join([*parts, read_prompts(self.prompts).identity()])

    def prepare(self, image: UInt8[np.ndarray, "H W 3"]) -> Float32[np.ndarray, "3 h w"]:
        """What the network sees: RGB in 0..1, letterboxed with grey."""
        fit = sight.letterbox(sight.checked(image, self.card.name), self.long_side, 32)
        return lattices.normalised(sight.shown(image, fit, 114, smooth=False))

    def __call__(self, picture: Picture) -> Segmentation:
        """Evidence on the pixels of the picture.

        Raises:
            MissingExtraError: ultralytics or torch is not installed.
            InputError: no weights, no text encoder, wrong prompts or mapping, a wrong image, too little memory.
        """
        sight.checked(picture.image, self.card.name)
        extras.need(self.card)
        said: list[str] = []
        found = halving(
            lambda steps: replace(self, long_side=_STRIDE * steps)._seen(picture.image),
            self.long_side // _STRIDE,
            min(self.long_side // _STRIDE, _LEAST // _STRIDE),
            said.append,
            f"x {_STRIDE} px on the long side of the network's input",
        )
        return told(found, said)

    def save_embeddings(self, file: Path) -> None:
        """Write the embeddings of the prompts, for machines without text encoder (field ``embeddings``)."""
        network, prompts = self._network(), read_prompts(self.prompts)
        found = self._words(network, prompts.texts).cpu().numpy()
        names = np.array(prompts.texts, np.str_)
        model = np.array(yoloe_prompts.model_name(self._path(), network), np.str_)
        np.savez_compressed(file, embeddings=found, names=names, model=model)

    def _seen(self, image: UInt8[np.ndarray, "H W 3"]) -> Segmentation:
        import torch

        network = self._network()
        fit = sight.letterbox((image.shape[1], image.shape[0]), self.long_side, 32)
        tally = Tally.empty(image.shape[:2])
        with Device(self.device.name, "float32").inference():
            votes, embeddings, doubts = self._asked(network)
        with self.device.inference() as device:
            pixels = torch.from_numpy(self.prepare(image))[None].to(device)
            limits = (self.score, self.overlap, self.most)
            found = yoloe_network.detect(network, pixels, embeddings, len(votes), *limits)
        for box, score, index, logits in zip(found.boxes, found.scores, found.classes, found.masks, strict=True):
            if votes[index].any():
                mask = (sight.returned(logits, fit) > 0) & inside(box, fit)
                tally.claim_instance(votes[index], mask, float(score))
        return replace(tally.segmentation(), doubts=doubts)

    def _asked(self, network: Any) -> tuple[Float32[np.ndarray, "P C"], Any, tuple[str, ...]]:
        """Votes of the classes, their embeddings (None: built in), and what is to be said about the mapping."""
        classes = yoloe_network.own_classes(network)
        if self.references:
            if classes:
                raise InputError("prompt-free weights of yoloe take no references; give weights without -pf.")
            file = Path(self.references).expanduser()
            found, embeddings = yoloe_prompts.referenced(network, file, self._references(), self.long_side)
            return found.votes, embeddings, ()
        if classes:
            resolved = resolve(classes, self.mapping, self.remap)
            votes = np.zeros((len(classes), CHANNELS), np.float32)
            votes[:, :K], votes[:, NO_SURFACE] = resolved.weights, resolved.no_surface
            return votes, None, resolved.doubts
        prompts = read_prompts(self.prompts)
        return prompts.votes, self._words(network, prompts.texts), ()

    def _references(self) -> str:
        """Fingerprint of the reference photos and of the file that lists them."""
        file = Path(self.references).expanduser()
        return "; ".join(_stamp(str(path)) for path in (file, *(p for p, _ in yoloe_prompts.read_references(file))))

    def _words(self, network: Any, texts: tuple[str, ...]) -> Any:
        if self.embeddings:
            return yoloe_prompts.filed(network, self._path(), texts, Path(self.embeddings).expanduser())
        stamp = _stamp(self.text_encoder) if self.text_encoder else ""
        return yoloe_prompts.worded(network, self._path(), texts, self.text_encoder, stamp)

    def _network(self) -> Any:
        extras.need(self.card)
        stamp = weights.fingerprint(self.card, self.weights)
        return yoloe_network.opened(self._path(), stamp, self.device.torch(), self.trusted)

    def _path(self) -> Path:
        return weights.need(self.card, self.weights)


def inside(box: Float64[np.ndarray, "4"], fit: Fit) -> Bool[np.ndarray, "H W"]:
    """Pixels of the picture whose centres lie in a box of the network's input: masks end at their boxes."""
    x0, y0, x1, y1 = sight.from_input(box[None], fit)[0]
    x, y = np.arange(fit.size[0]) + 0.5, np.arange(fit.size[1]) + 0.5
    return ((y >= y0) & (y < y1))[:, None] & ((x >= x0) & (x < x1))


def _stamp(path: str) -> str:
    """Name, size and time of a file."""
    file = Path(path).expanduser()
    return f"{file.name} {file.stat().st_size} {file.stat().st_mtime_ns}" if file.is_file() else f"no {file.name}"
