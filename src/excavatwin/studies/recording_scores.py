"""The scores of one recording of a data set, simulated or recorded, mapped or not."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Int64

from excavatwin.datasets import ElevationProtocol
from excavatwin.errors import InputError
from excavatwin.evaluation.alignment import Alignment, align, common_cameras
from excavatwin.evaluation.dimensions import MeasuredObject, camera_scale
from excavatwin.evaluation.elevation import elevation_metrics
from excavatwin.evaluation.metric import Metric
from excavatwin.evaluation.objects import match
from excavatwin.evaluation.reference import in_frame_of, terrain_truth
from excavatwin.evaluation.scores import Row
from excavatwin.evaluation.semantics import TASK_POLICY, map_curve, photo_confusion
from excavatwin.evaluation.site import photo_metrics, read_site, score, unmapped_metrics
from excavatwin.evaluation.truth_file import load_truth
from excavatwin.evaluation.volume import Survey
from excavatwin.scene.elevation_map import MapObject
from excavatwin.scene.recording import Dataset, Recording
from excavatwin.scene.truth import Truth
from excavatwin.studies.recorded_truth import frames_by_photo, measured_objects, photos_of, recorded_truth
from excavatwin.studies.site_evaluation import Scoring, doubts
from excavatwin.vocabularies import read_vocabulary


@dataclass(frozen=True, eq=False)
class Scored:
    """One site with what the summary of its data set needs."""

    name: str
    """Of the recording."""
    row: Row
    policy: str
    survey: Survey | None = None
    """The map in its place, for volumes."""
    truth: Truth | None = None
    counts: Int64[np.ndarray, "K K+1"] | None = None
    """Confusion of the photos' pixels."""
    objects: tuple[MeasuredObject, ...] = ()
    camera_scale: float | None = None
    """Metres per unit of the map by its cameras (P1)."""
    time: float | None = None
    """When it was recorded [s]."""
    doubts: tuple[str, ...] = ()


def score_unmapped(recording: Recording, sequence: str, epoch: str, failure: str) -> Scored:
    """A recording of which no map could be made."""
    assert recording.truth is not None
    truth = load_truth(recording.truth)
    row = Row(sequence, epoch, unmapped_metrics(truth), failure)
    counts = photo_confusion((), truth)
    return Scored(recording.name, row, TASK_POLICY, truth=truth, counts=counts, time=recording.time)


def score_simulated(recording: Recording, site: Path, sequence: str, epoch: str, scoring: Scoring) -> Scored:
    """Against the exact truth.

    Raises:
        InputError: the SITE was made from other photos, or cannot be aligned.
    """
    assert recording.truth is not None
    truth = load_truth(recording.truth)
    m, views = read_site(site)
    if truth.views:
        check_photos(site, [view.name for view in truth.views], recording.name)
    alignment = align(m, views, truth, scoring.way)
    elevation = lidar(recording, truth) if scoring.reference == "lidar" else None
    metrics = (*score(m, views, truth, alignment, elevation), *timing(site))
    pairs = common_cameras(views, truth)
    scale = camera_scale(*(np.array(side) for side in zip(*pairs, strict=True))) if len(pairs) >= 3 else None
    row = Row(sequence, epoch, metrics, curve=map_curve(m, truth, alignment).thinned())
    moved = [alignment.moved(o) for o in m.objects]
    return Scored(
        recording.name, row, TASK_POLICY, Survey(m, alignment), truth, photo_confusion(views, truth),
        matched(moved, truth, recording, sequence), scale, recording.time, doubts(metrics, alignment),
    )  # fmt: skip


