"""Segmenter "mask2former": mask classification with class names of ADE20K, COCO, Cityscapes or Mapillary Vistas."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from jaxtyping import Float

from excavatwin.backbones.cards import Card, Tried, Weights
from excavatwin.backbones.segmenters.preparation import Preparation, preparation, read_settings
from excavatwin.backbones.segmenters.pretrained import Opened
from excavatwin.backbones.segmenters.readings import ClassMasks, Reading
from excavatwin.backbones.segmenters.resized import Resized

if TYPE_CHECKING:
    from torch import Tensor

#: By the authors' MODEL_ZOO.md; the hub says "other".
_LICENCE = "CC-BY-NC-4.0"


@dataclass(frozen=True)
class Mask2Former(Resized):
    """Masked-attention mask transformer (Cheng et al., CVPR 2022, arXiv 2112.01527)."""

    card: ClassVar[Card] = Card(
        name="mask2former",
        kind="segmenter",
        summary="Mask2Former (Meta): masks with class names of ADE20K, COCO, Cityscapes or Vistas",
        tried=Tried.REAL_CODE,
        modules=("torch", "transformers"),
        install='pip install "excavatwin[transformers]"',
        weights=(
            Weights("facebook/mask2former-swin-large-ade-semantic", 866e6, _LICENCE, commercial=False),
            Weights("facebook/mask2former-swin-large-coco-panoptic", 866e6, _LICENCE, commercial=False),
            Weights("facebook/mask2former-swin-large-cityscapes-semantic", 866e6, _LICENCE, commercial=False),
            Weights("facebook/mask2former-swin-large-mapillary-vistas-semantic", 866e6, _LICENCE, commercial=False),
        ),
        argument="weights",
        source="https://github.com/facebookresearch/Mask2Former",
    )
    kinds: ClassVar[Mapping[str, str]] = {"mask2former": "Mask2FormerForUniversalSegmentation"}

    def preparation(self, folder: Path, config: Mapping[str, Any]) -> Preparation:
        """Short side 800 px, long side at most 1333 px, multiples of 32, unless the weights say otherwise."""
        return preparation(read_settings(folder), Preparation(800, 1333, 32))

    def look(self, network: Opened, pixels: Float[Tensor, "1 3 h w"], folder: Path) -> Reading:
        """Class and mask logits of the last decoder layer."""
        told = network.model(pixel_values=pixels)
        return ClassMasks(told.class_queries_logits[0], told.masks_queries_logits[0])
