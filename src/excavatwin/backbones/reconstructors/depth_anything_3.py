"""Depth Anything 3 (Lin et al. 2025): depth and cameras of all images in one pass.

Facts, read in depth-anything-3 0.1.1 (``model/{da3,cam_dec,dualdpt}.py``, ``utils/{geometry,ray_utils,alignment}.py``):

* images: (1, S, 3, H, W) RGB with ImageNet mean and standard deviation, sides multiples of 14, longer side 504 px;
* poses: camera-from-world, OpenCV axes, in a world that is no particular camera's;
* K: principal point W / 2, H / 2. The rays that the network is trained on go through pixel centres at +0.5
  (``ray_utils``, ``gs_adapter``), so K is ours as it is; its exporters unproject at whole numbers, half a pixel off;
* confidence: 1 + exp(x), at least 1;
* sky: only NESTED has a sky head. It gives sky the depth of the farthest ground; here those pixels are NaN;
* scale: metres with NESTED, otherwise the network's own. METRIC-LARGE and MONO-LARGE see one image at a time and place
  no camera: they are refused;
* licences of weights: BASE, SMALL Apache-2.0; LARGE, GIANT, NESTED CC BY-NC 4.0.

Its ``api`` module imports exporters (moviepy, open3d, ...), so the network is built from its configuration instead.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from jaxtyping import UInt8

from excavatwin.backbones import extras, weights
from excavatwin.backbones.cards import Card, Tried, Weights
from excavatwin.backbones.device import Device
from excavatwin.backbones.lattices import IMAGENET
from excavatwin.backbones.reconstructors.footprint import footprint
from excavatwin.backbones.reconstructors.loading import checkpoint, fill, ready, settings, tensors
from excavatwin.backbones.reconstructors.tensors import array, pictures, repeatable
from excavatwin.backbones.reconstructors.unprojection import camera_to_world, world_points
from excavatwin.backbones.sequence.feed_forward import FeedForward
from excavatwin.backbones.sequence.network import Network, Prediction
from excavatwin.errors import InputError

_SKY = 0.3
"""From this value of the sky head on, a pixel is sky (``utils/alignment.py``)."""
_PRESETS = {
    "da3-small": (0.14e9, 384, 64),
    "da3-base": (0.54e9, 768, 128),
    "da3-large": (1.64e9, 1024, 256),
    "da3-giant": (5.28e9, 1536, 256),
    "da3nested-giant-large": (6.62e9, 1536, 256),
}
"""Weights in float32 [bytes], width of the trunk and channels of the heads; counted in the package's configurations."""


