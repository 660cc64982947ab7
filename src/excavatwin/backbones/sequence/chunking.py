"""How a long sequence is cut into overlapping chunks."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from excavatwin.errors import require

LEAST = 2
"""Fewest photos of a chunk: one is shared with the next, and its points alone give the similarity."""


@dataclass(frozen=True)
class Chunking:
    """Chunk size, overlap and what is demanded of the seams."""

    size: int | None = None
    """Photos that the network sees at once; None takes as many as memory allows, at most 64."""
    shared: int = 8
    """Photos that neighbouring chunks have in common; never more than half of a chunk."""
    tolerance: float = 0.05
    """Two chunks agree on a pixel when their points lie closer together than this share of its distance from the
    camera."""
    seam: float = 0.01
    """A seam at which chunks disagree by more than this (median, as a share of the distance) is reported."""
    loops: int = 2
    """Places seen again that are looked for, for each chunk, to find and remove drift; 0 does not look. Each that is
    found costs one more prediction of twice as many photos as chunks share."""

    def __post_init__(self) -> None:
        require(self, "size", 1)
        require(self, "shared", 1)
        require(self, "tolerance", 0.0, 0.5, open_low=True)
        require(self, "seam", 0.0, 0.5, open_low=True)
        require(self, "loops", 0)

    def overlap(self, size: int) -> int:
        """Photos that neighbouring chunks of this size share at least."""
        return max(1, min(self.shared, size // 2))

    def plan(self, count: int, size: int) -> tuple[range, ...]:
        """Consecutive photos of each chunk: equal sizes, at least ``overlap(size)`` shared with the next one."""
        if size >= count:
            return (range(count),)
        size = max(size, LEAST)
        chunks = 1 + int(np.ceil((count - size) / (size - self.overlap(size))))
        starts = np.linspace(0, count - size, chunks).round().astype(int)
        return tuple(range(start, start + size) for start in starts)


def owners(plan: tuple[range, ...]) -> tuple[range, ...]:
    """The photos that are taken from each chunk: what two chunks share is cut in its middle."""
    cuts = [0, *((after.start + before.stop) // 2 for before, after in pairwise(plan))]
    ends = [*cuts[1:], plan[-1].stop]
    return tuple(range(start, end) for start, end in zip(cuts, ends, strict=True))
