"""SAM 3: every instance of a concept that is named in words, with the part that is hard to count (soil, grass)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float32, UInt8

from excavatwin.backbones import extras, lattices, weights
from excavatwin.backbones.cards import Card, Tried, Weights
from excavatwin.backbones.device import Device, halving
from excavatwin.backbones.lattices import Fit
from excavatwin.backbones.protocols import Picture, Segmentation
from excavatwin.backbones.segmenters import hub_networks, sight
from excavatwin.backbones.segmenters.instances import Tally
from excavatwin.backbones.segmenters.prompts import read_prompts
from excavatwin.errors import require

#: Mean and standard deviation of SAM 3's input (RGB, 0..1).
_MEAN_STD = ((0.5, 0.5, 0.5), (0.5, 0.5, 0.5))


@dataclass(frozen=True)
class Sam3:
    """Text concepts to masks (Carion et al., SAM 3: Segment Anything with Concepts, 2025), by transformers' Sam3Model.

    One forward pass for each prompt; what the network sees is encoded once for each picture. The score of an instance
    is the product of its own and that of the presence token ("is this concept in the picture at all?"). Its semantic
    output adds what has no countable instances. How answers become evidence: ``instances``.
    """

    card: ClassVar[Card] = Card(
        name="sam3",
        kind="segmenter",
        summary="text concepts to instance masks, strong on things and stuff, slow without a GPU; from Meta",
        tried=Tried.REAL_CODE,
        modules=("torch", "transformers"),
        install='pip install "excavatwin[transformers]"',
        weights=(Weights("facebook/sam3", 3.4e9, "SAM License", True, gated=True),),
        argument="weights",
        source="https://github.com/facebookresearch/sam3",
    )

    weights: str = ""
    """Name on the hub, or path of a folder with weights, configuration and tokenizer; empty for facebook/sam3."""
    prompts: str = "excavation"
    """What is looked for: a shipped set of prompts, or path of an own TOML file of that form."""
    score: float = 0.3
    """Least score of an instance, 0..1; fainter ones give no evidence."""
    semantic: bool = True
    """Use the semantic output, too: soil and grass have no instances to count."""
    device: Device = field(default_factory=Device)
    """What the network runs on."""

    def __post_init__(self) -> None:
        require(self, "score", 0, 1)

    def identity(self) -> str:
        """Versions of the libraries, which weights, and what the prompts are."""
        stamp = weights.fingerprint(self.card, self.weights)
        return f"{extras.versions(self.card)}; {stamp}; {read_prompts(self.prompts).identity()}"

    def prepare(self, image: UInt8[np.ndarray, "H W 3"]) -> Float32[np.ndarray, "3 h w"]:
        """What the network sees: RGB, stretched to its square, (x / 255 - 0.5) / 0.5."""
        return _input(image, _side(self._network()))

    def __call__(self, picture: Picture) -> Segmentation:
        """Evidence on the pixels of the picture.

        Raises:
            MissingExtraError: torch or transformers is not installed.
            InputError: wrong prompts, no weights, a wrong image, too little memory.
        """
        sight.checked(picture.image, self.card.name)
        extras.need(self.card)
        return halving(lambda _: self._seen(picture.image), 1, 1, lambda _: None)

    def _seen(self, image: UInt8[np.ndarray, "H W 3"]) -> Segmentation:
        import torch

        prompts = read_prompts(self.prompts)
        network, side = self._network(), _side(self._network())
        words = self._tokens(prompts.texts)
        fit = lattices.fit((image.shape[1], image.shape[0]), (side, side), "stretch")
        tally = Tally.empty(image.shape[:2])
        with self.device.inference() as device:
            pixels = torch.from_numpy(_input(image, side))[None].to(device)
            encoded = network.get_vision_features(pixels)
            for index, votes in enumerate(prompts.votes):
                given = {name: tensor[index : index + 1].to(device) for name, tensor in words.items()}
                self._claim(tally, votes, network(vision_embeds=encoded, **given), fit)
        return tally.segmentation()

    def _claim(self, tally: Tally, votes: Float32[np.ndarray, "C"], answer: Any, fit: Fit) -> None:
        present = float(answer.presence_logits.float().sigmoid())
        scores = answer.pred_logits[0].float().sigmoid() * present
        for query in (scores > self.score).nonzero().flatten().tolist():
            logits = answer.pred_masks[0, query].float().cpu().numpy()
            tally.claim_instance(votes, sight.returned(logits, fit) > 0, float(scores[query]))
        if self.semantic:
            logits = answer.semantic_seg[0, 0].float()
            belief = sight.returned((logits.sigmoid() * present).cpu().numpy(), fit)
            inside = (belief > self.score) & (sight.returned(logits.cpu().numpy(), fit) > 0)
            tally.claim(votes, np.where(inside, belief, np.float32(0)))

    def _network(self) -> Any:
        extras.need(self.card)
        stamp = weights.fingerprint(self.card, self.weights)
        folder = hub_networks.folder_of(self.card, self.weights)
        return hub_networks.network("Sam3Model", folder, stamp, self.device.torch())

    def _tokens(self, texts: tuple[str, ...]) -> dict[str, Any]:
        """Token ids and attention mask, (P, 32) each: the length that SAM 3's text encoder was trained with."""
        folder = hub_networks.folder_of(self.card, self.weights)
        read = hub_networks.tokenizer(folder, weights.fingerprint(self.card, self.weights))
        length = min(32, self._network().config.text_config.max_position_embeddings)
        options = {"padding": "max_length", "max_length": length, "truncation": True, "return_tensors": "pt"}
        tokens = read(list(texts), **options)
        return {"input_ids": tokens["input_ids"], "attention_mask": tokens["attention_mask"]}


def _side(network: Any) -> int:
    size = network.config.image_size
    return int(size if isinstance(size, int) else size[0])


def _input(image: UInt8[np.ndarray, "H W 3"], side: int) -> Float32[np.ndarray, "3 h w"]:
    fit = lattices.fit(sight.checked(image, Sam3.card.name), (side, side), "stretch")
    return lattices.normalised(sight.shown(image, fit), *_MEAN_STD)
