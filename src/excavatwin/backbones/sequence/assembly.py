"""The last pass: bring every chunk into the upright frame and write its views, one at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from excavatwin.backbones.sequence.alignment import ranks
from excavatwin.backbones.sequence.chain import IMAGES, Task
from excavatwin.backbones.sequence.similarities import Matrix, moved_pose, scale_of, similarity
from excavatwin.backbones.sequence.store import Chunk, Stack, stored
from excavatwin.backbones.sequence.uprighting import Standing, Upright, canonical, uprighted
from excavatwin.errors import ReconstructionError
from excavatwin.scene.observations import Unplaced, View
from excavatwin.scene.taxonomy import K

POINTS, CONFIDENCE = "points.npy", "confidence.npy"
SPARSE = 20_000
"""Points of the whole sequence from which the vertical and the position are found."""
SCALES_DIFFER = 0.05
"""A metric network whose chunks differ in scale by more than this is reported (standard deviation)."""


@dataclass(frozen=True)
class Assembled:
    """The views in their final frame."""

    views: tuple[View, ...]
    unplaced: tuple[Unplaced, ...]
    upright: Upright
    doubts: tuple[str, ...]


def assemble(task: Task, chunks: Sequence[Chunk], owned: Sequence[range], frames: Sequence[Matrix]) -> Assembled:
    """Find the upright frame, then stream all points into it; the predictions on disk are deleted.

    Args:
        task: photos and scratch folder.
        chunks: with their predictions on disk.
        owned: photos that are taken from each.
        frames: of the chunks, in a frame of their own.

    Raises:
        ReconstructionError: no photo has a point.
    """
    unplaced = tuple(
        Unplaced(task.framing.photos[photo].name, chunk.faults[photo])
        for chunk, mine in zip(chunks, owned, strict=True)
        for photo in mine
        if photo in chunk.faults
    )
    metric = all(chunk.metric for chunk in chunks)
    frames, doubts = _in_metres(frames) if metric else (list(frames), ())
    standing = _standings(task, chunks, owned, frames)
    if not standing:
        raise ReconstructionError(
            f"{task.model.card.name} found no surface in any of the {task.count} photos; use photos that show ground "
            "from a moving position."
        )
    S_F_R = canonical(standing[0], metric)
    upright = uprighted([one.moved(S_F_R) for one in standing], metric)
    S_M_R = upright.S_M_F @ S_F_R
    views = _write(task, chunks, owned, [S_M_R @ frame for frame in frames], task.count - len(unplaced))
    return Assembled(views, unplaced, upright, (*doubts, *upright.doubts))


def _in_metres(frames: Sequence[Matrix]) -> tuple[list[Matrix], tuple[str, ...]]:
    """The frames scaled so that their unit is the metre of the middle chunk: each chunk claims to be in metres."""
    claims = -np.log([scale_of(frame) for frame in frames])
    middle, spread = float(np.median(claims)), float(np.std(claims))
    metres = similarity(float(np.exp(middle)), np.eye(3), np.zeros(3))
    doubts = (f"The network's metres differ between chunks by {spread:.0%}: their median was taken.",)
    return [metres @ frame for frame in frames], doubts if spread > SCALES_DIFFER else ()


def _standings(task: Task, chunks: Sequence[Chunk], owned: Sequence[range], frames: Sequence[Matrix]) -> list[Standing]:
    """Every usable view with its surer points."""
    many = max(20, min(400, SPARSE // task.count))
    found = []
    for chunk, mine, S in zip(chunks, owned, frames, strict=True):
        for photo in mine:
            if photo in chunk.faults:
                continue
            at, points = chunk.sample(photo, 2 * many)
            sure = ranks(chunk.confidence(photo), at, points)
            points = points[sure > min(0.5, 0.99 * sure.max())]
            row = chunk.at(photo)
            lattice = task.framing.lattice(photo, chunk.K_cam[row])
            found.append(Standing(task.framing.photos[photo], lattice, chunk.T_C_cam[row], points).moved(S))
    return [one for one in found if len(one.points)]


def _write(
    task: Task, chunks: Sequence[Chunk], owned: Sequence[range], frames: Sequence[Matrix], count: int
) -> tuple[View, ...]:
    """Stream the views to disk, then open them as memory maps."""
    shape, folder = task.framing.shape, task.scratch
    placed: list[tuple[int, Matrix, np.ndarray]] = []
    with (
        Stack(folder / POINTS, count, (*shape, 3), np.float32) as points,
        Stack(folder / CONFIDENCE, count, shape, np.float32) as confidence,
    ):
        for chunk, mine, S in zip(chunks, owned, frames, strict=True):
            for photo in mine:
                if photo not in chunk.faults:
                    row = chunk.at(photo)
                    points.append(_moved(S, chunk.points(photo)))
                    confidence.append(chunk.confidence(photo))
                    placed.append((photo, moved_pose(S, chunk.T_C_cam[row]), chunk.K_cam[row]))
                    task.progress("alignment", len(placed), count)
            chunk.delete()
    nothing = np.broadcast_to(np.float32(0), (*shape, K))  # one number in memory, read-only
    P, C, images = (stored(folder / name) for name in (POINTS, CONFIDENCE, IMAGES))
    views = []
    for i, (photo, T_R_cam, K_cam) in enumerate(placed):
        lattice, name = task.framing.lattice(photo, K_cam), task.framing.photos[photo].name
        views.append(View(name, P[i], C[i], nothing, T_R_cam, K_cam, images[photo], lattice))
    return tuple(views)


def _moved(S: Matrix, points: Float32[np.ndarray, "H W 3"]) -> Float32[np.ndarray, "H W 3"]:
    """Points under a similarity, computed in double precision."""
    return (points.astype(float) @ S[:3, :3].T + S[:3, 3]).astype(np.float32)
