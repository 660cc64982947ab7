"""One lattice for all photos of a sequence: that of their most common size; others are padded."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, UInt8

from excavatwin.backbones.lattices import Fit, Mode, fit, lattice_shape
from excavatwin.scene.observations import Lattice
from excavatwin.scene.photo import Photo

SAME_ASPECT = 0.01
"""Photos whose width over height differs by less than this (relative) are brought onto the lattice in the same way."""


@dataclass(frozen=True)
class Framing:
    """How every photo of a sequence comes onto the one lattice that a network sees."""

    photos: tuple[Photo, ...]
    shape: tuple[int, int]
    """(H, W) of the lattice [px]."""
    fits: tuple[Fit, ...]
    """One for each photo."""

    def image(self, index: int) -> UInt8[np.ndarray, "H W 3"]:
        """The photo on the lattice; padding is white.

        Raises:
            InputError: the photo can no longer be read.
        """
        from excavatwin.capture import read_photo

        fitted = self.fits[index]
        return fitted.image(read_photo(self.photos[index], 2 * max(fitted.resized)))

    def lattice(self, index: int, K_cam: Float64[np.ndarray, "3 3"]) -> Lattice:
        """Where the lattice lies in the photo, given the intrinsics that the network found on the lattice."""
        photo, fitted = self.photos[index], self.fits[index]
        return Lattice(photo.width, photo.height, fitted.affine, fitted.K_photo(K_cam))

    @property
    def padded(self) -> int:
        """Photos of another shape, which do not fill the lattice."""
        return sum(not one.inside().all() for one in self.fits)


def framing(photos: Sequence[Photo], long_side: int, patch: int, mode: Mode) -> Framing:
    """The lattice of the most common size of photo; photos of another shape are shown whole, with a border.

    Raises:
        InputError: ``long_side`` is not a multiple of ``patch``.
    """
    common = Counter((photo.width, photo.height) for photo in photos).most_common(1)[0][0]
    shape = lattice_shape(common, long_side, patch, mode)
    fits = []
    for photo in photos:
        alike = abs(photo.width * common[1] / (photo.height * common[0]) - 1) < SAME_ASPECT
        fits.append(fit((photo.width, photo.height), shape, mode if alike else "pad"))
    return Framing(tuple(photos), shape, tuple(fits))
