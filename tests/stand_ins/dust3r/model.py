"""Documented outputs of DUSt3R for a pair: both images' points in the first camera, confidence 1 + exp."""

import numpy as np
import torch
from rendered_truth import Recalling, hallucinated, surety


class AsymmetricCroCo3DStereo(Recalling):
    """Knows its pictures."""

    metric = False

    def __init__(self, output_mode="pts3d", head_type="linear", **croco):
        super().__init__()

    def forward(self, view1, view2):
        """Two dictionaries with ``img`` (1, 3, H, W) in -1..1 and ``true_shape`` (1, 2)."""
        images = torch.cat([view1["img"], view2["img"]]) * 0.5 + 0.5
        for view in (view1, view2):
            assert view["true_shape"].tolist() == [list(view["img"].shape[2:])], view["true_shape"]
        i, j = self.recognise(images)
        scale = 1.0 if self.metric else 5.0 + i + 0.3 * j  # every pair has its own
        truth = self.answer(images, scale)
        points = [hallucinated(truth.points(s), 0.0)[None] for s in (0, 1)]
        conf = [1 + surety(truth.depth)[s].exp()[None] for s in (0, 1)]
        assert np.isfinite(scale)
        return {"pts3d": points[0], "conf": conf[0]}, {"pts3d_in_other_view": points[1], "conf": conf[1]}
