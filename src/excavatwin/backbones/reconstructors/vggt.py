"""VGGT (Wang et al., CVPR 2025): depth, cameras and points of all images in one pass.

Facts, read in facebookresearch/vggt (``vggt/models/vggt.py``, ``vggt/utils/{load_fn,pose_enc,geometry}.py``, README):

* images: (S, 3, H, W) RGB in 0..1, sides multiples of 14, 518 px wide; ImageNet normalisation happens inside;
* poses: camera-from-world, OpenCV axes, world = first camera; scale is the network's own, not metric;
* K: from two fields of view, principal point W / 2, H / 2, and depth is unprojected at whole-number pixel coordinates,
  as in its training data: with centres at +0.5 that is K + 0.5, and the points stay exactly the upstream ones;
* confidence: 1 + exp(x), at least 1, of depth and of points separately; no sky mask;
* weights: VGGT-1B is CC BY-NC 4.0; VGGT-1B-Commercial is gated and has its own licence, which excludes military use.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from jaxtyping import UInt8

from excavatwin.backbones import extras, weights
from excavatwin.backbones.cards import Card, Tried, Weights
from excavatwin.backbones.device import Device
from excavatwin.backbones.reconstructors.footprint import footprint
from excavatwin.backbones.reconstructors.loading import checkpoint, fill, ready, settings, tensors
from excavatwin.backbones.reconstructors.tensors import array, pictures
from excavatwin.backbones.reconstructors.unprojection import camera_to_world, centred, world_points
from excavatwin.backbones.sequence.feed_forward import FeedForward
from excavatwin.backbones.sequence.network import Network, Prediction

Head = Literal["depth", "points"]


@dataclass(frozen=True)
class Vggt(FeedForward):
    """VGGT; by default depth unprojected with its cameras, which its authors find more accurate than its points."""

    card: ClassVar[Card] = Card(
        name="vggt",
        kind="reconstructor",
        summary="VGGT, from Oxford and Meta: up to hundreds of photos in one pass",
        tried=Tried.STAND_IN,
        licence="LicenseRef-VGGT",
        modules=("torch", "vggt"),
        install='pip install "excavatwin[vggt]" && pip install --no-deps git+https://github.com/facebookresearch/vggt',
        weights=(
            Weights("facebook/VGGT-1B", 5.03e9, "CC-BY-NC-4.0", False, files=("*.safetensors", "*.json")),
            Weights(
                "facebook/VGGT-1B-Commercial",
                5.03e9,
                "VGGT License (no military use)",
                True,
                gated=True,
                files=("*.safetensors", "*.pt", "*.json"),
            ),
        ),
        argument="weights",
        source="https://github.com/facebookresearch/vggt",
    )
    confidence: ClassVar[str] = "1 + exp"

    head: Head = "depth"
    """Where points come from: ``depth`` and the cameras, or the network's own ``points``."""

    def open(self) -> Network:
        """Load it; the track head and the head that is not used are left out."""
        extras.need(self.card)
        file = checkpoint(weights.need(self.card, self.weights), self.card)
        from vggt.models.vggt import VGGT

        known = ("img_size", "patch_size", "embed_dim")
        model = VGGT(**{key: value for key, value in settings(file).items() if key in known})
        model.track_head = None
        if self.head == "depth":
            model.point_head = None
        else:
            model.depth_head = None
        fill(model, tensors(file, self.card), file, self.card)
        return _Network(ready(model, self.device), self.device, self.head)

    def memory(self, images: int, height: int, width: int) -> float:
        """From the README: on an H100, 336 x 518 px, the trunk takes 1.88 GB for 1 image and 40.63 GB for 200.

        That is 0.195 GB an image, 1120 bytes a pixel. Its DPT heads decode 8 images at once, 256 channels in float32
        at full resolution, about 13 such layers alive.
        """
        return footprint(5.03e9, images, height * width, each=1120, head=13 * 256)


@dataclass(frozen=True)
class _Network:
    model: Any
    device: Device
    head: Head

    def __call__(self, images: UInt8[np.ndarray, "S H W 3"]) -> Prediction:
        from vggt.utils.pose_enc import pose_encoding_to_extri_intri

        with self.device.inference() as device:
            out = self.model(pictures(images, device))
            extrinsics, intrinsics = pose_encoding_to_extri_intri(out["pose_enc"].float(), images.shape[1:3])
        T, K = camera_to_world(array(extrinsics[0])), centred(array(intrinsics[0]))
        if self.head == "points":
            return Prediction(array(out["world_points"][0]), array(out["world_points_conf"][0]), T, K)
        points = world_points(array(out["depth"][0, ..., 0]), K, T)
        return Prediction(points, array(out["depth_conf"][0]), T, K)
