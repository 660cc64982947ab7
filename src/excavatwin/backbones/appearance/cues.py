"""Cues: per-pixel quantities that colour and texture give, made robust against exposure, vignetting and tint."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Shaped, UInt8

#: Added to sums of channels: keeps ratios quiet where there is hardly any light [grey levels].
DARK = 6.0


@dataclass(frozen=True)
class Cues:
    """What is seen at every pixel of the working image."""

    luminance: Float32[np.ndarray, "h w"]
    """Mean of the channels, smoothed, 0..255."""
    relative: Float32[np.ndarray, "h w"]
    """Log luminance minus that of the surroundings (a tenth of the image): the illumination is taken out."""
    green: Float32[np.ndarray, "h w"]
    """Green leaf index (Louhaichi et al., Geocarto Int. 2001), less the tint of the neutral ground."""
    warmth: Float32[np.ndarray, "h w"]
    """(R-B)/(R+G+B)."""
    odd_warmth: Float32[np.ndarray, "h w"]
    """Warmth less its median over a quarter of the image."""
    chroma: Float32[np.ndarray, "h w"]
    """(max-min)/(R+G+B)."""
    plant_hue: Float32[np.ndarray, "h w"]
    """1 for the hues of leaves, 0 for those of soil and yellow paint."""
    texture: Float32[np.ndarray, "h w"]
    """Standard deviation of log luminance in a small window, without the ridges that lone edges leave."""
    vivid: Float32[np.ndarray, "h w"]
    """Saturated colours that neither soil nor plants have."""
    paint: Float32[np.ndarray, "h w"]
    """Yellow or orange machine paint."""
    near_paint: Float32[np.ndarray, "h w"]
    """Beside paint: much for grey, dark or busy parts such as tracks and cab, some for whatever else is there."""

    @property
    def shape(self) -> tuple[int, int]:
        """(h, w) of the working image."""
        return self.luminance.shape[0], self.luminance.shape[1]


def observe(image: UInt8[np.ndarray, "h w 3"]) -> Cues:
    """All cues of an sRGB image at working size."""
    side = max(image.shape[:2])
    rgb = cv2.GaussianBlur(image.astype(np.float32), (0, 0), max(0.4, side / 640))
    red, green, blue = cv2.split(rgb)
    total = red + green + blue + DARK
    luminance = total / 3
    brightest = np.maximum(np.maximum(red, green), blue)
    chroma = (brightest - np.minimum(np.minimum(red, green), blue)) / total
    warmth = (red - blue) / total
    hue, saturation = _hue_saturation(rgb)
    log = np.log(luminance)
    texture = _spread(
        np.log(cv2.transform(image, np.full((1, 3), 1 / 3, np.float32)).astype(np.float32) + DARK / 2), odd(side / 71)
    )
    relative = log - _wide(log, side / 10)
    vivid, crimson = _vividness(hue, saturation, brightest)
    odd_warmth = warmth - _background(warmth)
    paint, near = _machine(warmth, odd_warmth, hue, saturation, brightest, texture, relative, crimson)
    return Cues(
        luminance=luminance,
        relative=relative,
        green=_greenness(green, total),
        warmth=warmth,
        odd_warmth=odd_warmth,
        chroma=chroma,
        plant_hue=ramp(hue, 44.0, 56.0) * ramp(-hue, -190.0, -165.0),
        texture=_without_ridges(texture, odd(side / 64)),
        vivid=vivid,
        paint=paint,
        near_paint=near,
    )


def islands(
    candidate: Bool[np.ndarray, "h w"], largest: float, fill: float, smallest: float = 1e-4
) -> Bool[np.ndarray, "h w"]:
    """Compact patches of a candidate mask.

    Args:
        candidate: what a patch may consist of.
        largest: of the image's area.
        fill: share of its upright bounding box that a patch must cover; a road that winds through the photo does not.
        smallest: of the image's area; bridges and specks of half that width are taken away first.
    """
    width = odd(np.sqrt(smallest * candidate.size) / 2)
    solid = cv2.morphologyEx(candidate.astype(np.uint8), cv2.MORPH_OPEN, np.ones((width, width), np.uint8))
    _, label, stats, _ = cv2.connectedComponentsWithStats(solid, connectivity=4)
    area = stats[:, cv2.CC_STAT_AREA]
    box = stats[:, cv2.CC_STAT_WIDTH] * stats[:, cv2.CC_STAT_HEIGHT]
    compact = (area > smallest * solid.size) & (area < largest * solid.size) & (area > fill * box)
    compact[0] = False
    return compact[label]


def ramp(x: Float32[np.ndarray, "..."], low: float, high: float) -> Float32[np.ndarray, "..."]:
    """0 below ``low``, 1 above ``high``, smooth between (cubic)."""
    t = np.clip((x - low) / (high - low), 0, 1)
    return (t * t * (3 - 2 * t)).astype(np.float32)


def surroundings(x: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """Mean over about a twentieth of the image's long side."""
    return _wide(x, max(x.shape) / 50)


