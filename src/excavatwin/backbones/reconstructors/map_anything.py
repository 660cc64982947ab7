"""MapAnything (Keetha et al. 2025): metric points, depth and cameras of all images in one pass.

Facts, read in facebookresearch/map-anything (``models/mapanything/model.py``, ``utils/{inference,geometry,image}.py``,
README) and in uniception on PyPI (``models/encoders/{dinov2,image_normalizations}.py``):

* images: one dict a view, ``img`` (1, 3, H, W) RGB with ImageNet mean and standard deviation (``dinov2``), sides
  multiples of 14, longer side 518 px;
* poses: camera-to-world, OpenCV axes, world = first camera; metres, the scale being the network's estimate;
* K: fitted upstream to the ray of each pixel, counted at whole numbers: K + 0.5 for centres at +0.5, points unchanged;
* confidence: 1 + exp(x) for the published weights; ``mask``: where the geometry is unambiguous (no sky, no glass) and
  no edge artefact; masked points are zero upstream, NaN here;
* ``from_pretrained`` would let torch.hub fetch the code and the weights of DINOv2 unasked: its code must be there, and
  its weights are not needed because the checkpoint holds the encoder;
* code Apache-2.0; weights ``map-anything-apache`` Apache-2.0, ``map-anything`` CC BY-NC 4.0.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jaxtyping import UInt8

from excavatwin.backbones import extras, weights
from excavatwin.backbones.cards import Card, Tried, Weights
from excavatwin.backbones.device import Device
from excavatwin.backbones.lattices import IMAGENET
from excavatwin.backbones.reconstructors.footprint import footprint
from excavatwin.backbones.reconstructors.loading import build, checkpoint, fill, ready, settings, tensors
from excavatwin.backbones.reconstructors.tensors import array, pictures
from excavatwin.backbones.reconstructors.unprojection import centred, rigid
from excavatwin.backbones.sequence.feed_forward import FeedForward
from excavatwin.backbones.sequence.network import Network, Prediction
from excavatwin.errors import InputError

_NORM = "dinov2"


@dataclass(frozen=True)
class MapAnything(FeedForward):
    """MapAnything from images alone."""

    card: ClassVar[Card] = Card(
        name="map-anything",
        kind="reconstructor",
        summary="MapAnything, from Meta and CMU: points in metres, with weights for commercial use",
        tried=Tried.STAND_IN,
        modules=("torch", "mapanything", "uniception"),
        install='pip install "excavatwin[map-anything]" git+https://github.com/facebookresearch/map-anything',
        weights=(
            Weights("facebook/map-anything-apache", 4.9e9, "Apache-2.0", True, metric=True),
            Weights("facebook/map-anything", 4.9e9, "CC-BY-NC-4.0", False, metric=True),
        ),
        argument="weights",
        metric=True,
        source="https://github.com/facebookresearch/map-anything",
    )
    confidence: ClassVar[str] = "1 + exp"

    edges: bool = True
    """Whether points at jumps of depth and normal, which often lie between two surfaces, are left out."""

    def open(self) -> Network:
        """Load it.

        Raises:
            InputError: DINOv2's code is not in torch.hub's folder, or the weights want another normalisation.
        """
        extras.need(self.card)
        file = checkpoint(weights.need(self.card, self.weights), self.card)
        from mapanything.models import MapAnything as Model

        chosen = settings(file)
        encoder = dict(chosen.get("encoder_config") or {})
        if encoder.get("uses_torch_hub"):
            _need_dinov2()
            chosen["encoder_config"] = encoder | {"torch_hub_pretrained": False}
        model = build(Model, chosen, self.card)
        if model.encoder.data_norm_type != _NORM:
            raise InputError(
                f"weights of map-anything: {file} wants images normalised as {model.encoder.data_norm_type!r}, this "
                f"adapter knows {_NORM!r}; use facebook/map-anything-apache."
            )
        fill(model, tensors(file, self.card), file, self.card)
        return _Network(ready(model, self.device), self.device, self.edges)

    def memory(self, images: int, height: int, width: int) -> float:
        """From the README: with memory-efficient heads, 2000 views fit on 140 GB; that is 70 MB for 518 x 392 px.

        Those heads decode one image after the other.
        """
        return footprint(4.9e9, images, height * width, each=340, head=13 * 256, at_once=1)


@dataclass(frozen=True)
class _Network:
    model: Any
    device: Device
    edges: bool

    def __call__(self, images: UInt8[np.ndarray, "S H W 3"]) -> Prediction:
        batch = pictures(images, self.device.torch(), *IMAGENET)
        precision = str(self.device.dtype()).rpartition(".")[2]
        out = self.model.infer(
            [{"img": picture[None], "data_norm_type": [_NORM]} for picture in batch],
            memory_efficient_inference=True,
            use_amp=precision != "float32",
            amp_dtype={"bfloat16": "bf16", "float16": "fp16", "float32": "fp32"}[precision],
            apply_mask=True,
            mask_edges=self.edges,
        )
        mask = np.stack([array(view["mask"][0, ..., 0]) for view in out]) > 0
        points = np.stack([array(view["pts3d"][0]) for view in out])
        points[~mask] = np.nan
        confidence = np.where(mask, np.stack([array(view["conf"][0]) for view in out]), np.float32(0))
        T = rigid(np.stack([array(view["camera_poses"][0]) for view in out]))
        K = centred(np.stack([array(view["intrinsics"][0]) for view in out]))
        return Prediction(points, confidence, T, K, metric=True)


def _need_dinov2() -> None:
    """Refuse to let torch.hub download code.

    Raises:
        InputError: the code of DINOv2 is not where torch.hub looks for it.
    """
    import torch

    place = Path(torch.hub.get_dir()) / "facebookresearch_dinov2_main"
    if not place.is_dir():
        raise InputError(
            f"map-anything builds its encoder from the code of DINOv2, which is not in {place}; run: "
            f"git clone --depth 1 https://github.com/facebookresearch/dinov2 {place}"
        )
