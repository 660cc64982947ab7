"""Which photos of a long sequence are worth reconstructing: sharp ones that overlap enough."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Selection:
    """How views are chosen before a network sees them."""

    most: int | None = None
    """Most photos that are used; None uses all that are worth it."""
    overlap: float = 0.9
    """A photo that shares more than this with the last chosen one adds nothing and is left out (of video above all)."""
    sharpness: float = 0.3
    """A photo is left out when its sharpness is below this share of that of its neighbours."""
