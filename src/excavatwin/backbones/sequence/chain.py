"""Chunk after chunk: read the photos, ask the network, check, keep on disk, align with the chunk before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import UInt8

from excavatwin.backbones.sequence.alignment import align, shared_pairs
from excavatwin.backbones.sequence.framing import Framing
from excavatwin.backbones.sequence.network import Network
from excavatwin.backbones.sequence.pose_graph import Edge
from excavatwin.backbones.sequence.prediction import predict
from excavatwin.backbones.sequence.store import Chunk, Stack, keep
from excavatwin.contract.reprojection import REPORTED
from excavatwin.errors import ReconstructionError
from excavatwin.scene.progress import Progress

if TYPE_CHECKING:
    from excavatwin.backbones.sequence.feed_forward import FeedForward

HOPELESS = 0.25
"""When fewer of their shared pixels agree, two chunks are not in one frame."""
SHAKY = 0.6
"""When fewer agree, the seam is reported."""
IMAGES = "images.npy"


@dataclass(frozen=True)
class Task:
    """What is to be reconstructed, and with what."""

    model: FeedForward
    network: Network
    framing: Framing
    progress: Progress
    scratch: Path

    @property
    def count(self) -> int:
        """Photos of the sequence."""
        return len(self.framing.photos)

    def ask(
        self, photos: Sequence[int], images: UInt8[np.ndarray, "S H W 3"], name: str
    ) -> tuple[Chunk, tuple[float, ...]]:
        """What the network says about some photos, on disk as ``name``; how far their points miss their pixels [px].

        Raises:
            ObservationError, ReconstructionError: it is not to be believed.
        """
        names = [self.framing.photos[photo].name for photo in photos]
        inside = [self.framing.fits[photo].inside() for photo in photos]
        checked = predict(self.network, images, inside, names, self.model.card.name)
        faults = {photos[row]: reason for row, reason in checked.faults.items()}
        path = self.scratch / f"{name}_points.npy"
        return keep(checked.prediction, tuple(photos), faults, path), checked.misses


@dataclass(frozen=True)
class Chain:
    """All chunks, each aligned with the one before."""

    chunks: tuple[Chunk, ...]
    seams: tuple[Edge, ...]
    doubts: tuple[str, ...]


def chain(task: Task, plan: Sequence[range]) -> Chain:
    """Predict and align; one chunk is in memory at a time.

    Raises:
        InputError: a photo can no longer be read.
        ObservationError: a prediction breaks the contract.
        ReconstructionError: points do not meet their pixels, or two chunks do not fit together.
    """
    chunks: list[Chunk] = []
    seams: list[Edge] = []
    shaky: list[tuple[float, str]] = []
    misses: list[float] = []
    before: dict[int, UInt8[np.ndarray, "H W 3"]] = {}
    task.progress("reconstruction", 0, task.count)
    with Stack(task.scratch / IMAGES, task.count, (*task.framing.shape, 3), np.uint8) as images:
        for k, photos in enumerate(plan):
            for photo in photos:
                if photo not in before:
                    before[photo] = task.framing.image(photo)
                    images.append(before[photo])
            before = {photo: before[photo] for photo in photos}
            chunk, missed = task.ask(photos, np.stack(list(before.values())), f"chunk_{k:04d}")
            misses += missed
            chunks.append(chunk)
            if k:
                seams.append(_seam(task, k - 1, chunks[k - 1], chunk, shaky))
            task.progress("reconstruction", photos.stop, task.count)
    return Chain(tuple(chunks), tuple(seams), (*_missed(misses), *_shaken(shaky, len(seams))))


def _seam(task: Task, k: int, a: Chunk, b: Chunk, shaky: list[tuple[float, str]]) -> Edge:
    chunking = task.model.chunking
    first, last = (task.framing.photos[photo].name for photo in (b.photos[0], a.photos[-1]))
    found = align(*shared_pairs(a, b), chunking.tolerance)
    if found is None or found.agreeing < HOPELESS:
        share = "no" if found is None else f"{found.agreeing:.0%}"
        raise ReconstructionError(
            f"{task.model.card.name}: chunks {k + 1} and {k + 2} agree on {share} shared pixels (expected at least "
            f"{HOPELESS:.0%}), so the photos before {first} and after {last} are in no common frame; use a larger "
            "chunking.shared, or photos that overlap more there."
        )
    if found.miss > chunking.seam or found.agreeing < SHAKY:
        shaky.append((found.miss, first))
    return Edge.of(k, k + 1, found)


def _shaken(shaky: list[tuple[float, str]], seams: int) -> tuple[str, ...]:
    if not shaky:
        return ()
    miss, where = max(shaky)
    return (
        f"{len(shaky)} of {seams} seams between chunks fit badly: the worst, at {where}, by {miss:.1%} of the distance "
        "from the camera (median).",
    )


def _missed(misses: list[float]) -> tuple[str, ...]:
    over = [miss for miss in misses if miss > REPORTED]
    if not over:
        return ()
    return (
        f"In {len(over)} of {len(misses)} predicted views points miss their own pixels by more than {REPORTED:g} px "
        f"(worst median {max(over):.1f} px).",
    )
