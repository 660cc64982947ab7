"""How much memory a run needs, before it starts: better than "killed" after twenty minutes."""

from __future__ import annotations

import os
from dataclasses import fields, is_dataclass

from excavatwin.backbones.protocols import Reconstructor
from excavatwin.backbones.sequence.memory import available
from excavatwin.errors import InputError

__all__ = ["available", "check", "cores", "estimate", "lattice_of", "used_of"]

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


def used_of(reconstructor: object, photos: int) -> int:
    """Of so many photos how many it uses at the most."""
    most = getattr(getattr(reconstructor, "selection", None), "most", None)
    return photos if most is None else min(photos, most)


def check(reconstructor: Reconstructor, found: int, aspect: float) -> tuple[str, ...]:
    """A warning where memory is short; a refusal where it cannot do.

    Args:
        reconstructor: that is going to be used.
        found: photos that it is given.
        aspect: shorter side over longer side of the lattice.

    Raises:
        InputError: so many photos need half as much memory again as there is.
    """
    photos = used_of(reconstructor, found)
    need, free = estimate(photos, lattice_of(reconstructor), aspect), available()
    if free is None or need <= free:
        return ()
    parameters: list[str] = [field.name for field in fields(reconstructor)] if is_dataclass(reconstructor) else []
    name, fewer = reconstructor.card.name, "map fewer photos at a time"
    if "selection" in parameters:
        fewer += f" (--{name}.selection.most)"
    advice = f"{fewer}, or use a smaller lattice (--{name}.lattice)" if "lattice" in parameters else fewer
    figures = f"{photos} photos need about {need / 1e9:.1f} GB of memory and {free / 1e9:.1f} GB are available"
    if need > 1.5 * free:
        raise InputError(f"{figures}; {advice}.")
    return (f"{figures}: should the run be killed, {advice}.",)


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
