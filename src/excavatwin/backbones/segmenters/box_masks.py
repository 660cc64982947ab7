"""SAM or SAM 2: the mask of what is in a box."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from excavatwin.backbones import lattices
from excavatwin.backbones.device import Device
from excavatwin.backbones.lattices import Fit
from excavatwin.backbones.segmenters import hub_networks, sight
from excavatwin.backbones.segmenters.preparation import read_json
from excavatwin.errors import InputError

#: ``model_type`` of config.json -> class of transformers. SAM 2's folders on the hub are those of its video model.
KINDS = {"sam": "SamModel", "sam2": "Sam2Model", "sam2_video": "Sam2Model"}


@dataclass(frozen=True)
class BoxMasks:
    """Boxes to masks, by the network in a folder."""

    folder: Path
    """With weights and config.json."""
    stamp: str
    """Fingerprint of its content."""
    device: Device
    batch: int = 32
    """Boxes at a time."""

    def __call__(
        self, image: UInt8[np.ndarray, "H W 3"], boxes: Float[np.ndarray, "n 4"]
    ) -> Iterator[tuple[int, Bool[np.ndarray, "H W"], float]]:
        """Index, mask on the pixels of the image and predicted IoU (0..1) for every box x0, y0, x1, y1 [px].

        Raises:
            InputError: the folder holds another network, or damaged weights.
        """
        import torch

        if not len(boxes):
            return
        kind = self._kind()
        network = hub_networks.network(kind, self.folder, self.stamp, self.device.torch())
        fit = placed(kind, (image.shape[1], image.shape[0]), _side(network))
        with self.device.inference() as device:
            pixels = torch.from_numpy(shown(image, fit))[None].to(device)
            seen = network.get_image_embeddings(pixels)
            for start in range(0, len(boxes), self.batch):
                # SAM counts pixels from their centres (it adds 0.5 itself), we from their corners.
                some = sight.to_input(boxes[start : start + self.batch], fit) - 0.5
                given = torch.from_numpy(some.astype(np.float32))[None].to(device)
                answer = network(input_boxes=given, image_embeddings=seen, multimask_output=False)
                for index, (logits, iou) in enumerate(zip(answer.pred_masks[0], answer.iou_scores[0], strict=True)):
                    mask = sight.returned(logits[0].float().cpu().numpy(), fit) > 0
                    yield start + index, mask, float(iou[0].float().clamp(0, 1))

    def _kind(self) -> str:
        named = str((read_json(self.folder / "config.json") or {}).get("model_type", "nothing"))
        if named not in KINDS:
            raise InputError(f"{self.folder} is a network of type {named}; its masks need one of {', '.join(KINDS)}.")
        return KINDS[named]


def placed(kind: str, size: tuple[int, int], side: int) -> Fit:
    """How a picture comes onto the square: SAM 2 stretches it, SAM pads it at the right or at the bottom."""
    return sight.cornered(size, side) if kind == "SamModel" else lattices.fit(size, (side, side), "stretch")


def shown(image: UInt8[np.ndarray, "H W 3"], fit: Fit) -> Float32[np.ndarray, "3 h w"]:
    """What the network sees: RGB, normalised as ImageNet is; padding is zero after that, not before."""
    pixels = lattices.normalised(sight.shown(image, fit), *lattices.IMAGENET)
    return pixels * fit.inside()


def _side(network: Any) -> int:
    size = network.config.prompt_encoder_config.image_size
    return int(size if isinstance(size, int) else size[0])
