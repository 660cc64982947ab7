"""What backbones delivered is looked at before it is fused: refused when a convention is broken, else doubts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Float32, UInt8

from excavatwin.backbones.appearance import Appearance
from excavatwin.backbones.photogrammetry import Photogrammetry
from excavatwin.backbones.protocols import Picture
from excavatwin.errors import ObservationError
from excavatwin.scene.observations import Observations
from excavatwin.scene.photo import Photo
from excavatwin.survey.journal import Journal
from excavatwin.survey.plan import Plan

#: Pictures that the witness looks at.
_LOOKED_AT = 6


class _Photos(Mapping[str, UInt8[np.ndarray, "h w 3"]]):
    """Photos by name, read when they are asked for: the validator looks at a few."""

    def __init__(self, photos: Sequence[Photo]) -> None:
        self._photos = {photo.name: photo for photo in photos}

    def __getitem__(self, name: str) -> UInt8[np.ndarray, "h w 3"]:
        from excavatwin.capture import read_photo

        return read_photo(self._photos[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self._photos)

    def __len__(self) -> int:
        return len(self._photos)


def check_geometry(obs: Observations, photos: Sequence[Photo], plan: Plan, journal: Journal, force: bool) -> None:
    """Points, cameras, lattices and confidence of a reconstructor that is not our own.

    Raises:
        ObservationError: a convention is broken; the message names the mistake.
    """
    if isinstance(plan.reconstructor, Photogrammetry) or not obs.views:
        return  # ours is held to the same checks by the tests
    _judge("validate", obs, _Photos(photos), None, journal, force)


def check_evidence(obs: Observations, plan: Plan, journal: Journal, force: bool) -> None:
    """Evidence of segmenters that are not our own: its values, its place on the picture, the meaning of its ids.

    Raises:
        ObservationError: a convention is broken; the message names the mistake.
    """
    if all(isinstance(model, Appearance) for model in plan.segmenters.values()) or not obs.views:
        return
    _judge("validate classes", obs, None, _witness(obs), journal, force)


def _witness(obs: Observations) -> dict[str, Float32[np.ndarray, "H W K"]]:
    """What colours alone say of some of the views."""
    chosen = np.unique(np.linspace(0, len(obs.views) - 1, min(_LOOKED_AT, len(obs.views))).astype(int))
    some = [obs.views[i] for i in chosen if obs.views[i].image is not None]
    return {view.name: Appearance()(Picture(np.asarray(view.image))).evidence for view in some}


def _judge(
    stage: str,
    obs: Observations,
    photos: Mapping[str, UInt8[np.ndarray, "h w 3"]] | None,
    witness: Mapping[str, Float32[np.ndarray, "H W K"]] | None,
    journal: Journal,
    force: bool,
) -> None:
    from excavatwin.contract.findings import Severity
    from excavatwin.contract.validation import validate

    with journal.stage(stage) as row:
        found = validate(obs, photos, witness)
        row["findings"] = len(found)
    refused = [finding for finding in found if finding.severity == Severity.REFUSE]
    if refused and not force:
        raise ObservationError(f"{str(refused[0]).rstrip('.')}; mend it, or go on all the same with --force.")
    journal.note(*(text[0].upper() + text[1:] for text in map(str, found)))
