"""Documented outputs of Pi3: camera-to-world in a world of no particular camera, points in each camera, logits."""

import numpy as np
import torch
from rendered_truth import Recalling, Truth, surety
from scipy.spatial.transform import Rotation

SCALE = 9.1
"""Metres in one unit of the network."""
FRAME = np.eye(4)
FRAME[:3, :3] = Rotation.from_rotvec([0.3, -1.1, 0.4]).as_matrix()
FRAME[:3, 3] = (4.0, -7.0, 2.0)


def documented(truth):
    """The dictionary that both models return; where there is no surface, a point on the pixel's ray."""
    depth = np.where(np.isfinite(truth.depth), truth.depth, 3.0)
    views = Truth(truth.pictures, depth, truth.T, truth.K)
    stacked = {
        "points": [views.points(s) for s in range(len(views.T))],
        "local_points": [views.points_in_camera(s) for s in range(len(views.T))],
        "camera_poses": list(views.T),
    }
    tensors = {name: torch.from_numpy(np.stack(values).astype(np.float32))[None] for name, values in stacked.items()}
    return tensors | {"conf": surety(truth.depth)[None, ..., None]}


class Pi3(Recalling):
    """Knows its pictures."""

    def __init__(self, pos_type="rope100", decoder_size="large"):
        super().__init__()

    def forward(self, imgs):
        """Images (B, N, 3, H, W) in 0..1."""
        assert imgs.dim() == 5, imgs.shape
        return documented(self.answer(imgs[0], SCALE, FRAME))
