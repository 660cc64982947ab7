"""Segmenter "eomt": a plain vision transformer that segments, with class names of ADE20K, COCO or Cityscapes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from jaxtyping import Float, Float32, UInt8

from excavatwin.backbones.cards import Card, Tried, Weights
from excavatwin.backbones.segmenters.closed_vocabulary import ClosedVocabulary
from excavatwin.backbones.segmenters.preparation import Preparation, preparation, read_settings
from excavatwin.backbones.segmenters.pretrained import Opened
from excavatwin.backbones.segmenters.readings import ClassMasks, Reading
from excavatwin.backbones.segmenters.windows import Window, split

if TYPE_CHECKING:
    from torch import Tensor


@dataclass(frozen=True)
class Eomt(ClosedVocabulary):
    """Encoder-only mask transformer (Kerssies et al., CVPR 2025, arXiv 2503.19108).

    Its input is a square of fixed size. Semantic weights see the picture in overlapping squares along its longer side,
    which are averaged; panoptic ones see it padded with black on the right or below. Which, the weights say.
    """

    card: ClassVar[Card] = Card(
        name="eomt",
        kind="segmenter",
        summary="EoMT (TU Eindhoven): a plain ViT with class names of ADE20K, COCO or Cityscapes",
        tried=Tried.REAL_CODE,
        modules=("torch", "transformers"),
        install='pip install "excavatwin[transformers]"',
        weights=(
            Weights("tue-mps/ade20k_semantic_eomt_large_512", float("nan"), "MIT", commercial=True),
            Weights("tue-mps/coco_panoptic_eomt_large_640", float("nan"), "MIT", commercial=True),
            Weights("tue-mps/cityscapes_semantic_eomt_large_1024", float("nan"), "MIT", commercial=True),
        ),
        argument="weights",
        source="https://github.com/tue-mps/eomt",
    )
    kinds: ClassVar[Mapping[str, str]] = {
        "eomt": "EomtForUniversalSegmentation",
        "eomt_dinov3": "EomtDinov3ForUniversalSegmentation",
    }
    published: ClassVar[Mapping[str, str]] = {
        "tue-mps/ade20k_semantic_eomt_large_512": "ade20k-150",
        "tue-mps/coco_panoptic_eomt_large_640": "coco-panoptic",
        "tue-mps/cityscapes_semantic_eomt_large_1024": "cityscapes",
    }

    def preparation(self, folder: Path, config: Mapping[str, Any]) -> Preparation:
        """Squares as large as the network's: the short side fills them (semantic), or the long side (padded)."""
        settings, side = read_settings(folder), int(config.get("image_size", 640))
        how = preparation(settings, Preparation(side))
        return replace(how, shortest=side, longest=side if _padded(settings) else None, multiple=1)

    def look(self, network: Opened, pixels: Float[Tensor, "1 3 h w"], folder: Path) -> Reading:
        """Class and mask logits of the last block.

        Masked attention is a help in training that is annealed away; where weights do not say how far (the published
        ones may not carry ``attn_mask_probs``), or were saved on the way, it is off, or the result would be random.
        """
        import torch

        probabilities = network.model.attn_mask_probs
        if "attn_mask_probs" in network.missing:
            probabilities.zero_()
        probabilities.copy_(torch.floor(probabilities))
        told = network.model(pixel_values=pixels)
        return ClassMasks(told.class_queries_logits[0], told.masks_queries_logits[0])

    def _prepared(
        self, image: UInt8[np.ndarray, "H W 3"], folder: Path, config: Mapping[str, Any], side: int
    ) -> tuple[Float32[np.ndarray, "3 h w"], tuple[int, int], list[Window]]:
        how = self.preparation(folder, config)
        shape, square = how.shape(image.shape[0], image.shape[1]), how.shortest
        if _padded(read_settings(folder)):
            return how.pixels(image, shape, (square, square)), shape, [Window(0, square, 0, square)]
        return how.pixels(image, shape), shape, split(shape, square)

    def _sides(self, image: np.ndarray, folder: Path, config: Mapping[str, Any]) -> tuple[int, int]:
        side = self.preparation(folder, config).shortest
        return side, side


def _padded(settings: Mapping[str, Any]) -> bool:
    """Whether pictures are padded to a square, and not cut into squares."""
    return bool(settings.get("do_pad")) and not settings.get("do_split_image")
