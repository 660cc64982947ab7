"""The global aligner, in closed form because the stand-in's pairs are exact; its scale as upstream holds it."""

from enum import Enum

import numpy as np
import torch

from excavatwin.scene.frames import umeyama


class GlobalAlignerMode(Enum):
    """Which optimiser."""

    PointCloudOptimizer = "PointCloudOptimizer"
    PairViewer = "PairViewer"


def global_aligner(dust3r_output, device, mode=GlobalAlignerMode.PointCloudOptimizer, **optim_kw):
    """The scene of all pairs."""
    assert mode is GlobalAlignerMode.PointCloudOptimizer
    assert optim_kw == {"verbose": False}
    return Scene(dust3r_output)


class Scene:
    """World = camera 0; the mean scale of the pairs is 0.5."""

    def __init__(self, seen):
        self.edges = list(zip(seen["view1"]["idx"], seen["view2"]["idx"], strict=True))
        self.first, self.second = seen["pred1"]["pts3d"].numpy(), seen["pred2"]["pts3d_in_other_view"].numpy()
        self.conf = {}
        for e, edge in enumerate(self.edges):
            for image, conf in zip(edge, (seen["pred1"]["conf"][e], seen["pred2"]["conf"][e]), strict=True):
                self.conf[image] = torch.maximum(self.conf.get(image, conf), conf)
        self.aligned = False

    def compute_global_alignment(self, init=None, niter=300, schedule="cosine", lr=0.01):
        """Chain exact pairs from image 0."""
        assert torch.is_grad_enabled(), "the optimiser needs gradients"
        assert not torch.is_inference_mode_enabled()
        assert init == "mst"
        own = {i: self.first[e] for e, (i, _) in enumerate(self.edges)}
        world = {0: (1.0, np.eye(3), np.zeros(3))}  # from each image's own points to the world
        while len(world) < len(own):
            for e, (i, j) in enumerate(self.edges):
                if i in world and j not in world:
                    s, R, t = _fit(self.first[e], own[i])
                    S, Q, q = _fit(own[j], s * self.second[e] @ R.T + t)
                    a, A, b = world[i]
                    world[j] = (a * S, A @ Q, a * A @ q + b)
        scales = np.array([world[i][0] * _fit(self.first[e], own[i])[0] for e, (i, _) in enumerate(self.edges)])
        held = 0.5 / np.exp(np.log(scales).mean())
        self.scales, self.poses, self.points = scales * held, [], []
        for i in sorted(world):
            a, A, b = world[i]
            self.points.append((held * (a * own[i] @ A.T + b)).astype(np.float32))
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = A, held * b
            self.poses.append(T)
        self.focals = [_focal(own[i]) for i in sorted(world)]
        self.aligned = True
        return 0.0

    def get_pw_scale(self):
        """Of every pair."""
        return torch.tensor(self.scales, dtype=torch.float32, requires_grad=True)

    def get_im_poses(self):
        """Camera-to-world."""
        return torch.tensor(np.stack(self.poses), dtype=torch.float32, requires_grad=True)

    def get_pts3d(self):
        """One (H, W, 3) an image."""
        return [torch.tensor(points, requires_grad=True) for points in self.points]

    def get_conf(self, mode=None):
        """One (H, W) an image, transformed."""
        assert mode == "none", "the default is the logarithm"
        return [self.conf[i] for i in sorted(self.conf)]

    def get_intrinsics(self):
        """Principal point W / 2, H / 2."""
        H, W = self.points[0].shape[:2]
        K = torch.zeros(len(self.focals), 3, 3)
        K[:, 0, 0] = K[:, 1, 1] = torch.tensor(self.focals)
        K[:, 0, 2], K[:, 1, 2], K[:, 2, 2] = W / 2, H / 2, 1
        return K.requires_grad_()


def _fit(source, target):
    use = (np.abs(source).max(-1) > 1e-6) & (np.abs(target).max(-1) > 1e-6)
    source, target = source[use][::7].astype(float), target[use][::7].astype(float)
    return umeyama(source, target, np.ones(len(source)))


def _focal(points):
    """With pixels counted at whole numbers."""
    H, W = points.shape[:2]
    u = np.arange(W) + np.zeros((H, 1))
    far = (np.abs(points[..., 0]) > 1e-2) & (points[..., 2] > 1e-2) & (np.abs(u - W / 2) > W / 4)
    return float(np.median((u - W / 2)[far] * points[..., 2][far] / points[..., 0][far]))
