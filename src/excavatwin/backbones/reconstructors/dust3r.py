"""DUSt3R (Wang et al., CVPR 2024): points of image pairs, aligned globally; see ``pairwise`` for its conventions.

Code and weights are CC BY-NC-SA 4.0. Scale is not metric.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

from excavatwin.backbones.cards import Card, Tried, Weights
from excavatwin.backbones.reconstructors.pairwise import Pairwise


@dataclass(frozen=True)
class Dust3r(Pairwise):
    """DUSt3R with its global alignment."""

    card: ClassVar[Card] = Card(
        name="dust3r",
        kind="reconstructor",
        summary="DUSt3R, from Naver: image pairs with global alignment; not for commercial use",
        tried=Tried.STAND_IN,
        licence="CC-BY-NC-SA-4.0",
        commercial=False,
        modules=("torch", "dust3r", "roma", "einops"),
        install=(
            'pip install "excavatwin[mast3r]" && pip install --no-deps '
            "git+https://github.com/naver/croco@croco_module git+https://github.com/naver/dust3r@dust3r_setup"
        ),
        weights=(
            Weights(
                "naver/DUSt3R_ViTLarge_BaseDecoder_512_dpt",
                2.29e9,
                "CC-BY-NC-SA-4.0",
                False,
                files=("*.safetensors", "*.json"),
            ),
        ),
        argument="weights",
        source="https://github.com/naver/dust3r",
    )

    def network(self) -> Callable[..., Any]:
        """Upstream's class."""
        from dust3r.model import AsymmetricCroCo3DStereo

        return AsymmetricCroCo3DStereo
