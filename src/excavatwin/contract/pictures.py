"""The picture of a view against its photo: channels, orientation, and whether the lattice says where it lies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8

from excavatwin.contract.findings import Finding, named, refusal, report
from excavatwin.contract.orientations import Orientation, best_orientation
from excavatwin.contract.registration import Affine, Source, grey, likeness, register
from excavatwin.contract.shifts import described, displacement
from excavatwin.scene.observations import Lattice, View

Photos = Mapping[str, UInt8[np.ndarray, "h w 3"]]
"""RGB of the photos as displayed, by the names of their views; any size of the same shape will do."""

#: Pictures are registered in so many views.
MOST = 6
#: Correlation of a picture with its photo above which both show the same.
ALIKE = 0.6
#: Correlation above which no other way to lay the photo is tried: things such as cars are nearly symmetric.
SURELY_ALIKE = 0.9
#: The picture may lie beside its place by this at any corner [px].
IN_PLACE = 0.15
#: Pictures with less contrast show nothing that could be compared (fog, an empty sky) [grey].
_PLAIN = 4.0
#: Beyond this share of the lattice's width a shift is refused, below it is reported.
REFUSED = 0.004


@dataclass(frozen=True)
class _Verdict:
    """What is wrong with one picture: equal verdicts of several views become one finding."""

    cause: str
    remedy: str
    what: str
    severe: bool
    figures: tuple[tuple[str, float], ...] = ()


def pictures(views: Sequence[View], photos: Photos) -> tuple[Finding, ...]:
    """Mistakes between pictures and photos.

    Args:
        views: those without an image are passed over; those without a lattice are taken for the photos themselves.
        photos: some or all of the views' photos.
    """
    names = frozenset(photos)  # asking a lazy mapping whether it holds a photo would read it
    able = [view for view in views if view.image is not None and view.name in names]
    if not able:
        return ()
    chosen = [able[i] for i in np.unique(np.linspace(0, len(able) - 1, min(MOST, len(able))).astype(int))]
    verdicts: dict[str, list[tuple[str, _Verdict]]] = {}
    for view in chosen:
        for verdict in _compared(view, photos[view.name]):
            verdicts.setdefault(verdict.cause or verdict.what, []).append((view.name, verdict))
    return tuple(_finding(found, len(chosen)) for found in verdicts.values())


def _finding(found: list[tuple[str, _Verdict]], total: int) -> Finding:
    middle = sorted(found, key=lambda one: [abs(value) for _, value in one[1].figures])[len(found) // 2][1]
    say = refusal if middle.severe else report
    what = f"the pictures of {named([name for name, _ in found], total)} {middle.what}"
    return say(what, middle.cause, middle.remedy, **dict(middle.figures))


def _compared(view: View, photo: UInt8[np.ndarray, "h w 3"]) -> list[_Verdict]:
    assert view.image is not None
    if view.image.max() <= 1 < photo.max():
        return [_Verdict("values are 0..1 instead of 0..255", "multiply the images by 255", "are all but black", True)]
    lattice = _lattice(view, photo)
    turned = _photo_shape(lattice, photo)
    if turned is not None:
        return [turned]
    source = Source.of(photo, lattice)
    pixels, inside = source.on(view.shape, lattice.affine)
    alike = likeness(grey(pixels), grey(view.image), inside)
    if alike < SURELY_ALIKE:
        other = best_orientation(source, view.image)
        if other.cause and other.alike > max(ALIKE, alike + 0.1):
            return [_turned(other)]
        if other.alike > alike + 0.1:
            lattice = Lattice(lattice.width, lattice.height, other.affine, lattice.K_photo, lattice.distortion)
    fitted, alike = register(source, view.image, lattice.affine)
    if alike < ALIKE:
        return [_stranger(alike)] if grey(view.image).std() > _PLAIN else []
    pixels, inside = source.on(view.shape, fitted)
    reported = _lattice(view, photo)
    return [*_channels(view.image[inside], pixels[inside]), *_shifted(view, reported, fitted)]


def _lattice(view: View, photo: UInt8[np.ndarray, "h w 3"]) -> Lattice:
    if view.lattice is not None:
        return view.lattice
    H, W = view.shape
    return Lattice(W, H, np.array([[1.0, 0, 0], [0, 1, 0]]), view.K_cam)


def _photo_shape(lattice: Lattice, photo: UInt8[np.ndarray, "h w 3"]) -> _Verdict | None:
    """The photo's size in the lattice must have the shape of the photo, in whatever size this comes."""
    h, w = photo.shape[:2]
    if abs(np.log(lattice.width / lattice.height * h / w)) < 0.01:
        return None
    what = (
        f"come from lattices for photos of {lattice.width} x {lattice.height} px, but they are {w} x {h} as displayed"
    )
    if abs(np.log(lattice.width / lattice.height * w / h)) < 0.01:
        return _Verdict(
            "width and height are swapped (H and W, or the EXIF orientation is ignored)",
            "take size and pixels of the photo after its EXIF orientation (read_photo does)",
            what,
            True,
        )
    return _Verdict(
        "the size in the lattice is not that of the full photo", "give width and height of the photo", what, True
    )


