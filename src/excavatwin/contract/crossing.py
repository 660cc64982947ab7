"""Points of one view seen from others: do they lie on the surface, and on the picture, that those views report?"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8

from excavatwin.contract.smoothing import slow
from excavatwin.scene.frames import invert_rigid, transform
from excavatwin.scene.observations import View

Pose = Float64[np.ndarray, "4 4"]
Intrinsics = Float64[np.ndarray, "3 3"]

#: Points of a view that are sent into the others.
SAMPLES = 500
#: Points of a pair that must meet before the pair says anything.
FEWEST = 25
#: Depths that agree within this share belong to one surface.
SAME_SURFACE = 0.05


@dataclass(frozen=True)
class Glimpse:
    """What the comparison needs of one view."""

    name: str
    T: Pose
    """Camera-to-world, as reported."""
    K: Intrinsics
    """As reported."""
    depth: Float32[np.ndarray, "H W"]
    """Along the optical axis of the reported pose; NaN = none."""
    pixels: Int64[np.ndarray, "n 2"]
    """Row and column of the sampled pixels; all have a depth."""
    tone: Float32[np.ndarray, "H W"] | None
    """Luminance without its slow changes; None without an image."""


@dataclass(frozen=True)
class Reading:
    """How the numbers of a view are to be understood; the default is our contract."""

    pose: Callable[[Pose], Pose] = lambda T: T
    """From what is reported to a camera-to-world pose with OpenCV axes."""
    intrinsics: Callable[[Intrinsics, tuple[int, int]], Intrinsics] = lambda K, shape: K
    """From what is reported, and (H, W), to intrinsics on this lattice."""
    stretch: Callable[[Float64[np.ndarray, "n 2"]], Float64[np.ndarray, "n"] | float] = lambda ray: 1.0
    """Factor on the depth, by the slopes (x/z, y/z) of the reported ray."""
    picture: Callable[[Float32[np.ndarray, "H W"]], Float32[np.ndarray, "H W"]] = lambda tone: tone
    """How the picture lies on the lattice."""


@dataclass(frozen=True)
class Agreement:
    """How well views agree under one reading."""

    gap: float
    """Median relative difference of depth where views overlap; NaN when they do not."""
    met: int
    """Points that fell onto a surface of another view."""
    overlap: float
    """Their share among all that were sent."""
    likeness: float
    """Median over pairs of the correlation of the pictures where the depths agree; NaN when unknown."""


def glimpse(view: View) -> Glimpse | None:
    """A view made ready; None when it has hardly any point."""
    z = (view.points.astype(np.float64) - view.T_R_cam[:3, 3]) @ view.T_R_cam[:3, 2]
    depth = np.where(z > 0, z, np.nan).astype(np.float32)
    at = np.flatnonzero(np.isfinite(depth))
    if len(at) < FEWEST:
        return None
    at = at[np.linspace(0, len(at) - 1, min(SAMPLES, len(at))).astype(np.int64)]
    pixels = np.stack(np.unravel_index(at, depth.shape), axis=-1)
    tone = None if view.image is None else _tone(view.image)
    return Glimpse(view.name, view.T_R_cam, view.K_cam, depth, pixels, tone)


def agreement(glimpses: Sequence[Glimpse], pairs: Sequence[tuple[int, int]], reading: Reading) -> Agreement:
    """Send the points of the first view of every pair into the second."""
    seen = [_understood(one, reading) for one in glimpses]
    gaps, likeness, sent = [], [], 0
    for a, b in pairs:
        gap, tones = _pair(glimpses[a], seen[a], glimpses[b], seen[b])
        sent += len(glimpses[a].pixels)
        gaps.append(gap)
        if tones is not None and len(tones[0]) >= FEWEST:
            likeness.append(_correlation(*tones))
    pooled = np.concatenate(gaps) if gaps else np.empty(0)
    return Agreement(
        gap=float(np.median(pooled)) if len(pooled) >= FEWEST else float("nan"),
        met=len(pooled),
        overlap=len(pooled) / max(sent, 1),
        likeness=float(np.median(likeness)) if likeness else float("nan"),
    )


def gaps(one: Glimpse, others: Sequence[Glimpse], reading: Reading) -> Float64[np.ndarray, "n"]:
    """Median relative distance of each sampled point from the surfaces of other views; NaN where none shows it."""
    own = _understood(one, reading)
    found = np.full((len(others), len(one.pixels)), np.nan)
    for row, other in zip(found, others, strict=True):
        gap, met, _ = _met(own, other, _understood(other, reading))
        row[met] = gap
    known = np.isfinite(found).any(axis=0)
    median = np.full(len(one.pixels), np.nan)
    if known.any():
        median[known] = np.nanmedian(found[:, known], axis=0)
    return median


@dataclass(frozen=True)
class _Seen:
    """A view under one reading."""

    T: Pose
    K: Intrinsics
    points: Float64[np.ndarray, "n 3"]
    """World points of the sampled pixels."""
    stretch: Callable[[Float64[np.ndarray, "n 2"]], Float64[np.ndarray, "n"] | float]
    tone: Float32[np.ndarray, "H W"] | None


def _understood(one: Glimpse, reading: Reading) -> _Seen:
    T, K = reading.pose(one.T), reading.intrinsics(one.K, one.depth.shape)
    row, col = one.pixels.T
    z = one.depth[row, col] * reading.stretch(_slopes(one.K, one.pixels))
    p_cam = np.concatenate([_slopes(K, one.pixels) * z[:, None], z[:, None]], axis=1)
    tone = None if one.tone is None else reading.picture(one.tone)
    return _Seen(T, K, transform(T, p_cam), reading.stretch, tone)


def _slopes(K: Intrinsics, pixels: Int64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
    return (pixels[:, ::-1] + 0.5 - K[:2, 2]) / np.array([K[0, 0], K[1, 1]])


def _pair(
    first: Glimpse, a: _Seen, second: Glimpse, b: _Seen
) -> tuple[Float64[np.ndarray, "m"], tuple[np.ndarray, np.ndarray] | None]:
    """Relative gaps of the points of ``a`` to the surface of ``b``, and the tones of both where the gap is small."""
    gap, met, pixels = _met(a, second, b)
    if a.tone is None or b.tone is None:
        return gap, None
    same = gap < SAME_SURFACE
    here, there = first.pixels[met][same], pixels[same]
    return gap, (a.tone[here[:, 0], here[:, 1]], b.tone[there[:, 0], there[:, 1]])


def _met(
    a: _Seen, second: Glimpse, b: _Seen
) -> tuple[Float64[np.ndarray, "m"], Int64[np.ndarray, "m"], Int64[np.ndarray, "m 2"]]:
    """Relative gaps of those points of ``a`` that meet a surface of ``b``, which these are, and where they meet it."""
    p = transform(invert_rigid(b.T), a.points)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        uv = p[:, :2] / p[:, 2:] * np.array([b.K[0, 0], b.K[1, 1]]) + b.K[:2, 2]
        H, W = second.depth.shape
        inside = np.flatnonzero((p[:, 2] > 0) & (uv >= 0).all(axis=1) & (uv[:, 0] < W) & (uv[:, 1] < H))
    pixels = np.floor(uv[inside, ::-1]).astype(np.int64)
    found = second.depth[pixels[:, 0], pixels[:, 1]] * b.stretch(_slopes(second.K, pixels))
    there = np.isfinite(found)
    met = inside[there]
    return np.abs(np.log(found[there] / p[met, 2])), met, pixels[there]


def _tone(image: UInt8[np.ndarray, "H W 3"]) -> Float32[np.ndarray, "H W"]:
    import cv2

    grey = cv2.transform(image, np.full((1, 3), 1 / 3, np.float32)).astype(np.float32)
    side = max(grey.shape)
    return np.asarray(cv2.GaussianBlur(grey, (0, 0), side / 260)) - slow(grey, side / 20)


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0 else 0.0
