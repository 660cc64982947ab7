"""From instances (masks with scores) and maps of single prompts to evidence for the task classes.

Open-vocabulary networks answer each prompt by itself: "here is dirt, 0.6", "here is soil, 0.5", "here is a truck,
0.3". Their answers are neither exclusive nor do they sum to one, so three choices are made here:

- *The same class twice* (dirt and soil, or two detections of one machine): the larger belief counts. The answers come
  from one network looking at the same pixels, they are not independent; noisy-or would make certainty of repetition.
- *Different classes on one pixel*: exactly one can be true, so they share by their odds p / (1 - p), which is the
  posterior of independent yes/no answers given that exactly one of them is yes.
- *How much there is to share*: the strongest single belief. Contradicting answers do not add up to more certainty.

What remains up to one is doubt. Evidence is therefore sparse: zero where nothing answered.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from jaxtyping import Bool, Float32

from excavatwin.backbones.protocols import Segmentation
from excavatwin.backbones.segmenters.prompts import CHANNELS, NO_SURFACE
from excavatwin.scene.taxonomy import K

#: Share of the pixel beyond which it is sky or water.
SURFACELESS = 0.5
#: No answer of a network is taken for certain: keeps odds finite and sums at most 1 in float32.
_CERTAIN = np.float32(1 - 1e-6)


@dataclass(frozen=True)
class Tally:
    """What has been claimed about the pixels of one picture so far. Its arrays change as claims come in."""

    scores: Float32[np.ndarray, "C H W"]
    """Largest belief for each channel: task classes 1..5, no_surface, nothing."""
    strongest: Float32[np.ndarray, "H W"]
    """Largest belief of a single claim, over all channels that it votes for."""

    @classmethod
    def empty(cls, shape: tuple[int, int]) -> Self:
        """Nothing claimed yet on (H, W) pixels."""
        return cls(np.zeros((CHANNELS, *shape), np.float32), np.zeros(shape, np.float32))

    def claim(self, votes: Float32[np.ndarray, "C"], belief: Float32[np.ndarray, "H W"]) -> None:
        """Add the answer to one prompt, or one instance.

        Args:
            votes: weights of the prompt for the channels, their sum at most 1.
            belief: in [0, 1], zero outside the instance.
        """
        for channel in np.flatnonzero(votes):
            np.maximum(self.scores[channel], votes[channel] * belief, out=self.scores[channel])
        np.maximum(self.strongest, votes.sum() * belief, out=self.strongest)

    def claim_instance(self, votes: Float32[np.ndarray, "C"], mask: Bool[np.ndarray, "H W"], score: float) -> None:
        """Add one instance: mask times score."""
        self.claim(votes, mask * np.float32(min(max(score, 0.0), 1.0)))

    def segmentation(self) -> Segmentation:
        """Evidence, and the pixels of sky and water, which get none."""
        odds = np.minimum(self.scores, _CERTAIN)
        odds = odds / (1 - odds)
        shares = odds / np.maximum(odds.sum(0), np.finfo(np.float32).tiny) * np.minimum(self.strongest, _CERTAIN)
        no_surface = shares[NO_SURFACE] > SURFACELESS
        evidence = np.ascontiguousarray(shares[:K].transpose(1, 2, 0), np.float32)
        evidence[no_surface] = 0
        silent = not self.strongest.any()
        return Segmentation(evidence, no_surface, ("none of its prompts was found in the photo.",) if silent else ())


def told(found: Segmentation, said: Sequence[str]) -> Segmentation:
    """The segmentation with more that the user should know."""
    return replace(found, doubts=(*said, *found.doubts))
