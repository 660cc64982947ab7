"""What the stand-ins of networks know: rendered pictures and their truth, which they are given as their weights.

A stand-in recognises the pictures that it is shown (so it notices swapped channels, a wrong range or swapped sides) and
answers with their truth in its model's own conventions, as read in the model's repository.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch


@dataclass(frozen=True)
class Truth:
    """Views with exact truth."""

    pictures: np.ndarray
    """uint8 RGB on the lattice (S, H, W, 3)."""
    depth: np.ndarray
    """Along the optical axis; NaN where the picture shows no surface: sky or padding (S, H, W) [m]."""
    T: np.ndarray
    """Camera-to-world (S, 4, 4) [m]."""
    K: np.ndarray
    """Pixel centres at +0.5 (S, 3, 3) [px]."""

    def points_in_camera(self, s):
        """Points in the view's own camera (H, W, 3) [m]."""
        H, W = self.depth.shape[1:]
        v, u = np.mgrid[:H, :W] + 0.5
        K = self.K[s]
        ray = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones_like(u)], axis=-1)
        return ray * self.depth[s][..., None]

    def points(self, s):
        """World points (H, W, 3) [m]."""
        return self.points_in_camera(s) @ self.T[s, :3, :3].T + self.T[s, :3, 3]

    def state(self):
        """As tensors of a checkpoint."""
        return {name: torch.from_numpy(np.ascontiguousarray(getattr(self, name))) for name in self.__annotations__}

    def seen_from(self, frame, scale):
        """The same views in the frame of a camera-to-world pose, in units of ``scale`` metres."""
        T = np.linalg.inv(frame) @ self.T
        T[:, :3, 3] /= scale
        return Truth(self.pictures, self.depth / scale, T, self.K)


class Recalling(torch.nn.Module):
    """A network that has seen the pictures before: its weights are the truth."""

    truth: Truth

    def load_state_dict(self, state, strict=True):
        """Take the truth from the checkpoint."""
        self.truth = Truth(**{name: state[name].numpy() for name in Truth.__annotations__})
        return torch.nn.modules.module._IncompatibleKeys([], [])

    def recognise(self, images) -> list[int]:
        """Which known pictures these are: RGB in 0..1, (S, 3, H, W).

        Raises:
            AssertionError: they are none of them.
        """
        assert images.dtype == torch.float32, images.dtype
        assert images.shape[2:] == self.truth.pictures.shape[1:3], images.shape
        assert images.min() >= -1e-4, float(images.min())
        assert 0.5 < images.max() <= 1 + 1e-4, float(images.max())
        found = []
        for image in (images.permute(0, 2, 3, 1) * 255).numpy():
            off = [np.abs(image - known).max() for known in self.truth.pictures.astype(np.float32)]
            assert min(off) < 0.1, "none of the rendered pictures: channels, range or preprocessing differ"
            found.append(int(np.argmin(off)))
        return found

    def answer(self, images, scale=1.0, frame=None) -> Truth:
        """Truth of these pictures in the frame of the first one's camera (or of a pose), in units of ``scale``."""
        s = self.recognise(images)
        views = Truth(self.truth.pictures[s], self.truth.depth[s], self.truth.T[s], self.truth.K[s])
        return views.seen_from(views.T[0] if frame is None else frame, scale)


def hallucinated(array, value):
    """What a network says where there is nothing to be seen: something plausible."""
    return torch.from_numpy(np.where(np.isfinite(array), array, value).astype(np.float32))


def surety(depth):
    """A logit for every pixel: lower where there is nothing to be seen."""
    H, W = depth.shape[1:]
    v, u = np.mgrid[:H, :W]
    return torch.from_numpy(np.where(np.isfinite(depth), np.sin(u / 9) + np.cos(v / 7), -4.0).astype(np.float32))
