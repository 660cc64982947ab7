"""How much memory a feed-forward network takes, from figures that its authors published.

Attention is assumed not to store its matrix (flash or memory-efficient kernels, which torch has on CUDA from Turing on,
on MPS and on CPUs): everything grows linearly with the number of images.
"""

from __future__ import annotations


def footprint(weights: float, images: int, pixels: int, each: float, head: float = 0.0, at_once: int = 8) -> float:
    """Estimated peak [bytes].

    Args:
        weights: of the model, in the precision in which it is kept (float32) [bytes].
        images: that the network sees at once.
        pixels: of one image.
        each: what stays for every pixel of every image while the trunk runs [bytes].
        head: what a dense head takes for every pixel of the images that it decodes at once [bytes].
        at_once: how many images these are at most.
    """
    return weights + images * pixels * each + min(images, at_once) * pixels * head