def score_recorded(
    recording: Recording, dataset: Dataset, site: Path, sequence: str, epoch: str, scoring: Scoring
) -> Scored:
    """Against labels, scanner heights and measured objects, whichever the recording has.

    Raises:
        InputError: the SITE was not made from photos of the recording, or nothing of it is known to score.
    """
    m, views = read_site(site)
    frames = frames_by_photo(recording, photos_of(site))
    check_photos(site, list(frames), recording.name)
    truth = recorded_truth(recording, frames, scoring.policy)
    policy = read_vocabulary(recording.vocabulary, scoring.policy).policy if recording.vocabulary else TASK_POLICY
    metrics: list[Metric] = [*photo_metrics(views, truth, policy)] if any(f.label for f in frames.values()) else []
    survey, told = None, []
    heights = truth if recording.elevation else scanner_heights(recording, dataset, truth, list(frames))
    if heights is not None:
        try:
            alignment = align(m, views, heights, "cameras" if scoring.way == "auto" else scoring.way)
            metrics += elevation_metrics(m, heights, alignment)
            survey = Survey(m, alignment)
        except InputError as error:
            told.append(f"its elevation is not scored: {error}")
    objects: list[MeasuredObject] = []
    scale = None
    if recording.objects:
        objects, scale = measured_objects(recording, views, truth, m.objects, sequence)
        told += [] if objects else ["no object of the map lies where the recording's objects are."]
        survey = survey or Survey(m, Alignment("cameras", 0.0, np.zeros(3)))
    if not metrics and not objects:
        raise InputError(f"{recording.name} has no labels, heights or measured objects for the photos of {site}.")
    counts = photo_confusion(views, truth) if metrics else None
    row = Row(sequence, epoch, tuple(metrics))
    return Scored(recording.name, row, policy, survey, None, counts, tuple(objects), scale, doubts=tuple(told))


def check_photos(site: Path, known: Sequence[str], name: str) -> None:
    """Whether a SITE was made from photos of a recording.

    Raises:
        InputError: not one of its photos is known there.
    """
    photos = photos_of(site)
    if not set(photos) & set(known):
        raise InputError(f"{site} was not made from photos of {name}: it has {photos[0] if photos else 'none'}.")


def lidar(recording: Recording, truth: Truth) -> Truth:
    """The recording's elevation reference in the truth's frame.

    Raises:
        InputError: it has none.
    """
    if recording.elevation is None:
        raise InputError(f"{recording.name} holds no elevation.tif, which --reference lidar needs.")
    reference = recording.elevation()
    return in_frame_of(terrain_truth(reference.grid, reference.height, recording.georeference), truth)


def scanner_heights(recording: Recording, dataset: Dataset, truth: Truth, photos: Sequence[str]) -> Truth | None:
    """RELLIS-3D: terrain from the labelled scans around the middle photo of the SITE; None for other data sets."""
    if dataset.name != "rellis-3d" or not photos:
        return None
    frames = frames_by_photo(recording, photos)
    usable = {scan.name for scan in recording.scans if scan.labelled and scan.T_W_L is not None}
    placed = [frame for frame in frames.values() if frame.T_W_cam is not None and frame.scan in usable]
    if not placed:
        return None
    times = [frame.time for frame in placed if frame.time is not None]
    span = (max(times) - min(times)) / 2 if times else 0.0
    protocol = ElevationProtocol(half_window=max(ElevationProtocol().half_window, span))
    reference = protocol(recording, placed[len(placed) // 2])
    return replace(terrain_truth(reference.grid, reference.height), views=truth.views)


def matched(
    mapped: Sequence[MapObject], truth: Truth, recording: Recording, sequence: str
) -> tuple[MeasuredObject, ...]:
    """Objects of the map, in the truth's frame, that are true ones, with the recording's category of each."""
    category = {known.object_id: known.category for known in recording.objects}
    return tuple(
        MeasuredObject(
            sequence,
            category.get(truth.objects[j].object_id, truth.names[j] if j < len(truth.names) else "object"),
            mapped[i].size,
            truth.objects[j].size,
            recording.name,
        )
        for i, j, _ in match(mapped, truth.objects, np.zeros(3))
        if min(mapped[i].size) > 0
    )


def timing(site: Path) -> tuple[Metric, ...]:
    """How long the map took, when no stage of it came from the cache."""
    path = site / "run.json"
    if not path.is_file():
        return ()
    run = json.loads(path.read_text("utf-8"))
    stages = run.get("stages", {})
    if any(row.get("cached") for row in stages.values()) or not isinstance(run.get("seconds"), int | float):
        return ()
    return (Metric("map_seconds", float(run["seconds"]), "s", "photos to map, nothing from the cache"),)
