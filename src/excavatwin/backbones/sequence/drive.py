"""From photos to observations through a feed-forward network: select, chunk, align, close loops, store, validate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from excavatwin.scene.observations import Observations
from excavatwin.scene.photo import Photo
from excavatwin.scene.progress import Progress

if TYPE_CHECKING:
    from excavatwin.backbones.sequence.chain import Chain, Task
    from excavatwin.backbones.sequence.feed_forward import FeedForward
    from excavatwin.backbones.sequence.loops import Closed


def reconstruct(model: FeedForward, photos: Sequence[Photo], progress: Progress, scratch: Path) -> Observations:
    """Observations of the photos, in one frame: upright, in metres where GPS or the network knows them.

    Memory is that of one chunk, whatever the number of photos: predictions go to ``scratch``, and the views that come
    back are memory maps of files there.

    Raises:
        MissingExtraError: the network's library is not installed.
        InputError: no photo, unreadable photos, weights that are not here, or too little memory for two photos.
        ObservationError: what the network says breaks the contract of observations.
        ReconstructionError: points do not meet their own pixels, chunks do not fit together, or there is no surface.
        OutputError: the disk of ``scratch`` is too small.
    """
    from excavatwin.backbones.device import halving
    from excavatwin.backbones.extras import need
    from excavatwin.backbones.sequence.chain import Task
    from excavatwin.backbones.sequence.chunking import LEAST
    from excavatwin.backbones.sequence.framing import framing
    from excavatwin.backbones.sequence.memory import room

    need(model.card)
    chosen = model.selection(photos, progress)
    framed = framing(chosen.photos, model.lattice, model.patch, model.mode)
    count = len(chosen.photos)
    space = room(model, framed.shape, count)
    task = Task(model, model.open(), framed, progress, Path(scratch))
    said: list[str] = []
    found = halving(lambda size: _once(task, size), space.size, min(LEAST, count), said.append)
    doubts = [f"Chunks became smaller: {sentence}" for sentence in said]
    if framed.padded:
        doubts.append(f"{framed.padded} photos of another shape than the most common one were padded.")
    return replace(
        found,
        unplaced=(*chosen.unplaced, *found.unplaced),
        doubts=(*doubts, *found.doubts),
        source=found.source | {"memory": space.sentence(count)},
    )


def _once(task: Task, size: int) -> Observations:
    """The whole work with chunks of one size; what an attempt with larger ones left on disk is deleted first."""
    from excavatwin.backbones.sequence.assembly import assemble
    from excavatwin.backbones.sequence.chain import chain
    from excavatwin.backbones.sequence.chunking import owners
    from excavatwin.backbones.sequence.store import disk

    for file in task.scratch.glob("*.npy"):
        file.unlink()
    plan = task.model.chunking.plan(task.count, size)
    owned = owners(plan)
    with disk(task.scratch, task.count, task.framing.shape, sum(map(len, plan)) / task.count):
        linked = chain(task, plan)
        task.progress("alignment", 0, task.count)
        closed = _closed(task, linked, owned, size)
        made = assemble(task, linked.chunks, owned, closed.frames)
    # Whether views agree with each other is for the validator of the contract, which whoever called us runs on these
    # observations; here every prediction was checked by itself, and every seam against its neighbour.
    return Observations(
        views=made.views,
        up=np.array([0.0, 0.0, 1.0]),
        metres_per_unit=made.upright.metres_per_unit,
        georeference=made.upright.georeference,
        unplaced=made.unplaced,
        doubts=(*linked.doubts, *_drift(closed, len(plan), task.model.chunking.loops), *made.doubts),
        source=_source(task, plan, closed) | {"gravity": made.upright.up_from},
    )


def _closed(task: Task, linked: Chain, owned: Sequence[range], size: int) -> Closed:
    """The frames of the chunks, with loops closed where there are any."""
    from excavatwin.backbones.sequence.chain import IMAGES
    from excavatwin.backbones.sequence.loops import Closed, close
    from excavatwin.backbones.sequence.pose_graph import chained
    from excavatwin.backbones.sequence.store import Chunk, stored

    frames = chained(linked.seams, len(linked.chunks))
    if len(frames) < 3 or not task.model.chunking.loops:
        return Closed(frames, (), 0, float("nan"), float("nan"))

    def image(photo: int) -> np.ndarray:
        return np.array(stored(task.scratch / IMAGES)[photo])

    def joint(photos: tuple[int, ...]) -> Chunk:
        return task.ask(photos, np.stack([image(photo) for photo in photos]), "joint")[0]

    return close(linked.chunks, owned, frames, linked.seams, image, joint, task.model.chunking, size)


def _drift(closed: Closed, chunks: int, wanted: int) -> tuple[str, ...]:
    """What is to be said about drift."""
    if chunks < 3:
        return ()
    if closed.loops:
        return (
            f"The {chunks} chunks had drifted: at {len(closed.loops)} places seen again they missed each other by "
            f"{closed.before:.1%} of the distance from the camera, and by {closed.after:.1%} after it was spread.",
        )
    why = f"no place seen again was proven in {closed.tried} tried pairs" if wanted else "loops were not looked for"
    return (f"{chunks} chunks were aligned one after the other and {why}: their drift is not known.",)


def _source(task: Task, plan: Sequence[range], closed: Closed) -> dict[str, str]:
    """Provenance."""
    model, (H, W) = task.model, task.framing.shape
    default = model.card.weights[0].repo if model.card.weights else "none"
    drift = f"{closed.before:.2%} of the distance before, {closed.after:.2%} after" if closed.loops else "not measured"
    return {
        "reconstructor": model.card.name,
        "weights": model.weights or default,
        "versions": model.identity(),
        "confidence": model.confidence,
        "chunks": f"{len(plan)} of {len(plan[0])} photos, at least {model.chunking.overlap(len(plan[0]))} shared",
        "lattice": f"{W} x {H} px ({model.mode})",
        "loops": f"{len(closed.loops)} of {closed.tried} pairs tried",
        "drift": drift,
    }