@dataclass(frozen=True)
class DepthAnything3(FeedForward):
    """Depth Anything 3."""

    card: ClassVar[Card] = Card(
        name="depth-anything-3",
        kind="reconstructor",
        summary="Depth Anything 3, from ByteDance: small to giant, with weights for commercial use",
        tried=Tried.REAL_CODE,
        modules=("torch", "depth_anything_3", "omegaconf", "addict", "einops", "safetensors"),
        install='pip install "excavatwin[depth-anything-3]" && pip install --no-deps depth-anything-3',
        weights=(
            Weights("depth-anything/DA3-BASE", 0.54e9, "Apache-2.0", True),
            Weights("depth-anything/DA3-SMALL", 0.14e9, "Apache-2.0", True),
            Weights("depth-anything/DA3-LARGE-1.1", 1.64e9, "CC-BY-NC-4.0", False),
            Weights("depth-anything/DA3-GIANT-1.1", 5.4e9, "CC-BY-NC-4.0", False),
            Weights("depth-anything/DA3NESTED-GIANT-LARGE-1.1", 6.8e9, "CC-BY-NC-4.0", False, metric=True),
        ),
        argument="weights",
        source="https://github.com/ByteDance-Seed/Depth-Anything-3",
    )
    confidence: ClassVar[str] = "1 + exp"

    lattice: int = 504
    """Longer side of the lattice [px]."""
    rays: bool = False
    """Whether cameras come from the ray head instead of the camera head: slower, and more accurate by its authors."""

    def open(self) -> Network:
        """Load it.

        Raises:
            InputError: the weights are of a monocular model, or their configuration is missing.
        """
        extras.need(self.card)
        file = checkpoint(weights.need(self.card, self.weights), self.card)
        preset = settings(file).get("model_name")
        if preset not in _PRESETS:
            alone = any(kind in str(preset) for kind in ("metric", "mono"))
            raise InputError(
                f"weights of depth-anything-3: {file.parent} holds model {preset!r}"
                f"{', which sees one image at a time and places no camera' if alone else ''}; expected a config.json "
                f"with a model_name among {', '.join(_PRESETS)}, as in depth-anything/DA3-BASE."
            )
        model = _built(preset)
        prefix = "model."  # its api class keeps the network under this name
        state = {key.removeprefix(prefix): value for key, value in tensors(file, self.card).items()}
        fill(model, state, file, self.card)
        return Loaded(ready(model, self.device), self.device, self.rays)

    def memory(self, images: int, height: int, width: int) -> float:
        """From the README of ``da3_streaming`` (NESTED, bfloat16): 504 x 378 px, 30 images 18.7 GB, 120 images 28.3 GB;
        504 x 154 px, 11.5 and 15.9 GB: 0.4 bytes a pixel for each of the trunk's 1536 channels. What is left above the
        weights are its two dense heads, which decode 8 images at once: 27 bytes a pixel for each of 256 channels.
        """
        size, trunk, channels = _PRESETS[self._preset()]
        return footprint(size, images, height * width, each=0.4 * trunk, head=27 * channels)

    def _preset(self) -> str:
        """The configuration that the weights are for; the default's when they are not here and unknown."""
        found = weights.find(self.card, self.weights)
        named = settings(found).get("model_name") if found is not None else None
        if named is None:
            named = weights.chosen(self.card, self.weights).repo.rpartition("/")[2].lower().removesuffix("-1.1")
        return named if named in _PRESETS else "da3-base"


def _built(preset: str) -> Any:
    """The network of a preset, with random weights and without its head for Gaussians, which is not used."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of deprecated calls inside the package, at import: nothing to be done here
        from depth_anything_3.cfg import create_object, load_config
        from depth_anything_3.registry import MODEL_REGISTRY
        from depth_anything_3.utils.logger import LOG_LEVELS, logger

        logger.level = LOG_LEVELS["WARN"]  # it prints to standard output otherwise
        config = load_config(MODEL_REGISTRY[preset])
        for part in (config, config.get("anyview") or {}):
            part.pop("gs_head", None)
            part.pop("gs_adapter", None)
        return create_object(config)


@dataclass(frozen=True)
class Loaded:
    """The network on its device."""

    model: Any
    device: Device
    rays: bool = False

    def __call__(self, images: UInt8[np.ndarray, "S H W 3"]) -> Prediction:
        """Depth and cameras of these images."""
        sky: list[Any] = []
        nested = "da3_metric" in dict(self.model.named_children())
        # The nested network answers with the sky's depth made up and without its mask, which one of its halves knows.
        hook = (
            self.model.da3_metric.register_forward_hook(lambda module, given, out: sky.append(out["sky"]))
            if nested
            else None
        )
        try:
            # It samples pixels for quantiles, and with the ray head for RANSAC.
            with self.device.inference() as device, repeatable(device):
                out = self.model(pictures(images, device, *IMAGENET)[None], use_ray_pose=self.rays)
        finally:
            if hook is not None:
                hook.remove()
        T, K = camera_to_world(array(out["extrinsics"][0])), array(out["intrinsics"][0]).astype(np.float64)
        depth, confidence = array(out["depth"][0]), array(out["depth_conf"][0])
        if sky:
            hidden = array(sky[0][0]) >= _SKY
            depth, confidence = np.where(hidden, np.float32(np.nan), depth), np.where(hidden, np.float32(0), confidence)
        return Prediction(world_points(depth, K, T), confidence, T, K, metric=nested)
