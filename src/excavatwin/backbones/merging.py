"""Several segmenters at once: their evidence merged channel by channel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from excavatwin.backbones.protocols import Segmentation
from excavatwin.errors import InputError
from excavatwin.scene.taxonomy import K


@dataclass(frozen=True)
class Merging:
    """Weighted sum of the evidence, scaled down where it exceeds 1: who abstains dilutes nobody."""

    weights: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    """Segmenter -> weight of each of the five channels; 1 for those that are not named."""

    def __call__(self, seen: Mapping[str, Segmentation]) -> Segmentation:
        """One segmentation from those of all segmenters, by name; a single one passes unchanged."""
        strange = [name for name, row in self.weights.items() if len(row) != K]
        if strange:
            raise InputError(f"merging.weights of {strange[0]} has {len(self.weights[strange[0]])} values; give {K}.")
        if len(seen) == 1 and not self.weights:
            return next(iter(seen.values()))
        ones = (1.0,) * K
        total = sum(one.evidence * np.float32(self.weights.get(name, ones)) for name, one in seen.items())
        evidence = total / np.maximum(total.sum(-1, keepdims=True), 1)
        votes = np.mean([one.no_surface for one in seen.values()], axis=0)
        none = votes > 0.5
        evidence[none] = 0
        return Segmentation(evidence.astype(np.float32), none)
