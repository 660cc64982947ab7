"""MASt3R (Leroy et al., ECCV 2024): DUSt3R's successor in metres; see ``pairwise`` for its conventions.

Code and weights are CC BY-NC-SA 4.0; the weights add the terms of their training data (Map-free above all).
Its own sparse alignment wants files and a cache on disk; DUSt3R's is used, which takes MASt3R's output as well
(``demo_dust3r_ga.py``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

from excavatwin.backbones.cards import Card, Tried, Weights
from excavatwin.backbones.reconstructors.pairwise import Pairwise


@dataclass(frozen=True)
class Mast3r(Pairwise):
    """MASt3R with DUSt3R's global alignment."""

    card: ClassVar[Card] = Card(
        name="mast3r",
        kind="reconstructor",
        summary="MASt3R, from Naver: image pairs in metres with global alignment; not for commercial use",
        tried=Tried.STAND_IN,
        licence="CC-BY-NC-SA-4.0",
        commercial=False,
        modules=("torch", "mast3r", "roma", "einops"),
        install=(
            'pip install "excavatwin[mast3r]" && git clone --recursive https://github.com/naver/mast3r && '
            'export PYTHONPATH="$PWD/mast3r:$PYTHONPATH"'
        ),
        weights=(
            Weights(
                "naver/MASt3R_ViTLarge_BaseDecoder_512_catmlpdpt_metric",
                2.75e9,
                "CC-BY-NC-SA-4.0 and terms of training data",
                False,
                files=("*.safetensors", "*.json"),
                metric=True,
            ),
        ),
        argument="weights",
        metric=True,
        source="https://github.com/naver/mast3r",
    )

    def network(self) -> Callable[..., Any]:
        """Upstream's class."""
        from mast3r.model import AsymmetricMASt3R  # also makes its copy of dust3r importable

        return AsymmetricMASt3R
