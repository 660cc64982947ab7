"""Photos and pictures as no benchmark has them: odd sizes, upright, alone, damaged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from excavatwin.backbones.protocols import Picture
from excavatwin.capture import find_photos, read_photo
from excavatwin.scene.photo import Photo

#: Sides that are multiples of nothing (width, height) [px].
ODD = (517, 391)
_TURNED = 6
"""EXIF: the top of what is shown is the right side of what is stored."""


def odd_photos(photos: Sequence[Photo], folder: Path, upright: bool) -> list[Photo]:
    """The photos in an odd size, with their EXIF; or upright by their EXIF orientation alone, as phones write them."""
    folder.mkdir(parents=True)
    for photo in photos:
        image = _odd(read_photo(photo), (ODD[1], ODD[0]) if upright else ODD)
        with Image.open(photo.path) as stored:
            exif = Image.Exif() if upright else stored.getexif()
        exif[0x0112] = _TURNED if upright else 1
        shown = np.rot90(image) if upright else image
        Image.fromarray(shown).save(folder / photo.name, exif=exif.tobytes(), quality=92)
    return find_photos(folder)


def damaged(photos: Sequence[Photo], folder: Path) -> list[Photo]:
    """The photos, the file of the second (or only) one cut off after it was found."""
    folder.mkdir(parents=True)
    at = min(1, len(photos) - 1)
    broken = folder / photos[at].name
    broken.write_bytes(photos[at].path.read_bytes()[:600])
    return [replace(photo, path=broken) if i == at else photo for i, photo in enumerate(photos)]


def odd_picture(picture: Picture, upright: bool) -> Picture:
    """A picture in an odd size; upright, or not."""
    image = _odd(picture.image, (ODD[1], ODD[0]) if upright else ODD)
    return Picture(image, picture.name)


def _odd(image: UInt8[np.ndarray, "h w 3"], size: tuple[int, int]) -> UInt8[np.ndarray, "H W 3"]:
    """As much as possible of the middle of an image, in a size (width, height)."""
    h, w = image.shape[:2]
    part = min(w / size[0], h / size[1])
    cut_w, cut_h = round(part * size[0]), round(part * size[1])
    x, y = (w - cut_w) // 2, (h - cut_h) // 2
    cut = np.ascontiguousarray(image[y : y + cut_h, x : x + cut_w])
    return np.asarray(Image.fromarray(cut).resize(size, Image.Resampling.BICUBIC))
