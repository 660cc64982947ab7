"""How the photos are placed."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Placing:
    """Parameters of structure from motion. The defaults serve drone photos."""

    long_side: int = 1000
    """Photos are shrunk to this before features are sought [px]."""
    max_features: int = 3000
    """Features kept per photo."""
    contrast: float = 0.03
    """Least contrast of a feature (OpenCV's SIFT); half of it takes twice the time and places no more photos."""
    neighbours: int = 12
    """Photos that each photo is compared with in sets too large to compare all."""
    exhaustive_up_to: int = 24
    """Sets up to this size are compared all with all."""
    ratio: float = 0.8
    """A match is this much nearer than the next best one."""
    seed: int = 0
    """Of every random choice."""
