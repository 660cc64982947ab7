"""Every site of a data set against its truth: ``excavatwin evaluate DATASET``.

Where a recording of a simulated data set has no SITE yet, its photos are mapped first; a site of which no map could be
made is scored as an empty map, not left out. What is over several sequences has a bootstrap interval over them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from excavatwin.errors import ExcavatwinError, InputError, OutputError
from excavatwin.evaluation import dimensions
from excavatwin.evaluation.bootstrap import bootstrap, over_sequences
from excavatwin.evaluation.metric import Metric
from excavatwin.evaluation.published import with_paper
from excavatwin.evaluation.scores import Scores
from excavatwin.evaluation.semantics import TASK_POLICY, intersection_over_union, mean_over
from excavatwin.evaluation.series import change_metrics, final_terrain_metrics, update_interval_metrics
from excavatwin.evaluation.volume import Volumes
from excavatwin.scene.progress import Progress, silent
from excavatwin.scene.recording import Dataset, Recording
from excavatwin.studies.recording_scores import Scored, score_recorded, score_simulated, score_unmapped
from excavatwin.studies.site_evaluation import Scoring

if TYPE_CHECKING:
    from excavatwin.survey.plan import Plan

SHOWN = 3
"""Names that a sentence lists before "..."."""


@dataclass(frozen=True)
class Place:
    """Sequence and epoch of a recording."""

    sequence: str
    epoch: str

    @classmethod
    def of(cls, name: str) -> Place:
        """``"site_200/epoch_00"`` has an epoch; ``"bike/batch-1/0"`` has none."""
        sequence, _, last = name.rpartition("/")
        return cls(sequence, last) if last.startswith("epoch") else cls(name, "")


def evaluate_folder(
    folder: Path,
    sites: Path,
    scoring: Scoring,
    *,
    plan: Plan | None = None,
    progress: Progress = silent,
    map_missing: bool = True,
) -> Scores:
    """Score the data set in a folder.

    Raises:
        InputError: the folder holds none that is known, or there is nothing to score.
        OutputError: a SITE cannot be written.
    """
    from excavatwin.datasets import open_dataset

    return evaluate_dataset(open_dataset(folder), sites, scoring, plan=plan, progress=progress, map_missing=map_missing)


def evaluate_dataset(
    dataset: Dataset,
    sites: Path,
    scoring: Scoring,
    *,
    plan: Plan | None = None,
    progress: Progress = silent,
    map_missing: bool = True,
) -> Scores:
    """Score the sites of a data set: ``sites/<recording>`` is the SITE of a recording.

    Args:
        plan: stages for the sites that have to be mapped.
        map_missing: map simulated recordings without a SITE; finished ones are kept, an interrupted run resumes.

    Raises:
        InputError: there is nothing to score, or a SITE and its recording do not belong together.
        OutputError: a SITE cannot be written.
    """
    scored: list[Scored] = []
    mappable = map_missing and simulated(dataset)
    without = [name for name in dataset.names if not (sites / name / "map.nc").is_file()]
    names = [name for name in dataset.names if mappable or name not in without]
    for done, name in enumerate(names):
        progress("evaluate", done, len(names))
        recording = dataset.recording(name)
        failure = mapped(recording, sites / name, plan, progress) if name in without else ""
        scored.append(one(recording, dataset, sites / name, failure, scoring))
    progress("evaluate", len(names), len(names))
    if not scored:
        raise InputError(nothing_to_score(dataset, sites, map_missing))
    scored = with_series(scored, dataset)
    rows = [with_paper(one.row.metrics, dataset.name, scoring.segmenter) for one in scored]
    policy = scored[0].policy
    return Scores(
        subject=f"{dataset.name} in {dataset.folders[0]}",
        settings=scoring.settings(policy) | {"sites": str(sites)},
        rows=tuple(replace(one.row, metrics=metrics) for one, metrics in zip(scored, rows, strict=True)),
        summary=with_paper(summary(scored, scoring.seed), dataset.name, scoring.segmenter),
        notes=notes(dataset, scored, [] if mappable else without),
    )


def simulated(dataset: Dataset) -> bool:
    """Whether its recordings come with exact truth and folders of photos, as those of the OCES layout do."""
    if not dataset.names:
        return False
    first = dataset.recording(dataset.names[0])
    return first.truth is not None and first.photos is not None


def mapped(recording: Recording, site: Path, plan: Plan | None, progress: Progress) -> str:
    """Map a recording's photos into its SITE; why that was impossible, or nothing."""
    from excavatwin.survey import map_photos

    assert recording.photos is not None

    def told(stage: str, done: int, total: int) -> None:
        progress(f"{recording.name}: {stage}", done, total)

    try:
        map_photos(recording.photos, site, plan=plan, progress=told)
    except OutputError:
        raise  # the disk, not the method
    except ExcavatwinError as error:
        return " ".join(str(error).split())
    return ""


def one(recording: Recording, dataset: Dataset, site: Path, failure: str, scoring: Scoring) -> Scored:
    """One recording, scored."""
    place = Place.of(recording.name)
    if failure:
        return score_unmapped(recording, place.sequence, place.epoch, failure)
    if recording.truth is not None:
        return score_simulated(recording, site, place.sequence, place.epoch, scoring)
    return score_recorded(recording, dataset, site, place.sequence, place.epoch, scoring)


