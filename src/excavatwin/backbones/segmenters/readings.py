"""What networks say about the classes of pixels, whatever form they say it in: class logits, or masks with classes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from jaxtyping import Float, Float32, Float64

from excavatwin.backbones.segmenters.resampling import bilinear

if TYPE_CHECKING:
    from torch import Tensor


class Reading(Protocol):
    """A network's output for one picture, or for one window of it."""

    @property
    def grid(self) -> tuple[int, int]:
        """(h, w) of the grid on which the output lies [px]."""
        ...

    @property
    def depth(self) -> int:
        """Maps that are interpolated at once: what memory depends on."""
        ...

    @property
    def classes(self) -> int:
        """V, without "no object"."""
        ...

    def at(
        self, y: Float64[np.ndarray, "n"], x: Float64[np.ndarray, "m"], columns: Float32[np.ndarray, "V C"]
    ) -> Float[Tensor, "C n m"]:
        """``sum_v p(v) * columns[v]`` at points of the grid, p(v) in [0, 1] with a sum of at most 1."""
        ...


@dataclass(frozen=True)
class ClassLogits:
    """One logit for every class and cell: SegFormer and other per-pixel classifiers."""

    logits: Float[Tensor, "V h w"]

    @property
    def grid(self) -> tuple[int, int]:
        """(h, w) of the logits."""
        return self.logits.shape[-2], self.logits.shape[-1]

    @property
    def depth(self) -> int:
        """V."""
        return self.logits.shape[0]

    @property
    def classes(self) -> int:
        """V."""
        return self.logits.shape[0]

    def at(
        self, y: Float64[np.ndarray, "n"], x: Float64[np.ndarray, "m"], columns: Float32[np.ndarray, "V C"]
    ) -> Float[Tensor, "C n m"]:
        """p = softmax of the interpolated logits (interpolated first, as SegFormer's own evaluation does)."""
        import torch

        p = bilinear(self.logits.float(), y, x).softmax(0)
        return torch.einsum("vnm,vc->cnm", p, torch.from_numpy(columns).to(p.device))


@dataclass(frozen=True)
class ClassMasks:
    """Queries, each a mask and a distribution over the classes and "no object": MaskFormer and its successors.

    Semantic inference of MaskFormer (arXiv 2107.06278, Sec. 3.4; the same in Mask2Former, OneFormer and EoMT) adds up
    ``S_v = sum_q P_q(v) m_q`` with ``P = softmax(class logits)`` and ``m = sigmoid(mask logits)``, and takes the
    arg-max. Matched queries share an image among them, so that S is a distribution with the rest unclaimed; where
    several queries claim one pixel it exceeds 1. Evidence is ``S_v / max(1, sum_v S_v)``: what no query claims for a
    class stays missing, and "no object" takes the room that is left.

    It does not compete for room, ``S_v / max(1, sum_v S_v + sum_q P_q(no object) m_q)``, because a query that says
    "no object" is trained without a mask: where its mask lies is chance. ``benchmarks/no_object.py`` measures both on
    a small Mask2Former (100 queries): competing leaves things it was never taught unknown, but the arbitrary masks
    also lie on whole classes that it recognises, and 37 % of the things of known classes lose their evidence (0.4 %
    here). The price here is that a thing never seen gets the evidence of what it resembles.
    """

    claims: Float[Tensor, "Q V+1"]
    """Class logits of the queries; the last column is "no object"."""
    masks: Float[Tensor, "Q h w"]
    """Mask logits of the queries."""

    @property
    def grid(self) -> tuple[int, int]:
        """(h, w) of the masks."""
        return self.masks.shape[-2], self.masks.shape[-1]

    @property
    def depth(self) -> int:
        """Q."""
        return self.masks.shape[0]

    @property
    def classes(self) -> int:
        """V, without "no object"."""
        return self.claims.shape[1] - 1

    def at(
        self, y: Float64[np.ndarray, "n"], x: Float64[np.ndarray, "m"], columns: Float32[np.ndarray, "V C"]
    ) -> Float[Tensor, "C n m"]:
        """Evidence, with masks interpolated as logits (as in Mask2Former's code) and not by way of 384 px."""
        import torch

        P = self.claims.float().softmax(-1)[:, :-1]
        wanted = torch.cat([P @ torch.from_numpy(columns).to(P.device), P.sum(-1, keepdim=True)], -1)
        total = torch.einsum("qnm,qc->cnm", bilinear(self.masks.float(), y, x).sigmoid(), wanted)
        return total[:-1] / total[-1:].clamp(min=1)
