"""CLIPSeg: one blurry heat map for each prompt; small and quick, for machines on which nothing better runs."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float32, UInt8

from excavatwin.backbones import extras, lattices, weights
from excavatwin.backbones.cards import Card, Tried, Weights
from excavatwin.backbones.device import Device, halving
from excavatwin.backbones.protocols import Picture, Segmentation
from excavatwin.backbones.segmenters import hub_networks, sight
from excavatwin.backbones.segmenters.instances import Tally, told
from excavatwin.backbones.segmenters.prompts import read_prompts
from excavatwin.errors import require


@dataclass(frozen=True)
class ClipSeg:
    """Text to heat maps (Lüddecke and Ecker, CVPR 2022), by transformers' CLIPSegForImageSegmentation.

    Its decoder was trained with binary cross-entropy, one prompt at a time, so each map is a probability by itself:
    sigmoid of its logits. A softmax over prompts would pretend that exactly one of the user's prompts is true and that
    their number does not matter. Maps compete as answers of other networks do (``instances``): the best prompt of each
    class, shares by odds, never more in total than the strongest map; below ``threshold`` a map says nothing.
    """

    card: ClassVar[Card] = Card(
        name="clipseg",
        kind="segmenter",
        summary="text to coarse heat maps (352 px), small and quick; from the University of Göttingen",
        tried=Tried.REAL_CODE,
        modules=("torch", "transformers"),
        install='pip install "excavatwin[transformers]"',
        weights=(Weights("CIDAS/clipseg-rd64-refined", 6.03e8, "Apache-2.0", True),),
        argument="weights",
        source="https://github.com/timojl/clipseg",
    )

    weights: str = ""
    """Name on the hub, or path of a folder with weights, configuration and tokenizer; empty for rd64-refined."""
    prompts: str = "excavation"
    """What is looked for: a shipped set of prompts, or path of an own TOML file of that form."""
    threshold: float = 0.2
    """Least probability of a prompt that counts, 0..1; its maps are never quite zero."""
    side: int = 352
    """Side of the square that the network sees [px]; it was trained with 352."""
    batch: int = 8
    """Prompts at a time."""
    device: Device = field(default_factory=Device)
    """What the network runs on."""

    def __post_init__(self) -> None:
        require(self, "threshold", 0, 1)
        require(self, "side", 32)
        require(self, "batch", 1)

    def identity(self) -> str:
        """Versions of the libraries, which weights, and what the prompts are."""
        stamp = weights.fingerprint(self.card, self.weights)
        return f"{extras.versions(self.card)}; {stamp}; {read_prompts(self.prompts).identity()}"

    def prepare(self, image: UInt8[np.ndarray, "H W 3"]) -> Float32[np.ndarray, "3 h w"]:
        """What the network sees: RGB, stretched to its square, normalised as ImageNet is."""
        fit = lattices.fit(sight.checked(image, self.card.name), (self.side, self.side), "stretch")
        return lattices.normalised(sight.shown(image, fit), *lattices.IMAGENET)

    def __call__(self, picture: Picture) -> Segmentation:
        """Evidence on the pixels of the picture.

        Raises:
            MissingExtraError: torch or transformers is not installed.
            InputError: wrong prompts, no weights, a wrong image, too little memory.
        """
        size = sight.checked(picture.image, self.card.name)
        extras.need(self.card)
        prompts = read_prompts(self.prompts)
        fit = lattices.fit(size, (self.side, self.side), "stretch")
        pixels = self.prepare(picture.image)
        said: list[str] = []
        logits = halving(
            lambda batch: self._logits(pixels, prompts.texts, batch), self.batch, 1, said.append, "prompts at a time"
        )
        tally = Tally.empty(picture.image.shape[:2])
        for votes, grid in zip(prompts.votes, logits, strict=True):
            belief = 0.5 + 0.5 * np.tanh(0.5 * sight.returned(grid, fit))  # sigmoid, without overflow
            tally.claim(votes, np.where(belief >= self.threshold, belief, np.float32(0)))
        return told(tally.segmentation(), said)

    def _logits(
        self, pixels: Float32[np.ndarray, "3 h w"], texts: tuple[str, ...], batch: int
    ) -> Float32[np.ndarray, "P h w"]:
        """One logit map for each prompt. The picture is encoded once, which the library's own forward would repeat."""
        import torch

        stamp = weights.fingerprint(self.card, self.weights)
        folder = hub_networks.folder_of(self.card, self.weights)
        network = hub_networks.network("CLIPSegForImageSegmentation", folder, stamp, self.device.torch())
        read = hub_networks.tokenizer(folder, stamp)
        longest = network.config.text_config.max_position_embeddings
        tokens = read(list(texts), padding=True, truncation=True, max_length=longest, return_tensors="pt")
        maps = []
        with self.device.inference() as device:
            image = torch.from_numpy(pixels)[None].to(device)
            seen = network.clip.get_image_features(
                image, interpolate_pos_encoding=True, output_hidden_states=True, return_dict=True
            )
            layers = [seen.hidden_states[index + 1] for index in network.extract_layers]
            for start in range(0, len(texts), batch):
                some = {
                    name: tokens[name][start : start + batch].to(device) for name in ("input_ids", "attention_mask")
                }
                count = len(some["input_ids"])
                words = network.get_conditional_embeddings(batch_size=count, **some)
                answer: Any = network.decoder([layer.expand(count, -1, -1) for layer in layers], words)
                maps.append(answer.logits.float().reshape(count, *answer.logits.shape[-2:]).cpu().numpy())
        return np.concatenate(maps)
