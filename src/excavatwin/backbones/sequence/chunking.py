"""How a long sequence is cut into overlapping chunks."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Chunking:
    """Chunk size, overlap and what is demanded of the seams."""

    size: int | None = None
    """Photos that the network sees at once; None takes as many as memory allows."""
    shared: int = 8
    """Photos that neighbouring chunks have in common."""
