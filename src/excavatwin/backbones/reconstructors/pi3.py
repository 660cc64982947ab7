"""Pi3 and Pi3X (Wang et al. 2025): point maps in each camera and camera poses, no reference view.

Facts, read in yyfz/Pi3 (``pi3/models/{pi3,pi3x}.py``, ``pi3/utils/{basic,geometry}.py``, ``example*.py``):

* images: (B, N, 3, H, W) RGB in 0..1, sides multiples of 14, at most 255,000 pixels; normalised inside;
* poses: camera-to-world, OpenCV axes, in a world that is no particular camera's;
* no K is delivered: it is fitted here to the points in camera coordinates, so no pixel convention can be mistaken;
* confidence: logits, of which the authors take the sigmoid;
* scale: Pi3 knows none, Pi3X multiplies by one that it estimates (approximately metric);
* code BSD-3-Clause, both sets of weights CC BY-NC 4.0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from jaxtyping import UInt8

from excavatwin.backbones import extras, weights
from excavatwin.backbones.cards import Card, Tried, Weights
from excavatwin.backbones.device import Device
from excavatwin.backbones.reconstructors.footprint import footprint
from excavatwin.backbones.reconstructors.loading import checkpoint, fill, ready, tensors
from excavatwin.backbones.reconstructors.tensors import array, pictures
from excavatwin.backbones.reconstructors.unprojection import fitted_intrinsics, rigid
from excavatwin.backbones.sequence.feed_forward import FeedForward
from excavatwin.backbones.sequence.network import Network, Prediction


@dataclass(frozen=True)
class Pi3(FeedForward):
    """Pi3, or Pi3X when its weights are given."""

    card: ClassVar[Card] = Card(
        name="pi3",
        kind="reconstructor",
        summary="Pi3 and Pi3X: permutation-equivariant, no reference view; Pi3X estimates the metric scale",
        tried=Tried.STAND_IN,
        licence="BSD-3-Clause",
        modules=("torch", "pi3"),
        install='pip install "excavatwin[pi3]" && pip install --no-deps git+https://github.com/yyfz/Pi3',
        weights=(
            # Its size is counted from the code: Pi3 and a depth encoder (ViT-L), pose blocks, heads.
            Weights("yyfz233/Pi3X", 5.4e9, "CC-BY-NC-4.0", False, files=("*.safetensors", "*.json"), metric=True),
            Weights("yyfz233/Pi3", 3.84e9, "CC-BY-NC-4.0", False, files=("*.safetensors", "*.json")),
        ),
        argument="weights",
        source="https://github.com/yyfz/Pi3",
    )
    confidence: ClassVar[str] = "sigmoid"

    def open(self) -> Network:
        """Load it. Which of both the weights belong to shows in their tensors: only Pi3X has a metric token."""
        extras.need(self.card)
        file = checkpoint(weights.need(self.card, self.weights), self.card)
        state = tensors(file, self.card)
        metric = "metric_token" in state
        if metric:
            from pi3.models.pi3x import Pi3X

            model = Pi3X(use_multimodal=False)  # its encoders of known depth, rays and poses, which are not used here
        else:
            from pi3.models.pi3 import Pi3 as Plain

            model = Plain()
        fill(model, state, file, self.card)
        return _Network(ready(model, self.device), self.device, metric)

    def memory(self, images: int, height: int, width: int) -> float:
        """No figure is published. The trunk is VGGT's in kind and width but keeps 2 layers instead of 24, so VGGT's
        figure for an image is an upper bound; Pi3X's heads decode 64 images at once, about 6 layers of 64 channels.

        Its attention takes flash kernels in bfloat16 only. Outside CUDA and without bfloat16 torch stores the matrix of
        all tokens by all tokens, 16 heads in float32.
        """
        stored = 16 * 4 * (images * height * width / self.patch**2) ** 2 if self._stores_attention() else 0.0
        return footprint(3.84e9, images, height * width, each=1120, head=6 * 64 * 4, at_once=64) + stored

    def _stores_attention(self) -> bool:
        if extras.missing(self.card):
            return False  # nothing to ask; it cannot run either
        return self.device.torch().type != "cuda" and str(self.device.dtype()) != "torch.bfloat16"


@dataclass(frozen=True)
class _Network:
    model: Any
    device: Device
    metric: bool

    def __call__(self, images: UInt8[np.ndarray, "S H W 3"]) -> Prediction:
        with self.device.inference() as device:
            out = self.model(pictures(images, device)[None])
            confidence = out["conf"][0, ..., 0].float().sigmoid()
        K = fitted_intrinsics(array(out["local_points"][0]))
        poses = rigid(array(out["camera_poses"][0]))
        return Prediction(array(out["points"][0]), array(confidence), poses, K, self.metric)
