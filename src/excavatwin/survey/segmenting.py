"""Evidence for every view from one segmenter or several, kept view by view: a stopped run goes on where it was."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import excavatwin
from excavatwin.backbones.merging import Merging
from excavatwin.backbones.protocols import Picture, Segmentation, Segmenter
from excavatwin.errors import InputError
from excavatwin.scene.observations import Observations, View
from excavatwin.scene.photo import Photo
from excavatwin.survey import fingerprint, records
from excavatwin.survey.cache import StageCache
from excavatwin.survey.observing import Workplace


def segment(
    obs: Observations,
    photos: Sequence[Photo],
    segmenters: Mapping[str, Segmenter],
    merging: Merging,
    at: Workplace,
) -> Observations:
    """The observations with evidence; sky and water lose their points."""
    paths = {photo.name: photo.path for photo in photos}
    seen: list[dict[str, Segmentation]] = [{} for _ in obs.views]
    doubts: Counter[str] = Counter()
    done, total = 0, len(obs.views) * len(segmenters)
    with at.journal.stage("segment") as row:
        row["cached"] = 0
        for name, model in segmenters.items():  # one after the other: networks need not be in memory together
            stage = _stage(model)
            for view, of_view in zip(obs.views, seen, strict=True):
                at.progress("segment", done, total)
                of_view[name], hit = _one(_picture(view, paths), model, at.cache, stage)
                row["cached"] += hit
                done += 1
                doubts.update(f"Segmenter {name}: {sentence}" for sentence in of_view[name].doubts)
            if not any(of_view[name].evidence.any() for of_view in seen):
                at.journal.note(f"Segmenter {name} gave no evidence for any of the {len(seen)} photos.")
        views = tuple(_given(view, merging(of_view)) for view, of_view in zip(obs.views, seen, strict=True))
        at.progress("segment", total, total)
        row["photos"] = total
        at.cache.prune("segment", 2 * len(segmenters))
    at.journal.note(*(f"{text} ({n} of {len(views)} photos)" for text, n in sorted(doubts.items())))
    source = obs.source | {"segmenter": " + ".join(segmenters)}
    return replace(obs, views=views, source=source)


def _stage(model: Segmenter) -> str:
    code = fingerprint.of_code("excavatwin.backbones", "excavatwin.vocabularies", type(model).__module__)
    return f"segment/{fingerprint.key(excavatwin.__version__, code, model.identity(), model)}"


def _picture(view: View, paths: Mapping[str, Path]) -> Picture:
    if view.image is None:
        raise InputError(
            f"view {view.name} has no image to segment; give observations with evidence to `fuse` instead."
        )
    return Picture(view.image, view.name, view.lattice, paths.get(view.name))


def _one(picture: Picture, model: Segmenter, cache: StageCache, stage: str) -> tuple[Segmentation, bool]:
    where = () if picture.lattice is None else (picture.lattice.affine, picture.lattice.distortion)
    key = fingerprint.key(fingerprint.of_array(picture.image), picture.name, where)
    found = cache.load(stage, key, records.read_segmentation)
    if found is not None:
        return found, True
    fresh = model(picture)
    cache.store(stage, key, lambda part: records.write_segmentation(fresh, part), keep=None)
    return fresh, False


def _given(view: View, seen: Segmentation) -> View:
    points, confidence = view.points, view.confidence
    if seen.no_surface.any():
        points = np.where(seen.no_surface[..., None], np.float32(np.nan), points)
        confidence = np.where(seen.no_surface, np.float32(0), confidence)
    return replace(view, points=points, confidence=confidence, evidence=seen.evidence)
