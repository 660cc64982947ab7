"""Do class borders lie on the edges of the picture? If not, where do they?

Borders and edges are correlated over all shifts at once. A segmenter puts its borders a little wrong everywhere, but
not all to one side: over some views the correlation peaks within a tenth of a pixel or two of no shift.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

from excavatwin.contract.cameras import half_pixel
from excavatwin.contract.findings import Finding, refusal, report
from excavatwin.contract.orientations import TURNS, Turn
from excavatwin.contract.smoothing import slow
from excavatwin.scene.observations import View

Map = Float32[np.ndarray, "H W"]

#: Views that are looked at.
MOST = 6
#: A peak rises above the other shifts by so many of their standard deviations, or it is none.
PEAK = 6.0
#: Shifts below this are those of segmenters and shadows [px].
BELIEVED = 0.35
#: Below this a shift is reported only if it is that of pixel centres at whole numbers: masks are no better [px].
COARSE = 1.5
#: Shifts above this are refused [px].
REFUSED = 3.0
_REACH = 1 / 8
_COARSE = 160


@dataclass(frozen=True)
class _Peak:
    """Where borders and edges fit best."""

    x: float
    """From the edges to the borders [px]."""
    y: float
    height: float
    """Above the other shifts, in their standard deviations."""
    correlation: float


def borders(views: Sequence[View]) -> tuple[Finding, ...]:
    """Whether evidence lies on the same pixels as the picture."""
    able = [view for view in views if view.image is not None and _bordered(view.evidence)]
    if len(able) < 2:
        return ()
    chosen = [able[i] for i in np.unique(np.linspace(0, len(able) - 1, min(MOST, len(able))).astype(int))]
    made = [(class_borders(view.evidence), edges(view.image)) for view in chosen if view.image is not None]
    if len({b.shape for b, _ in made}) > 1:
        made = [one for one in made if one[0].shape == made[0][0].shape]
    surfaces = [_correlated(b, e) for b, e in made]
    pooled = _peak(np.mean(surfaces, axis=0))
    off = float(np.hypot(pooled.x, pooled.y))
    if pooled.height > PEAK and off <= BELIEVED:
        return ()
    turned = _turned(made, pooled if off <= REFUSED else None)
    if turned is not None:
        return (turned,)
    if pooled.height > PEAK and _together([_peak(surface) for surface in surfaces], pooled):
        return (_shifted(pooled, len(made)),)
    return ()


def edges(image: UInt8[np.ndarray, "H W 3"]) -> Map:
    """Strength of the picture's edges relative to their surroundings."""
    smooth = cv2.GaussianBlur(image, (0, 0), 1.0).astype(np.float32)
    strength = np.sqrt((_slope(smooth, 1) ** 2 + _slope(smooth, 0) ** 2).sum(axis=-1))
    return strength / (slow(strength, image.shape[1] / 40) + 1)


def class_borders(evidence: Float32[np.ndarray, "H W K"]) -> Map:
    """Strength of the changes of evidence."""
    smooth = cv2.GaussianBlur(np.ascontiguousarray(evidence[..., :4]), (0, 0), 0.7)
    rest = cv2.GaussianBlur(np.ascontiguousarray(evidence[..., 4:]), (0, 0), 0.7).reshape(*evidence.shape[:2], -1)
    both = np.concatenate([smooth, rest], axis=-1)
    return np.sqrt((_slope(both, 1) ** 2 + _slope(both, 0) ** 2).sum(axis=-1))


def _slope(layers: np.ndarray, axis: int) -> np.ndarray:
    found = np.zeros_like(layers)
    if axis == 1:
        found[:, 1:-1] = (layers[:, 2:] - layers[:, :-2]) / 2
    else:
        found[1:-1] = (layers[2:] - layers[:-2]) / 2
    return found


def _bordered(evidence: Float32[np.ndarray, "H W K"]) -> bool:
    small = evidence[::8, ::8].argmax(axis=-1) * evidence[::8, ::8].any(axis=-1)
    return min(small.shape) > 1 and bool((small[1:] != small[:-1]).mean() > 0.002)


def _correlated(border: Map, edge: Map) -> Map:
    """Correlation at every shift, no shift in the middle."""
    window = np.outer(np.hanning(border.shape[0]), np.hanning(border.shape[1])) ** 0.25
    a, b = (border - border.mean()) * window, (edge - edge.mean()) * window
    product = np.fft.rfft2(a) * np.conj(np.fft.rfft2(b))
    size = float(np.sqrt((a**2).sum() * (b**2).sum()))
    return (np.fft.fftshift(np.fft.irfft2(product, border.shape)) / max(size, 1e-12)).astype(np.float32)


