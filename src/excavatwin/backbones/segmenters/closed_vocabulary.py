"""What the segmenters of transformers share: networks with a fixed list of classes, from a picture to evidence."""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from jaxtyping import Float, Float32, UInt8

from excavatwin.backbones import weights as weights_
from excavatwin.backbones.cards import Card
from excavatwin.backbones.device import Device, halving
from excavatwin.backbones.extras import need, versions
from excavatwin.backbones.protocols import Picture, Segmentation
from excavatwin.backbones.segmenters import sight
from excavatwin.backbones.segmenters.preparation import Preparation
from excavatwin.backbones.segmenters.pretrained import Opened, class_names, configuration, opened
from excavatwin.backbones.segmenters.readings import Reading
from excavatwin.backbones.segmenters.windows import Window, gathered
from excavatwin.errors import InputError
from excavatwin.scene.taxonomy import K
from excavatwin.vocabularies import Resolved, read_vocabulary, resolve

if TYPE_CHECKING:
    from torch import Tensor

#: Inputs are not shrunk below this when memory runs out [px].
LEAST_SIDE = 256


@dataclass(frozen=True)
class ClosedVocabulary(ABC):
    """Base of the adapters: a subclass says how its pictures are prepared and how its network is asked."""

    card: ClassVar[Card]
    kinds: ClassVar[Mapping[str, str]]
    """Model type in ``config.json`` -> class of transformers."""
    published: ClassVar[Mapping[str, str]] = {}
    """Weights on the hub that do not name their classes -> class mapping whose ids they follow."""

    weights: str = ""
    """Name on the hub, or path of a folder with config.json; empty for the first set on the card."""
    device: Device = field(default_factory=Device)
    """What the network runs on."""
    mapping: str = ""
    """Class mapping: a shipped name or a TOML file, with or without ``:policy``; empty to choose by the classes."""
    remap: Mapping[str, str] = field(default_factory=dict)
    """Class -> task class, above the mapping."""

    def identity(self) -> str:
        """Versions of the libraries, which weights are used, and what their classes mean."""
        told = f"{versions(self.card)}; {weights_.fingerprint(self.card, self.weights)}"
        folder = weights_.find(self.card, self.weights)
        if folder is None:
            return told
        meaning, _ = self._meaning(self._configuration(_folder(folder)))
        digest = hashlib.blake2b(meaning.weights.tobytes() + meaning.no_surface.tobytes(), digest_size=6)
        return f"{told}; {meaning.mapping} ({meaning.policy}) {digest.hexdigest()}"

    def prepare(self, image: UInt8[np.ndarray, "H W 3"]) -> Float32[np.ndarray, "3 h w"]:
        """What the network sees of a picture: RGB, resized and normalised.

        Raises:
            InputError: the weights are not here.
        """
        folder = self._here()
        pixels, _, _ = self._prepared(image, folder, self._configuration(folder), 0)
        return pixels

    def __call__(self, picture: Picture) -> Segmentation:
        """Evidence on the pixels of the picture; no-object mass and classes that never vote are missing evidence.

        Raises:
            MissingExtraError: torch or transformers is not installed.
            InputError: no weights, damaged ones, classes that are not mapped, or too little memory.
        """
        need(self.card)
        sight.checked(picture.image, self.card.name)
        image, folder = picture.image, self._here()
        config = self._configuration(folder)
        meaning, doubts = self._meaning(config)
        start, least = self._sides(image, folder, config)
        scores = halving(
            lambda side: self._scores(image, folder, config, meaning, 0 if side == start else side),
            start,
            least,
            doubts.append,
            "px on the long side of the network's input",
        )
        none = scores[..., K] > 0.5
        evidence = np.clip(scores[..., :K], 0, 1)
        evidence /= np.maximum(evidence.sum(-1, keepdims=True), 1)
        evidence[none] = 0
        return Segmentation(evidence, none, tuple(doubts))

    @abstractmethod
    def preparation(self, folder: Path, config: Mapping[str, Any]) -> Preparation:
        """How these weights want their pictures."""

    @abstractmethod
    def look(self, network: Opened, pixels: Float[Tensor, "1 3 h w"], folder: Path) -> Reading:
        """Ask the network about one input."""

    def _prepared(
        self, image: UInt8[np.ndarray, "H W 3"], folder: Path, config: Mapping[str, Any], side: int
    ) -> tuple[Float32[np.ndarray, "3 h w"], tuple[int, int], list[Window]]:
        """The input, the (h, w) of it that shows the picture, and the windows in which the network looks at it."""
        how = self.preparation(folder, config)
        shape = how.shape(image.shape[0], image.shape[1], side)
        return how.pixels(image, shape), shape, [Window.whole(shape)]

    def _sides(self, image: np.ndarray, folder: Path, config: Mapping[str, Any]) -> tuple[int, int]:
        """Long side of the input, and the least one to try when memory runs out [px]."""
        start = max(self._prepared(image, folder, config, 0)[1])
        return start, min(start, LEAST_SIDE)

    def _scores(
        self,
        image: UInt8[np.ndarray, "H W 3"],
        folder: Path,
        config: Mapping[str, Any],
        meaning: Resolved,
        side: int,
    ) -> Float32[np.ndarray, "H W K+1"]:
        """Evidence for the task classes, and the probability of sky or water behind it."""
        import torch

        state = weights_.fingerprint(self.card, self.weights)
        network = opened(self.kinds[config["model_type"]], folder, state, str(self.device.torch()))
        pixels, shape, windows = self._prepared(image, folder, config, side)
        readings = []
        with self.device.inference() as device:
            batch = torch.from_numpy(pixels)[None].to(device)
            for window in windows:
                readings.append(self.look(network, batch[..., window.rows, window.columns], folder))
        if readings[0].classes != len(meaning.names):
            raise InputError(
                f"the network of {self.card.name} has {readings[0].classes} classes, but {len(meaning.names)} are "
                f"named; give a class mapping with as many, in the order of its ids, or other weights."
            )
        columns = np.column_stack([meaning.weights, meaning.no_surface]).astype(np.float32)
        return gathered(readings, windows, shape, (image.shape[0], image.shape[1]), columns)

    def _meaning(self, config: Mapping[str, Any]) -> tuple[Resolved, list[str]]:
        """What the classes mean for the task, and what the user should know about it."""
        names, doubts = class_names(config), []
        if not names:
            own = "" if self.mapping.startswith(":") else self.mapping
            name = own or self.published.get(weights_.chosen(self.card, self.weights).repo, "")
            if not name:
                raise InputError(
                    f"the weights of {self.card.name} do not name their classes; say whose ids they follow with "
                    f"--{self.card.name}.mapping ade20k-150, or another class mapping."
                )
            names = tuple(read_vocabulary(name).names.values())
            doubts.append(f"the weights do not name their classes; they are taken to be those of {name}, in its order.")
        meaning = resolve(names, self.mapping, self.remap)
        doubts += meaning.doubts
        return meaning, doubts

    def _here(self) -> Path:
        return _folder(weights_.need(self.card, self.weights))

    def _configuration(self, folder: Path) -> dict[str, Any]:
        return configuration(folder, self.kinds, self.card.name)


def _folder(path: Path) -> Path:
    """The folder of the weights, also when the file in it was named."""
    return path.parent if path.is_file() else path