def resized(
    image: Shaped[np.ndarray, "h w *c"], width: int, height: int, exact: bool = False
) -> Shaped[np.ndarray, "H W *c"]:
    """``image`` at another size; ``exact`` invents no values between those that are there."""
    if image.shape[:2] == (height, width):
        return image
    grows = width > image.shape[1]
    mode = cv2.INTER_NEAREST if exact else cv2.INTER_LINEAR if grows else cv2.INTER_AREA
    return np.asarray(cv2.resize(image, (width, height), interpolation=mode))


def odd(size: float) -> int:
    """The nearest odd window size, at least 3 [px]."""
    return max(3, 2 * round((size - 1) / 2) + 1)


def _greenness(channel: Float32[np.ndarray, "h w"], total: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """Green leaf index, zero on neutral ground. Cameras differ in tint by as much as dry grass differs from soil."""
    index = (3 * channel - total + DARK) / (total + channel)
    ground = index[::4, ::4]
    ground = ground[np.abs(ground) < 0.07]
    if ground.size < 0.03 * index.size / 16:  # nothing but plants: no ground to read the tint from
        return index
    return index - np.float32(np.clip(np.percentile(ground, 25), -0.05, 0.01))


def _hue_saturation(rgb: Float32[np.ndarray, "h w 3"]) -> tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    """Hue [deg] and saturation 0..1."""
    hsv = cv2.cvtColor(rgb / 255, cv2.COLOR_RGB2HSV)
    return hsv[..., 0], hsv[..., 1]


def _spread(x: Float32[np.ndarray, "h w"], window: int) -> Float32[np.ndarray, "h w"]:
    """Standard deviation in a square window."""
    mean = cv2.blur(x, (window, window))
    return np.sqrt(np.maximum(cv2.blur(x * x, (window, window)) - mean * mean, 0))


def _vividness(
    hue: Float32[np.ndarray, "h w"], saturation: Float32[np.ndarray, "h w"], brightest: Float32[np.ndarray, "h w"]
) -> tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    """Colours that neither soil nor plants nor haze have, and the red among them."""
    red = np.maximum(ramp(-hue, -14.0, -6.0), ramp(hue, 340.0, 350.0)) * ramp(saturation, 0.2, 0.36)
    pink = ramp(hue, 295.0, 315.0) * ramp(saturation, 0.16, 0.3)
    blue = ramp(hue, 165.0, 180.0) * ramp(-hue, -310.0, -290.0) * ramp(saturation, 0.35, 0.55)
    plastic = ramp(hue, 98.0, 110.0) * ramp(-hue, -185.0, -165.0) * ramp(saturation, 0.42, 0.55)
    seen = ramp(brightest, 25.0, 55.0)
    red = np.maximum(red, pink) * seen
    return np.maximum.reduce([red, blue * seen, plastic * ramp(brightest, 110.0, 160.0)]), red


def _machine(
    warmth: Float32[np.ndarray, "h w"],
    odd_warmth: Float32[np.ndarray, "h w"],
    hue: Float32[np.ndarray, "h w"],
    saturation: Float32[np.ndarray, "h w"],
    brightest: Float32[np.ndarray, "h w"],
    texture: Float32[np.ndarray, "h w"],
    relative: Float32[np.ndarray, "h w"],
    red: Float32[np.ndarray, "h w"],
) -> tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    """Paint, and what belongs to a machine beside it.

    Faded paint in a dull photo is no yellower than ochre soil; but soil changes its colour slowly, while paint stands
    beside glass, steel and tracks. So a moderate yellow counts only where the warmth varies strongly around it. The
    blurred rim of a red thing on sand is orange, too, and does not count.
    """
    side = max(warmth.shape)
    seen = ramp(brightest, 30.0, 60.0) * ramp(relative, -0.8, -0.3)
    contrast = ramp(_spread(warmth, odd(side / 26)), 0.026, 0.042)
    yellow = ramp(hue, 28.0, 36.0) * ramp(-hue, -57.0, -50.0)
    orange = ramp(hue, 10.0, 16.0) * ramp(-hue, -64.0, -58.0)
    faded = yellow * ramp(warmth, 0.08, 0.13) * ramp(odd_warmth, 0.03, 0.06) * contrast
    fresh = orange * ramp(warmth, 0.24, 0.33) * ramp(saturation, 0.5, 0.7) * ramp(relative, -0.3, 0.1)
    rim = cv2.dilate(red, np.ones((odd(side / 42),) * 2, np.uint8))
    paint = _compact(np.maximum(faded, fresh) * seen * (1 - rim))
    vicinity = np.clip(4.0 * _wide(paint, side / 48), 0, 1)
    part = np.maximum(0.8 * ramp(np.abs(relative), 0.4, 0.9), ramp(np.abs(odd_warmth), 0.012, 0.03))
    return paint, vicinity * (0.4 + 0.5 * np.maximum(part, 0.8 * ramp(texture, 0.15, 0.28)))


def _wide(x: Float32[np.ndarray, "h w"], sigma: float) -> Float32[np.ndarray, "h w"]:
    """Gaussian mean of large reach, on a coarser image."""
    step = max(1.0, sigma / 4)
    small = _shrunk(x, step)
    small = cv2.GaussianBlur(small, (0, 0), sigma / step)
    return np.asarray(cv2.resize(small, x.shape[::-1], interpolation=cv2.INTER_LINEAR))


def _shrunk(x: Float32[np.ndarray, "h w"], step: float) -> Float32[np.ndarray, "h2 w2"]:
    return resized(x, max(1, round(x.shape[1] / step)), max(1, round(x.shape[0] / step)))


def _background(x: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """Median over about a quarter of the image's long side, of a quantity between -0.5 and 0.5."""
    small = _shrunk(x, 8)
    levels = np.clip(np.round((small + 0.5) * 255), 0, 255).astype(np.uint8)
    median = cv2.medianBlur(levels, odd(max(small.shape) / 4)).astype(np.float32) / 255 - 0.5
    return np.asarray(cv2.resize(median, x.shape[::-1], interpolation=cv2.INTER_LINEAR))


def _without_ridges(texture: Float32[np.ndarray, "h w"], window: int) -> Float32[np.ndarray, "h w"]:
    """A lone edge raises the texture in a band as wide as the window; an opening of that size takes it away."""
    opened = cv2.morphologyEx(texture, cv2.MORPH_OPEN, np.ones((window, window), np.uint8))
    return np.asarray(cv2.blur(opened, (window, window)))


def _compact(paint: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """Without single pixels, and without sheets: a quarter of the image in one piece is soil under a low sun."""
    solid = cv2.GaussianBlur(paint, (0, 0), max(paint.shape) / 500)
    _, label, stats, _ = cv2.connectedComponentsWithStats((solid > 0.2).astype(np.uint8))
    area = stats[:, cv2.CC_STAT_AREA]
    kept = (area >= 2e-5 * paint.size) & (area < 0.25 * paint.size)
    kept[0] = False
    whole = np.where(kept[label], np.maximum(paint, solid), 0).astype(np.float32)
    # A sunlit cab roof or a highlight is a hole in the paint: fill outlines that are mostly paint.
    outlines, _ = cv2.findContours((whole > 0.3).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = np.zeros(whole.shape, np.uint8)
    cv2.drawContours(filled, outlines, -1, 1, cv2.FILLED)
    return np.where(filled > 0, np.maximum(whole, 0.7), whole).astype(np.float32)
