"""Grounding DINO and SAM: boxes of what is named in words, and the mask of what is in each box."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float32, Float64, Int, UInt8

from excavatwin.backbones import extras, lattices, weights
from excavatwin.backbones.cards import Card, Tried, Weights
from excavatwin.backbones.device import Device, halving
from excavatwin.backbones.protocols import Picture, Segmentation
from excavatwin.backbones.segmenters import hub_networks, sight
from excavatwin.backbones.segmenters.box_masks import BoxMasks
from excavatwin.backbones.segmenters.instances import Tally, told
from excavatwin.backbones.segmenters.prompts import read_prompts
from excavatwin.errors import InputError, require


@dataclass(frozen=True)
class GroundedSam:
    """Grounding DINO (Liu et al., ECCV 2024) and SAM or SAM 2 (Kirillov et al., 2023; Ravi et al., 2024), transformers.

    Prompts are joined by full stops, as many at a time as fit the detector's text, and each box goes to the prompt
    with the highest score: the mean over its tokens (as in the authors' evaluation on COCO), so that "traffic" alone
    does not fire "traffic cone". Evidence of a pixel in the mask of a box: score of the box times the mask's own
    predicted IoU. How instances become evidence: ``instances``.
    """

    card: ClassVar[Card] = Card(
        name="grounded-sam",
        kind="segmenter",
        summary="text to boxes to masks, for things rather than ground; Grounding DINO (IDEA) with SAM 1 or 2 (Meta)",
        tried=Tried.REAL_CODE,
        modules=("torch", "transformers"),
        install='pip install "excavatwin[transformers]"',
        weights=(
            Weights("IDEA-Research/grounding-dino-base", 9.33e8, "Apache-2.0", True),
            Weights("IDEA-Research/grounding-dino-tiny", 6.9e8, "Apache-2.0", True),
            Weights("facebook/sam2.1-hiera-small", 1.84e8, "Apache-2.0", True),
            Weights("facebook/sam2.1-hiera-large", 8.98e8, "Apache-2.0", True),
            Weights("facebook/sam-vit-base", 3.75e8, "Apache-2.0", True),
        ),
        weight_fields=("weights", "mask_weights"),
        argument="weights",
        source="https://github.com/IDEA-Research/Grounded-Segment-Anything",
    )

    weights: str = ""
    """Detector: name on the hub, or path of a folder; empty for grounding-dino-base."""
    mask_weights: str = "facebook/sam2.1-hiera-small"
    """SAM or SAM 2 for the masks: name on the hub, or path of a folder."""
    prompts: str = "excavation"
    """What is looked for: a shipped set of prompts, or path of an own TOML file of that form."""
    score: float = 0.25
    """Least score of a box, 0..1; fainter ones give no evidence."""
    most: int = 200
    """Most boxes of one pass that get a mask, the best ones."""
    short_side: int = 800
    """Short side of what the detector sees [px]."""
    long_side: int = 1333
    """Its long side does not exceed this [px]."""
    batch: int = 32
    """Boxes that get their masks at a time."""
    device: Device = field(default_factory=Device)
    """What the networks run on."""

    def __post_init__(self) -> None:
        require(self, "score", 0, 1)
        require(self, "most", 1)
        require(self, "batch", 1)
        require(self, "short_side", 32)
        require(self, "long_side", self.short_side)

    def identity(self) -> str:
        """Versions of the libraries, which weights, and what the prompts are."""
        stamps = f"{self._stamp()}; {weights.fingerprint(self.card, self.mask_weights)}"
        return f"{extras.versions(self.card)}; {stamps}; {read_prompts(self.prompts).identity()}"

    def prepare(self, image: UInt8[np.ndarray, "H W 3"]) -> Float32[np.ndarray, "3 h w"]:
        """What the detector sees: RGB, resized, normalised as ImageNet is."""
        fit = sight.bounded(sight.checked(image, self.card.name), self.short_side, self.long_side)
        return lattices.normalised(sight.shown(image, fit), *lattices.IMAGENET)

    def __call__(self, picture: Picture) -> Segmentation:
        """Evidence on the pixels of the picture.

        Raises:
            MissingExtraError: torch or transformers is not installed.
            InputError: wrong prompts, no weights, a wrong image, too little memory.
        """
        sight.checked(picture.image, self.card.name)
        extras.need(self.card)
        said: list[str] = []
        found = halving(lambda batch: self._seen(picture.image, batch), self.batch, 1, said.append, "boxes at a time")
        return told(found, said)

    def _seen(self, image: UInt8[np.ndarray, "H W 3"], batch: int) -> Segmentation:
        prompts = read_prompts(self.prompts)
        folder = hub_networks.folder_of(self.card, self.mask_weights, "mask_weights")
        masks = BoxMasks(folder, weights.fingerprint(self.card, self.mask_weights), self.device, batch)
        tally = Tally.empty(image.shape[:2])
        boxes, scores, owners = self._boxes(image, prompts.texts)
        for index, mask, quality in masks(image, boxes):
            tally.claim_instance(prompts.votes[owners[index]], mask, float(scores[index]) * quality)
        return tally.segmentation()

    def _boxes(
        self, image: UInt8[np.ndarray, "H W 3"], texts: tuple[str, ...]
    ) -> tuple[Float64[np.ndarray, "n 4"], Float32[np.ndarray, "n"], Int[np.ndarray, "n"]]:
        """Boxes x0, y0, x1, y1 [px of the picture], their scores, and which prompt each belongs to."""
        import torch

        folder = hub_networks.folder_of(self.card, self.weights)
        network = hub_networks.network("GroundingDinoForObjectDetection", folder, self._stamp(), self.device.torch())
        read = hub_networks.tokenizer(folder, self._stamp())
        size = np.array([image.shape[1], image.shape[0]] * 2, float)
        found: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        with self.device.inference() as device:
            pixels = torch.from_numpy(self.prepare(image))[None].to(device)
            for first, ids in passes(texts, read, network.config.max_text_len):
                tokens = torch.tensor([ids], device=device)
                answer = network(pixel_values=pixels, input_ids=tokens, token_type_ids=torch.zeros_like(tokens))
                p = answer.logits[0, :, : len(ids)].float().sigmoid().cpu().numpy()
                centre, extent = np.split(answer.pred_boxes[0].float().cpu().numpy().astype(float), 2, axis=-1)
                spans = phrases(ids, read.convert_tokens_to_ids("."))
                scores = np.stack([p[:, start:stop].mean(-1) for start, stop in spans], -1)
                kept = np.argsort(-scores.max(-1), kind="stable")[: self.most]
                kept = kept[scores[kept].max(-1) > self.score]
                corners = np.concatenate([centre - extent / 2, centre + extent / 2], -1).clip(0, 1) * size
                found.append((corners[kept], scores[kept].max(-1), first + scores[kept].argmax(-1)))
        boxes, scores, owners = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return boxes, scores, owners

    def _stamp(self) -> str:
        return weights.fingerprint(self.card, self.weights)


def passes(texts: tuple[str, ...], read: Any, longest: int) -> Iterator[tuple[int, list[int]]]:
    """Prompts joined as the detector wants them, "dirt. road. excavator.", as many at a time as it can read.

    Yields:
        Index of the first prompt, token ids.

    Raises:
        InputError: a prompt contains what parts prompts, or does not fit by itself.
    """
    parted = next((text for text in texts if "." in text or "?" in text), None)
    if parted is not None:
        raise InputError(f"prompt {parted!r} contains a full stop or question mark, which part prompts; remove it.")
    first = 0
    while first < len(texts):
        count, ids = 0, []
        for more in range(1, len(texts) - first + 1):
            longer = read(" ".join(f"{text.lower()}." for text in texts[first : first + more]))["input_ids"]
            if len(longer) > longest:
                break
            count, ids = more, longer
        if not count:
            raise InputError(f"prompt {texts[first]!r} has more than {longest} tokens; use a few words.")
        yield first, list(ids)
        first += count


def phrases(ids: list[int], stop: int) -> list[tuple[int, int]]:
    """Where each prompt's tokens lie, (first, end): between full stops, without the special tokens at the ends."""
    found, start = [], 1
    for place, token in enumerate(ids):
        if token == stop:
            found.append((start, place))
            start = place + 1
    return found
