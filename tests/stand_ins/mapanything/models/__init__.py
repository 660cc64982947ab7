"""Documented outputs of MapAnything: first-camera frame, metres, camera-to-world, K at whole numbers, masked zeros."""

from types import SimpleNamespace

import numpy as np
import torch
from rendered_truth import Recalling, surety

MEAN, STD = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])


class MapAnything(Recalling):
    """Knows its pictures."""

    def __init__(self, name, encoder_config, norm="dinov2"):
        super().__init__()
        assert not encoder_config.get("torch_hub_pretrained", True), "torch.hub would download weights"
        self.encoder = SimpleNamespace(data_norm_type=norm)

    @torch.inference_mode()
    def infer(
        self, views, memory_efficient_inference=True, use_amp=True, amp_dtype="bf16", apply_mask=True, mask_edges=True
    ):
        """One dictionary a view, each with a batch of one."""
        assert all(set(view) == {"img", "data_norm_type"} for view in views)
        assert not use_amp or amp_dtype in ("bf16", "fp16"), amp_dtype
        images = torch.cat([view["img"] for view in views]) * STD[:, None, None] + MEAN[:, None, None]
        truth = self.answer(images)
        out = []
        for s in range(len(views)):
            assert views[s]["data_norm_type"] == ["dinov2"]
            mask = torch.from_numpy(np.isfinite(truth.depth[s]))
            mask[:3] = False  # an edge that is masked
            K = truth.K[s].copy()
            K[:2, 2] -= 0.5
            points = torch.from_numpy(np.nan_to_num(truth.points(s)).astype(np.float32)) * mask[..., None]
            out.append(
                {
                    "pts3d": points[None],
                    "mask": mask[None, ..., None],
                    "conf": 1 + surety(truth.depth)[s].exp()[None],
                    "camera_poses": torch.from_numpy(truth.T[s].astype(np.float32))[None],
                    "intrinsics": torch.from_numpy(K.astype(np.float32))[None],
                    "metric_scaling_factor": torch.ones(1, 1),
                }
            )
        return out
