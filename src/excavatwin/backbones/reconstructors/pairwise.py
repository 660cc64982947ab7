"""DUSt3R and MASt3R see two images at a time: which pairs they are shown, and how the pairs become one scene.

Facts, read in naver/dust3r (``inference.py``, ``cloud_opt/{base_opt,optimizer,init_im_poses}.py``,
``utils/image.py``) and naver/mast3r (``model.py``, ``demo_dust3r_ga.py``):

* images: ``img`` (1, 3, H, W) RGB in -1..1 with ``true_shape`` (1, 2), sides multiples of 16, longer side 512 px;
* a pair's points are all in the first image's camera; every pair has a scale of its own unless weights are metric;
* the pairs are put together by upstream's own global alignment (one depth map, pose and focal length an image);
* it delivers camera-to-world poses, OpenCV axes, one focal length, principal point W / 2, H / 2 at whole-number pixel
  coordinates: K + 0.5 for centres at +0.5, points unchanged;
* it holds the mean scale of the pairs at 0.5, so metres are lost there; dividing by that scale brings them back;
* confidence: 1 + exp(x), the greatest among an image's pairs.

Poses, K and scale were checked once against upstream's aligner itself (mini-dust3r 0.1.2) on exact pairs.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float32, UInt8

from excavatwin.backbones import extras, weights
from excavatwin.backbones.reconstructors.footprint import footprint
from excavatwin.backbones.reconstructors.loading import build, checkpoint, fill, ready, settings, tensors
from excavatwin.backbones.reconstructors.tensors import array, pictures, repeatable
from excavatwin.backbones.reconstructors.unprojection import centred, rigid
from excavatwin.backbones.sequence.feed_forward import FeedForward
from excavatwin.backbones.sequence.network import Network, Prediction
from excavatwin.errors import InputError, ReconstructionError, require


def graph(images: int, exhaustive: int, window: int) -> list[tuple[int, int]]:
    """Which images are looked at together, each pair in both directions: all, or only such that follow each other."""
    reach = images if images <= exhaustive else window
    forward = [(i, j) for i in range(images) for j in range(i + 1, min(images, i + reach + 1))]
    return forward + [(j, i) for i, j in forward]


@dataclass(frozen=True)
class Pairwise(FeedForward):
    """What both have in common."""

    confidence: ClassVar[str] = "1 + exp"
    patch: ClassVar[int] = 16

    lattice: int = 512
    """Longer side of the lattice [px]."""
    exhaustive: int = 12
    """Up to so many images every pair is looked at; above, only pairs of images that follow each other closely."""
    window: int = 4
    """How many following images each image is paired with when there are more."""
    iterations: int = 300
    """Steps of the global alignment."""

    def __post_init__(self) -> None:
        require(self, "exhaustive", 1)
        require(self, "window", 1)
        require(self, "iterations", 1)

    def open(self) -> Network:
        """Load it.

        Raises:
            InputError: another precision than float32 was asked for, which upstream's inference does not know; or the
                weights are not as the hub keeps them (upstream's ``.pth`` hold Python text to be executed).
        """
        if self.device.precision not in ("auto", "float32"):
            raise InputError(
                f"device.precision is {self.device.precision}, but {self.card.name} computes in float32; leave it auto."
            )
        extras.need(self.card)
        file = checkpoint(weights.need(self.card, self.weights), self.card)
        chosen = settings(file)
        if not chosen:
            raise InputError(
                f"weights of {self.card.name}: there is no config.json beside {file}; give the folder as the hub keeps "
                f"it ({self.card.weights[0].repo})."
            )
        model = build(self.network(), chosen, self.card)
        fill(model, tensors(file, self.card), file, self.card)
        return _Network(ready(model, self.device), self)

    @abstractmethod
    def network(self) -> Callable[..., Any]:
        """Upstream's class."""

    def memory(self, images: int, height: int, width: int) -> float:
        """No figure is published. Counted: one pair at a time through the network (as VGGT's head); then for every pair
        and pixel the alignment keeps 16 float32 numbers (points and confidence of both images, twice) and makes 30.
        """
        pairs = len(graph(max(images, 2), self.exhaustive, self.window))
        alignment = pairs * height * width * 46 * 4
        size = self.card.weights[0].size
        return footprint(size, 2, height * width, each=0, head=13 * 256, at_once=2) + alignment


@dataclass(frozen=True)
class _Network:
    model: Any
    stage: Pairwise

    def __call__(self, images: UInt8[np.ndarray, "S H W 3"]) -> Prediction:
        from dust3r.inference import inference

        device, S, metric = self.stage.device.torch(), len(images), self.stage.card.metric
        views = _views(images if S > 1 else np.concatenate([images, images]))  # upstream pairs one image with itself
        pairs = [(views[i], views[j]) for i, j in graph(len(views), self.stage.exhaustive, self.stage.window)]
        # Not under Device.inference(): the alignment differentiates through what comes out.
        with repeatable(device):
            seen = inference(pairs, self.model, device, batch_size=1, verbose=False)
            scene = self._aligned(seen, device)
        scale = math.exp(-float(np.log(array(scene.get_pw_scale())).mean())) if metric else 1.0
        T = rigid(array(scene.get_im_poses()))
        T[:, :3, 3] *= scale
        points = np.stack([array(points) for points in scene.get_pts3d()]) * np.float32(scale)
        confidence: Float32[np.ndarray, "S H W"] = np.stack([array(conf) for conf in scene.get_conf(mode="none")])
        K = centred(array(scene.get_intrinsics()))
        return Prediction(points[:S], confidence[:S], T[:S], K[:S], metric)

    def _aligned(self, seen: Any, device: Any) -> Any:
        """The scene from what the network said about every pair.

        Raises:
            ReconstructionError: the alignment diverged.
        """
        from dust3r.cloud_opt import GlobalAlignerMode, global_aligner

        scene = global_aligner(seen, device=device, mode=GlobalAlignerMode.PointCloudOptimizer, verbose=False)
        loss = scene.compute_global_alignment(
            init="mst", niter=self.stage.iterations, schedule="cosine", lr=0.01
        )  # as in upstream's README
        if not math.isfinite(float(loss)):
            raise ReconstructionError(
                f"{self.stage.card.name} could not put its pairs together (loss {float(loss)}); the photos overlap too "
                "little: take more, or use another reconstructor."
            )
        return scene


def _views(images: UInt8[np.ndarray, "S H W 3"]) -> list[dict[str, Any]]:
    """Images as upstream's loader delivers them: RGB in -1..1."""
    import torch

    half = (0.5, 0.5, 0.5)
    return [
        {
            "img": picture[None],
            "true_shape": np.array([images.shape[1:3]], np.int32),
            "idx": index,
            "instance": str(index),
        }
        for index, picture in enumerate(pictures(images, torch.device("cpu"), half, half))
    ]
