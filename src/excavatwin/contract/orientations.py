"""Which way round a picture is, and which part of the photo it is: for pictures that do not fit as reported."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Shaped, UInt8

from excavatwin.contract.registration import Affine, Source, grey, likeness
from excavatwin.contract.shifts import placements
from excavatwin.scene.observations import Lattice

Turn = Callable[[Shaped[np.ndarray, "H W *c"]], Shaped[np.ndarray, "H2 W2 *c"]]

_EXIF = "honour the EXIF orientation of the photos (read_photo does)"
_AXES = "an image is (rows, columns, channels); swap its first two axes"

#: What was done to a picture, with cause and remedy.
TURNS: tuple[tuple[Turn, str, str], ...] = (
    (lambda a: a, "", ""),
    (lambda a: a[:, ::-1], "the images are mirrored left to right", "flip them back"),
    (lambda a: a[::-1], "the images are upside down (mirrored)", "flip their rows"),
    (lambda a: a[::-1, ::-1], "the images are turned by 180 degrees", _EXIF),
    (lambda a: np.rot90(a), "the images are turned by 90 degrees", _EXIF),
    (lambda a: np.rot90(a, -1), "the images are turned by 90 degrees", _EXIF),
    (lambda a: a.swapaxes(0, 1), "rows and columns of the images are swapped (H and W)", _AXES),
    (lambda a: a[::-1, ::-1].swapaxes(0, 1), "rows and columns of the images are swapped (H and W)", _AXES),
)
_SMALL = 160


@dataclass(frozen=True)
class Orientation:
    """The best way to see a photo in a picture."""

    affine: Affine
    """Of the photo, when it is the right way round."""
    cause: str
    """Empty when it is the right way round."""
    remedy: str
    alike: float
    """Correlation of picture and photo then."""


def best_orientation(source: Source, image: UInt8[np.ndarray, "H W 3"]) -> Orientation:
    """All turns of the photo, in all usual placements, against the picture; coarsely."""
    factor = max(1.0, max(image.shape[:2]) / _SMALL)
    shape = (round(image.shape[0] / factor), round(image.shape[1] / factor))
    import cv2

    small = grey(np.asarray(cv2.resize(image, shape[::-1], interpolation=cv2.INTER_AREA)))
    shrink = np.array([[shape[1] / image.shape[1]], [shape[0] / image.shape[0]]])
    best = Orientation(source.lattice.affine, "", "", -1.0)
    for affine, turned, placed, cause, remedy in _candidates(source, image.shape[:2]):
        pixels, inside = placed.on(shape, affine * shrink)
        alike = likeness(turned(grey(pixels)), small, turned(inside))
        if alike > best.alike + 0.02:  # of equals the plainest, which comes first
            best = Orientation(affine, cause, remedy, alike)
    return best


def _candidates(source: Source, shape: tuple[int, int]) -> Iterator[tuple[Affine, Turn, Source, str, str]]:
    lattice = source.lattice
    for turn, cause, remedy in TURNS:  # the picture was turned when it was on its lattice already
        if turn(np.empty(shape)).shape == shape:
            yield lattice.affine, turn, source, cause, remedy
    for turn, cause, remedy in TURNS:  # the photo was turned before
        pixels = np.ascontiguousarray(turn(source.pixels))
        size = (lattice.width, lattice.height)
        if pixels.shape[:2] != source.pixels.shape[:2]:
            size = size[::-1]
        placed = Source(pixels, Lattice(*size, lattice.affine, lattice.K_photo))
        for affine in placements(size, shape).values():
            yield affine, TURNS[0][0], placed, cause, remedy