def _peak(surface: Map, reach: int | None = None) -> _Peak:
    """The greatest correlation within reach of no shift, to a part of a pixel (parabola)."""
    H, W = surface.shape
    reach = reach or round(_REACH * max(H, W))
    R, C = min(reach, H // 2 - 1), min(reach, W // 2 - 1)
    near = surface[H // 2 - R : H // 2 + R + 1, W // 2 - C : W // 2 + C + 1].astype(np.float64)
    i, j = (int(v) for v in np.unravel_index(int(near.argmax()), near.shape))
    i, j = min(max(i, 1), 2 * R - 1), min(max(j, 1), 2 * C - 1)

    def part(a: float, b: float, c: float) -> float:
        return 0.5 * (a - c) / (a - 2 * b + c) if a - 2 * b + c < 0 else 0.0

    x = j - C + part(near[i, j - 1], near[i, j], near[i, j + 1])
    y = i - R + part(near[i - 1, j], near[i, j], near[i + 1, j])
    height = (near[i, j] - np.median(near)) / max(float(near.std()), 1e-9)
    return _Peak(float(x), float(y), float(height), float(near[i, j]))


def _together(single: Sequence[_Peak], pooled: _Peak) -> bool:
    """Whether the views say the same one by one: most of them, and in the mean well beyond their scatter."""
    apart = np.array([[one.x - pooled.x, one.y - pooled.y] for one in single])
    near = np.hypot(*apart.T) < 1.0
    if len(single) < 3 or near.sum() < max(3, 0.6 * len(single)):
        return False
    if np.hypot(pooled.x, pooled.y) < COARSE and not half_pixel(pooled.x, pooled.y):
        return False
    shifts = np.array([[one.x, one.y] for one in single])[near]
    error = shifts.std(axis=0, ddof=1) / np.sqrt(near.sum())
    return bool((np.abs(shifts.mean(axis=0)) > np.maximum(4 * error, BELIEVED)).any())


def _shifted(pooled: _Peak, views: int) -> Finding:
    half = half_pixel(pooled.x, pooled.y)
    say = refusal if np.hypot(pooled.x, pooled.y) > REFUSED else report
    return say(
        f"class borders lie ({pooled.x:+.2f}, {pooled.y:+.2f}) px beside the edges of the picture, in all of {views} "
        "views that were compared",
        "half a pixel: pixel centres at whole numbers in the resizing of the evidence"
        if half
        else "the evidence is shifted: the offset of a crop or padding is forgotten",
        "bring the evidence onto the picture's lattice by the inverse of the affine of the network's input",
        shift_x_px=pooled.x,
        shift_y_px=pooled.y,
    )


def _turned(made: Sequence[tuple[Map, Map]], pooled: _Peak | None) -> Finding | None:
    """Evidence that is turned, mirrored, transposed, or was not cut out of the square that the network saw."""
    factor = max(1.0, max(made[0][0].shape) / _COARSE)
    H, W = (round(side / factor) for side in made[0][0].shape)
    small = [tuple(cv2.resize(one, (W, H), interpolation=cv2.INTER_AREA) for one in pair) for pair in made]
    before = _fit([(b, e) for b, e in small])
    best: tuple[_Peak, str, str] | None = None
    for back, cause, remedy in _ways((H, W)):
        peak = _fit([(back(b), e) for b, e in small])
        if np.hypot(peak.x, peak.y) < 2 and (best is None or peak.correlation > best[0].correlation):
            best = peak, cause, remedy
    if best is None or best[0].height < PEAK or best[0].correlation < 1.5 * max(before.correlation, 0.02):
        return None
    if pooled is not None and pooled.height > PEAK:
        return None
    return refusal(
        "class borders do not lie on the edges of the picture, but would if the evidence lay otherwise",
        best[1],
        best[2],
        correlation=before.correlation,
        correlation_if_mended=best[0].correlation,
    )


def _fit(pairs: Sequence[tuple[Map, Map]]) -> _Peak:
    return _peak(np.mean([_correlated(b, e) for b, e in pairs], axis=0))


def _ways(shape: tuple[int, int]) -> Iterator[tuple[Callable[[Map], Map], str, str]]:
    """How to bring evidence back, with the mistake that this undoes."""
    for turn, cause, _ in TURNS[1:]:
        said = cause.replace("of the images are", "of the evidence are").replace("the images are", "the evidence is")
        if turn(np.empty(shape)).shape == shape:
            yield _turning(turn), said, "turn it back onto the picture's pixels"
    H, W = shape
    side = max(H, W)
    for middle, sides in ((True, "on both sides"), (False, "at the end")):
        x, y = ((side - W) // 2, (side - H) // 2) if middle else (0, 0)
        M = np.array([[W / side, 0, x * W / side], [0, H / side, y * H / side]])
        yield (
            _warped(M, shape, cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP),
            f"the padding is forgotten: the network saw the picture padded {sides}, and the whole output was resized "
            "to the lattice",
            "cut the padding off the output before resizing it",
        )
    side = min(H, W)
    M = np.array([[side / W, 0, (W - side) / 2], [0, side / H, (H - side) / 2]])
    yield (
        _warped(M, shape, cv2.INTER_LINEAR),
        "the crop is forgotten: the network saw the middle square only, and its output was stretched over the lattice",
        "put the output where the crop was; there is no evidence outside it",
    )


def _turning(turn: Turn) -> Callable[[Map], Map]:
    return lambda border: np.ascontiguousarray(turn(border))


def _warped(M: np.ndarray, shape: tuple[int, int], flags: int) -> Callable[[Map], Map]:
    return lambda border: np.asarray(cv2.warpAffine(border, M, shape[::-1], flags=flags))
