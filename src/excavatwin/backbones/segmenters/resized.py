"""Closed-vocabulary networks that take pictures of any size."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, UInt8

from excavatwin.backbones.segmenters.closed_vocabulary import ClosedVocabulary
from excavatwin.backbones.segmenters.windows import Window
from excavatwin.errors import require


@dataclass(frozen=True)
class Resized(ClosedVocabulary):
    """The whole picture at once, at the size that the weights or the user ask for."""

    long_side: int = 0
    """Long side of the network's input; 0 for the size that the weights were trained for [px]."""

    def __post_init__(self) -> None:
        require(self, "long_side", 0)

    def _prepared(
        self, image: UInt8[np.ndarray, "H W 3"], folder: Path, config: Mapping[str, Any], side: int
    ) -> tuple[Float32[np.ndarray, "3 h w"], tuple[int, int], list[Window]]:
        return super()._prepared(image, folder, config, side or self.long_side)
