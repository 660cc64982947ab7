"""Segmenter "segformer": per-pixel classes of ADE20K or Cityscapes, fast and small."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from jaxtyping import Float

from excavatwin.backbones.cards import Card, Tried, Weights
from excavatwin.backbones.segmenters.preparation import Preparation, preparation, read_settings
from excavatwin.backbones.segmenters.pretrained import Opened
from excavatwin.backbones.segmenters.readings import ClassLogits, Reading
from excavatwin.backbones.segmenters.resized import Resized

if TYPE_CHECKING:
    from torch import Tensor

#: Research and evaluation only; the hub says "other".
_LICENCE = "NVIDIA Source Code License for SegFormer"
#: The larger sets are on the hub as a pickle only.
_FILES = ("*.safetensors", "pytorch_model.bin", "*.json")


@dataclass(frozen=True)
class Segformer(Resized):
    """SegFormer (Xie et al., NeurIPS 2021, arXiv 2105.15203).

    Its softmax leaves no room for doubt: every pixel's probabilities add up to 1, and what is missing in the evidence
    is only what belongs to classes that never vote. Where that matters, take a network that knows "no object".
    """

    card: ClassVar[Card] = Card(
        name="segformer",
        kind="segmenter",
        summary="SegFormer (NVIDIA): per-pixel classes of ADE20K or Cityscapes, fast",
        tried=Tried.REAL_CODE,
        modules=("torch", "transformers"),
        install='pip install "excavatwin[transformers]"',
        weights=(
            Weights("nvidia/segformer-b5-finetuned-ade-640-640", 339e6, _LICENCE, commercial=False, files=_FILES),
            Weights("nvidia/segformer-b0-finetuned-ade-512-512", 15e6, _LICENCE, commercial=False),
            Weights(
                "nvidia/segformer-b5-finetuned-cityscapes-1024-1024", 339e6, _LICENCE, commercial=False, files=_FILES
            ),
        ),
        argument="weights",
        source="https://github.com/NVlabs/SegFormer",
    )
    kinds: ClassVar[Mapping[str, str]] = {"segformer": "SegformerForSemanticSegmentation"}

    def preparation(self, folder: Path, config: Mapping[str, Any]) -> Preparation:
        """Short side 512 px, multiples of 32, unless the weights say otherwise; the picture keeps its shape."""
        return preparation(read_settings(folder), Preparation(512, None, 32))

    def look(self, network: Opened, pixels: Float[Tensor, "1 3 h w"], folder: Path) -> Reading:
        """Class logits at a quarter of the input's resolution."""
        return ClassLogits(network.model(pixel_values=pixels).logits[0])