def _turned(other: Orientation) -> _Verdict:
    return _Verdict(other.cause, other.remedy, "are not the right way round", True, (("likeness", other.alike),))


def _stranger(alike: float) -> _Verdict:
    return _Verdict(
        "",
        "check which image belongs to which photo",
        f"do not show what their photos show (correlation {alike:.2f})",
        alike < ALIKE / 2,
        (("likeness", alike),),
    )


def _channels(image: UInt8[np.ndarray, "n 3"], photo: UInt8[np.ndarray, "n 3"]) -> list[_Verdict]:
    """Which channel of the photo each channel of the image is, told by what is colour in both."""
    a, b = (one[:: 1 + len(one) // 6_000].astype(np.float64) for one in (image, photo))
    a, b = a - a.mean(axis=1, keepdims=True), b - b.mean(axis=1, keepdims=True)
    if min(a.std(), b.std()) < 1.5:  # grey pictures have no order of channels
        return []
    score = {
        order: float(np.corrcoef(a.ravel(), b[:, order].ravel())[0, 1])
        for order in ((0, 1, 2), (2, 1, 0), (1, 0, 2), (0, 2, 1), (1, 2, 0), (2, 0, 1))
    }
    best = max(score, key=lambda order: score[order])
    if best == (0, 1, 2) or score[best] < max(0.5, score[0, 1, 2] + 0.2):
        return []
    order = "".join("RGB"[channel] for channel in best)
    return [
        _Verdict(
            f"the channel order is {order}",
            "reverse the channels to RGB (OpenCV reads BGR)" if order == "BGR" else "put the channels into RGB order",
            "have the colours of their photos in other channels",
            True,
            (("correlation", score[best]), ("correlation_as_rgb", score[0, 1, 2])),
        )
    ]


def _shifted(view: View, reported: Lattice, fitted: Affine) -> list[_Verdict]:
    found = displacement(reported.affine, fitted, view.shape)
    if found.largest <= IN_PLACE:
        return []
    cause, remedy = described(reported, fitted, view.shape)
    scale = "" if max(abs(found.scale_x - 1), abs(found.scale_y - 1)) < 1e-3 else (
        f" and {found.scale_x:.4g} x {found.scale_y:.4g} times as large"
    )  # fmt: skip
    return [
        _Verdict(
            cause,
            remedy,
            f"lie ({found.x:+.2f}, {found.y:+.2f}) px beside the place that the lattice gives{scale}",
            found.largest > REFUSED * view.shape[1],
            (("shift_x_px", found.x), ("shift_y_px", found.y), ("largest_px", found.largest)),
        )
    ]
