"""A segmenter of three lines: what is green grows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from excavatwin.backbones.cards import Card, Tried
from excavatwin.backbones.protocols import Picture, Segmentation
from excavatwin.scene.taxonomy import K, TaskClass


@dataclass(frozen=True)
class Greenness:
    """Excess green against a threshold."""

    card: ClassVar[Card] = Card(
        name="greenness",
        kind="segmenter",
        summary="excess green: plants are removable cover, the rest is ground",
        tried=Tried.BUILT_IN,
    )

    threshold: float = 0.06
    """Excess green (2G - R - B) / (R + G + B) at which plants and ground are equally likely [1]."""
    softness: float = 0.03
    """Excess green beyond the threshold at which plants are all but certain [1]."""
    sure: float = 0.8
    """Evidence where all is clear; the rest stays doubt [1]."""

    def identity(self) -> str:
        """Nothing decides the result but the parameters and this code."""
        return "greenness 1"

    def __call__(self, picture: Picture) -> Segmentation:
        """Evidence (H, W, 5) on the pixels of the picture; nothing is without surface."""
        r, g, b = np.moveaxis(picture.image.astype(np.float32), -1, 0)
        excess = (2 * g - r - b) / np.maximum(r + g + b, 1)
        plant = 1 / (1 + np.exp(-4 * (excess - self.threshold) / self.softness))
        evidence = np.zeros((*plant.shape, K), np.float32)
        evidence[..., TaskClass.REMOVABLE_COVER - 1] = self.sure * plant
        evidence[..., TaskClass.CONSTRUCTION_TERRAIN - 1] = self.sure * (1 - plant)
        return Segmentation(evidence, np.zeros(plant.shape, bool))
