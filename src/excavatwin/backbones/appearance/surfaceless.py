"""Sky and water: regions of a photo where no solid surface can be reconstructed."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Bool

from excavatwin.backbones.appearance.cues import Cues


def find_sky(cues: Cues, smallest: float = 0.002) -> Bool[np.ndarray, "h w"]:
    """Smooth, bright or blue regions that reach the upper edge of the photo.

    Args:
        cues: of the photo.
        smallest: regions below this share of the image are no sky.
    """
    overexposed = (cues.luminance > np.where(cues.warmth < -0.012, 205, 246)) & (cues.warmth < 0.004)
    overcast = (cues.luminance > 150) & (cues.warmth < 0.004) & (cues.texture < 0.007)
    overexposed &= cues.texture < 0.02
    blue = (cues.luminance > 90) & (cues.warmth < -0.06) & (cues.texture < 0.02)
    candidate = (overexposed | overcast | blue).astype(np.uint8)
    opened = cv2.morphologyEx(candidate, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    _, label, stats, _ = cv2.connectedComponentsWithStats(opened)
    keep = np.zeros(len(stats), bool)
    keep[np.unique(label[:2])] = True
    keep &= stats[:, cv2.CC_STAT_AREA] > smallest * candidate.size
    keep[0] = False
    sky = keep[label]
    if not sky.any():
        return sky
    # The texture window blurs the skyline; behind leaves the sky comes through in spots.
    as_bright = (cues.luminance > np.percentile(cues.luminance[sky], 2) - 25) & (cues.warmth < 0.004)
    return _grown(sky, max(2, max(cues.shape) // 128)) | (_grown(sky, max(cues.shape) // 16) & as_bright)


def find_water(cues: Cues, smallest: float = 0.012) -> Bool[np.ndarray, "h w"]:
    """Large, dark, smooth regions, greenish or blue: neither as warm as soil nor as green as turf.

    Grey water under an overcast sky looks like wet asphalt; it is left to the matcher.
    """
    tint = (cues.green > 0.018) | (cues.warmth < -0.05)
    still = (cues.texture < 0.045) & (cues.luminance < 130) & (cues.relative < 0.1)
    candidate = (still & tint & (cues.green < 0.12) & (cues.warmth < 0.03) & (cues.chroma < 0.07)).astype(np.uint8)
    side = max(cues.shape)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * (side // 128) + 1,) * 2)
    closed = cv2.morphologyEx(candidate, cv2.MORPH_CLOSE, kernel)
    _, label, stats, _ = cv2.connectedComponentsWithStats(cv2.morphologyEx(closed, cv2.MORPH_OPEN, kernel))
    keep = stats[:, cv2.CC_STAT_AREA] > smallest * candidate.size
    keep[0] = False
    return keep[label]


def _grown(mask: Bool[np.ndarray, "h w"], pixels: int) -> Bool[np.ndarray, "h w"]:
    return cv2.dilate(mask.astype(np.uint8), np.ones((2 * pixels + 1,) * 2, np.uint8)) > 0
