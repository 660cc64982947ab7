"""Photos to observations without evidence, by whichever reconstructor the plan names; each finished step is kept."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import excavatwin
from excavatwin.backbones.protocols import Reconstructor, StagedReconstructor
from excavatwin.scene.observations import Observations
from excavatwin.scene.photo import Photo
from excavatwin.scene.progress import Progress
from excavatwin.survey import fingerprint, records
from excavatwin.survey.cache import StageCache
from excavatwin.survey.journal import Journal

#: Rooms whose code decides what a reconstructor delivers, besides its own.
_SHARED = (
    "excavatwin.backbones",
    "excavatwin.contract",
    "excavatwin.kernels",
    "excavatwin.geometry",
)


@dataclass(frozen=True)
class Workplace:
    """Where the stages of one run keep their results and tell what they do."""

    cache: StageCache
    journal: Journal
    progress: Progress


def observe(model: Reconstructor, photos: Sequence[Photo], hashes: dict[str, str], at: Workplace) -> Observations:
    """Observations whose evidence is still all zero."""
    code = fingerprint.of_code("excavatwin.capture", type(model).__module__)
    inputs: list[Any] = [
        excavatwin.__version__,
        code,
        [(photo.name, hashes[photo.name]) for photo in photos],
        model.identity(),
    ]
    if isinstance(model, StagedReconstructor):
        return _in_two_steps(model, photos, inputs, at)
    inputs += [fingerprint.of_code(*_SHARED), model]
    key = fingerprint.key(*inputs)
    with at.journal.stage("reconstruct") as row:
        obs = at.cache.load("reconstruct", key, records.read_observations)
        row["cached"] = obs is not None
        if obs is None:

            def write(part: Path) -> None:
                scratch = part / "scratch"
                scratch.mkdir()
                records.write_observations(model(photos, at.progress, scratch), part)
                shutil.rmtree(scratch)

            obs = records.read_observations(at.cache.store("reconstruct", key, write))
        row["placed"] = len(obs.views)
    return obs


def _in_two_steps(
    model: StagedReconstructor, photos: Sequence[Photo], inputs: Sequence[Any], at: Workplace
) -> Observations:
    """Poses, then dense depth."""
    loops = fingerprint.of_code("excavatwin.kernels")
    place_key, dense_key = fingerprint.key(inputs, model.placing), fingerprint.key(inputs, model, loops)
    obs = at.cache.load("densify", dense_key, records.read_observations)
    with at.journal.stage("place") as row:
        placement = None if obs else at.cache.load("place", place_key, model.load_placement)
        row["cached"] = bool(obs or placement)
        if not row["cached"]:
            placement = model.place(photos, at.progress)
            fresh = placement
            at.cache.store("place", place_key, lambda part: model.save_placement(fresh, part))
    with at.journal.stage("densify") as row:
        row["cached"] = obs is not None
        if obs is None:
            assert placement is not None
            dense = model.densify(placement, photos, at.progress)
            at.cache.store("densify", dense_key, lambda part: records.write_observations(dense, part))
            obs = dense
        row["placed"] = len(obs.views)
    return obs