def with_series(scored: Sequence[Scored], dataset: Dataset) -> list[Scored]:
    """Volumes between successive epochs, and what is said of a series, with the later or last epoch of a sequence."""
    stated = {(change.before, change.after): change for change in dataset.changes}
    result: list[Scored] = []
    for i, after in enumerate(scored):
        before = scored[i - 1] if i and scored[i - 1].row.sequence == after.row.sequence else None
        extra: list[Metric] = []
        if before and before.survey and after.survey and before.truth and after.truth:
            change = stated.get((before.name, after.name))
            known = Volumes(change.cut, change.fill, 0.0, 0.0) if change else None
            extra += change_metrics(before.survey, after.survey, (before.truth, after.truth), known)
        last = i + 1 == len(scored) or scored[i + 1].row.sequence != after.row.sequence
        if last and before:
            series = [other for other in scored if other.row.sequence == after.row.sequence]
            extra += final_terrain_metrics([other.row.metrics for other in series])
            times = [other.time for other in series if other.time is not None]
            if len(times) == len(series) and (np.diff(times) > 0).all():
                extra += update_interval_metrics(times)
        result.append(replace(after, row=replace(after.row, metrics=(*after.row.metrics, *extra))))
    return result


def summary(scored: Sequence[Scored], seed: int = 0) -> tuple[Metric, ...]:
    """Means over sequences, mIoU of all pixels together, dimensions under every protocol, share of sites mapped."""
    sequences = list(dict.fromkeys(one.row.sequence for one in scored))
    tables = {s: [shared(one.row.metrics) for one in scored if one.row.sequence == s] for s in sequences}
    failed = sum(bool(one.row.failure) for one in scored)
    return (
        Metric("sites_mapped", 100 * (1 - failed / len(scored)), "%", f"of {len(scored)} sites a map could be made"),
        *over_sequences(tables, seed),
        *pooled(scored, sequences, seed),
        *protocols(scored),
    )


def shared(metrics: Sequence[Metric]) -> list[Metric]:
    """Metrics that mean the same in every sequence: not those of one numbered object."""
    return [m for m in metrics if not m.name.removeprefix("object_")[:1].isdigit()]


def pooled(scored: Sequence[Scored], sequences: Sequence[str], seed: int) -> tuple[Metric, ...]:
    """Strict mIoU of the photos' pixels of all sequences counted together: how benchmarks state it."""
    counts = [sum(o.counts for o in scored if o.row.sequence == s and o.counts is not None) for s in sequences]
    arrays = [np.asarray(c) for c in counts if not isinstance(c, int)]
    if not arrays:
        return ()

    def miou(chosen: Sequence[np.ndarray]) -> float:
        total = np.sum(chosen, axis=0)
        return 100 * mean_over(intersection_over_union(total), total.sum(1) > 0)

    interval = bootstrap(arrays, miou, seed)
    low, high = (v if np.isfinite(v) else None for v in (interval.low, interval.high))
    meaning = f"strict mean IoU of all sequences' pixels counted together, policy {scored[0].policy!r}"
    return (Metric("photo_miou_pooled", interval.value, "%", meaning, None, low, high),)


def protocols(scored: Sequence[Scored]) -> tuple[Metric, ...]:
    """Object dimensions under every protocol for which there is a scale."""
    objects = [o for one in scored for o in one.objects]
    if not objects:
        return ()
    cameras = {one.name: one.camera_scale for one in scored if one.camera_scale is not None}
    declared = {one.name: 1.0 for one in scored if one.survey is not None and one.survey.map.metric}
    estimates = [
        dimensions.camera_baseline(objects, cameras),
        dimensions.one_dimension(objects),
        dimensions.class_mean_ratio(objects),
        dimensions.other_object(objects),
        dimensions.metric_backbone(objects, declared),
    ]
    return tuple(metric for e in estimates for metric in dimensions.dimension_metrics(e, objects))


def notes(dataset: Dataset, scored: Sequence[Scored], without: Sequence[str]) -> tuple[str, ...]:
    """What is not in the figures, and what to doubt."""
    told = [f"{some(without)} of {dataset.name} without a SITE: not scored."] if without else []
    if len({one.row.sequence for one in scored}) == 1:
        told.append("there is one sequence only, which tells nothing about the next: no figure has an interval.")
    told += [f"{bad.what} is left out: {bad.reason}." for bad in dataset.excluded]
    told += [f"{one.name}: {doubt}" for one in scored for doubt in one.doubts]
    return tuple(dict.fromkeys(told))


def some(names: Sequence[str]) -> str:
    """``"4 recordings (a, b, c, ...)"``."""
    noun = "recording" if len(names) == 1 else "recordings"
    return f"{len(names)} {noun} ({', '.join(names[:SHOWN])}{', ...' if len(names) > SHOWN else ''})"


def nothing_to_score(dataset: Dataset, sites: Path, map_missing: bool) -> str:
    """What is missing, and what to do."""
    name = dataset.names[0] if dataset.names else "NAME"
    if simulated(dataset) and not map_missing:
        return (
            f"{sites} holds no SITE of {dataset.name} (such as {sites / name}); map them with `excavatwin evaluate "
            f"{dataset.folders[0]} --sites {sites}`."
        )
    return (
        f"{sites} holds no SITE of {dataset.name}; map photos of a recording first, such as "
        f"`excavatwin map PHOTOS -o {sites / name}`, and give --sites {sites}."
    )


__all__ = ["TASK_POLICY", "Place", "Scoring", "evaluate_dataset", "evaluate_folder"]
