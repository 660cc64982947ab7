"""Between our arrays and a network's tensors: pictures in, float32 out, and random numbers that repeat."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from jaxtyping import Float32, UInt8

from excavatwin.backbones.lattices import normalised

Triple = tuple[float, float, float]


def pictures(
    images: UInt8[np.ndarray, "S H W 3"],
    device: Any,
    mean: Triple = (0.0, 0.0, 0.0),
    std: Triple = (1.0, 1.0, 1.0),
) -> Any:
    """RGB images as a float32 tensor (S, 3, H, W) on the device: (value / 255 - mean) / std."""
    import torch

    return torch.from_numpy(np.stack([normalised(image, mean, std) for image in images])).to(device)


def array(tensor: Any) -> Float32[np.ndarray, "*shape"]:
    """A tensor of any precision and device as float32 in main memory."""
    return np.ascontiguousarray(tensor.detach().float().cpu().numpy())


@contextmanager
def repeatable(device: Any) -> Iterator[None]:
    """Inside, torch draws the same random numbers every time; outside, its state is what it was.

    For models that sample pixels or start an optimisation at random: same photos, same result.
    """
    import torch

    with torch.random.fork_rng(devices=[device] if device.type == "cuda" else []):
        torch.manual_seed(0)
        yield
