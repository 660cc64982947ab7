"""Documented outputs of VGGT: first-camera frame, camera-from-world, arbitrary scale, confidence 1 + exp."""

import numpy as np
import torch
from rendered_truth import Recalling, hallucinated, surety
from scipy.spatial.transform import Rotation

SCALE = 17.3
"""Metres in one unit of the network."""


class VGGT(Recalling):
    """Knows its pictures."""

    def __init__(self, img_size=518, patch_size=14, embed_dim=1024):
        super().__init__()
        self.patch_size = patch_size
        self.camera_head = torch.nn.Identity()
        self.depth_head = torch.nn.Identity()
        self.point_head = torch.nn.Identity()
        self.track_head = torch.nn.Identity()

    def forward(self, images, query_points=None):
        """Images (S, 3, H, W) or (B, S, 3, H, W)."""
        images = images if images.dim() == 5 else images[None]
        H, W = images.shape[-2:]
        assert H % self.patch_size == 0, H
        assert W % self.patch_size == 0, W
        truth = self.answer(images[0], SCALE)
        from_world = np.linalg.inv(truth.T)
        quaternion = Rotation.from_matrix(from_world[:, :3, :3]).as_quat()  # x, y, z, w
        fov_h, fov_w = 2 * np.arctan(H / 2 / truth.K[:, 1, 1]), 2 * np.arctan(W / 2 / truth.K[:, 0, 0])
        encoding = np.concatenate([from_world[:, :3, 3], quaternion, fov_h[:, None], fov_w[:, None]], axis=1)
        out = {"pose_enc": torch.from_numpy(encoding.astype(np.float32))[None], "images": images}
        if self.depth_head is not None:
            out["depth"] = hallucinated(truth.depth, 3.0)[None, ..., None]
            out["depth_conf"] = 1 + surety(truth.depth).exp()[None]
        if self.point_head is not None:
            points = np.stack([truth.points(s) for s in range(len(truth.T))])
            out["world_points"] = hallucinated(points, 3.0)[None]
            out["world_points_conf"] = 1 + surety(truth.depth).exp()[None]
        assert self.track_head is None, "an unused head is kept in memory"
        return out
