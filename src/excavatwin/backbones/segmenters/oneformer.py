"""Segmenter "oneformer": one network for all segmentation tasks, asked for the semantic one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from jaxtyping import Float, Int64

from excavatwin.backbones.cards import Card, Tried, Weights
from excavatwin.backbones.segmenters.preparation import Preparation, preparation, read_settings
from excavatwin.backbones.segmenters.pretrained import Opened, first_line
from excavatwin.backbones.segmenters.readings import ClassMasks, Reading
from excavatwin.backbones.segmenters.resized import Resized
from excavatwin.errors import InputError

if TYPE_CHECKING:
    from torch import Tensor

#: The sentence that OneFormer was trained with (Jain et al., Sec. 3.1).
TASK = "the task is semantic"
#: The sets are on the hub as a pickle only.
_FILES = ("*.safetensors", "pytorch_model.bin", "*.json", "*.txt")


@dataclass(frozen=True)
class OneFormer(Resized):
    """OneFormer (Jain et al., CVPR 2023, arXiv 2211.06220)."""

    card: ClassVar[Card] = Card(
        name="oneformer",
        kind="segmenter",
        summary="OneFormer (SHI Labs): masks with class names of ADE20K, COCO or Cityscapes",
        tried=Tried.REAL_CODE,
        modules=("torch", "transformers"),
        install='pip install "excavatwin[transformers]"',
        weights=(
            Weights("shi-labs/oneformer_ade20k_swin_large", 880e6, "MIT", commercial=True, files=_FILES),
            Weights("shi-labs/oneformer_coco_swin_large", 879e6, "MIT", commercial=True, files=_FILES),
            Weights("shi-labs/oneformer_cityscapes_swin_large", float("nan"), "MIT", commercial=True, files=_FILES),
        ),
        argument="weights",
        source="https://github.com/SHI-Labs/OneFormer",
    )
    kinds: ClassVar[Mapping[str, str]] = {"oneformer": "OneFormerForUniversalSegmentation"}

    def preparation(self, folder: Path, config: Mapping[str, Any]) -> Preparation:
        """Short side 800 px, long side at most 1333 px, multiples of 32, unless the weights say otherwise."""
        return preparation(read_settings(folder), Preparation(800, 1333, 32))

    def look(self, network: Opened, pixels: Float[Tensor, "1 3 h w"], folder: Path) -> Reading:
        """Class and mask logits for the semantic task."""
        import torch

        tokens = task_tokens(folder, network.model.config.task_seq_len)
        told = network.model(pixel_values=pixels, task_inputs=torch.from_numpy(tokens)[None].to(pixels.device))
        return ClassMasks(told.class_queries_logits[0], told.masks_queries_logits[0])


@lru_cache(maxsize=4)
def task_tokens(folder: Path, length: int) -> Int64[np.ndarray, "length"]:
    """``the task is semantic`` as the tokenizer beside the weights spells it, zeros where it is padded.

    Raises:
        InputError: there is no tokenizer beside the weights.
    """
    from transformers import CLIPTokenizer

    try:
        if not (folder / "tokenizer.json").is_file() and not (folder / "vocab.json").is_file():
            raise FileNotFoundError("there is no vocab.json")  # the library would make up one of three words
        tokenizer = CLIPTokenizer.from_pretrained(folder, local_files_only=True)
    except Exception as error:  # the library raises a dozen kinds
        raise InputError(
            f"{folder} lacks OneFormer's tokenizer ({first_line(error)}); fetch vocab.json and merges.txt, too."
        ) from error
    told = tokenizer(TASK, padding="max_length", max_length=length, truncation=True)
    return np.asarray(told["input_ids"], np.int64) * np.asarray(told["attention_mask"], np.int64)
