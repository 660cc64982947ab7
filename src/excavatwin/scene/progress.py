"""Progress: how a long stage says where it is, without knowing who listens."""

from __future__ import annotations

from typing import Protocol, runtime_checkable


@runtime_checkable
class Progress(Protocol):
    """Called by long stages; the CLI draws a bar from it, tests and notebooks may ignore it."""

    def __call__(self, stage: str, done: int, total: int) -> None:
        """``done`` of ``total`` steps of ``stage`` are behind us."""


def silent(stage: str, done: int, total: int) -> None:
    """The null progress."""
