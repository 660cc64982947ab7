"""How much memory a run needs, before it starts: better than "killed" after twenty minutes."""

from __future__ import annotations

import os

from excavatwin.backbones.sequence.memory import available
from excavatwin.errors import InputError

__all__ = ["available", "check", "cores", "estimate", "lattice_of"]

#: Interpreter, libraries and compiled kernels [bytes].
_FLOOR = 450e6
#: Work arrays of structure from motion and of dense matching at a lattice of 640 x 480 [bytes].
_WORKING = 500e6
#: A view at rest (points, confidence, evidence, image) and its share of points and voxels in the mapper, per pixel.
_PER_PIXEL = 28 + 130


def estimate(photos: int, lattice: int = 640, aspect: float = 0.75) -> float:
    """Peak memory of `map` for so many photos on so long a lattice [bytes]; within 20 % on 14, 23 and 75 photos."""
    pixels = lattice * lattice * aspect
    return _FLOOR + _WORKING * pixels / (640 * 480) + photos * pixels * _PER_PIXEL


def lattice_of(reconstructor: object) -> int:
    """Longer side of the lattice on which a reconstructor works, where it is a parameter; else that of the default."""
    return int(getattr(reconstructor, "lattice", 640))


def check(photos: int, lattice: int, aspect: float) -> tuple[str, ...]:
    """A warning where memory is short; a refusal where it cannot do.

    Raises:
        InputError: so many photos need half as much memory again as there is.
    """
    need, free = estimate(photos, lattice, aspect), available()
    if free is None or need <= free:
        return ()
    advice = "map fewer photos at a time, or use a smaller lattice (--photogrammetry.lattice)"
    figures = f"{photos} photos need about {need / 1e9:.1f} GB of memory and {free / 1e9:.1f} GB are available"
    if need > 1.5 * free:
        raise InputError(f"{figures}; {advice}.")
    return (f"{figures}: should the run be killed, {advice}.",)


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
