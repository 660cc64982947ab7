"""Photos or observations -> SITE: capture, place, densify, segment, fuse, export, each finished stage remembered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import excavatwin
from excavatwin.backbones.protocols import Picture
from excavatwin.capture import Capture
from excavatwin.errors import InputError
from excavatwin.scene.observations import Observations, View
from excavatwin.scene.photo import Photo
from excavatwin.scene.progress import Progress, silent
from excavatwin.scene.site import Site
from excavatwin.survey import fingerprint, memory, records
from excavatwin.survey.cache import StageCache, cache_folder, opened
from excavatwin.survey.checks import check_references, check_target
from excavatwin.survey.journal import Journal

if TYPE_CHECKING:
    from excavatwin.geometry.scale import Reference
    from excavatwin.survey.plan import Plan


def map_photos(
    source: Path | str,
    folder: Path | str,
    *,
    plan: Plan | None = None,
    references: Sequence[Reference] = (),
    progress: Progress = silent,
    fresh: bool = False,
) -> Site:
    """Map a folder of photos, or a video, and write the SITE folder.

    Every finished stage is kept in a hidden folder beside the SITE: a second run repeats only what its
    parameters change, a stopped run resumes.

    Args:
        source: folder of photos (JPEG, PNG, TIFF), or a video file.
        folder: SITE folder; an earlier SITE there is replaced once the new one is complete.
        plan: the stages with their parameters.
        references: known distances between two pixels of a photo [m].
        progress: told which stage is at work.
        fresh: forget all cached stages first.

    Raises:
        InputError: the photos, the video or a parameter cannot be used.
        ReconstructionError: no trustworthy geometry came out of the photos.
        OutputError: the SITE cannot be written.
    """
    source, folder = Path(source), Path(folder)
    plan = _plan(plan, references)
    check_target(folder)
    journal = Journal()
    with opened(cache_folder(folder)) as cache:
        if fresh:
            cache.clear()
        found = _capture(source, plan, cache, journal, progress)
        check_references(plan.mapper.scale.references, found.photos)
        flattest = max(min(photo.width, photo.height) / max(photo.width, photo.height) for photo in found.photos)
        journal.note(*memory.check(len(found.photos), plan.photogrammetry.lattice, flattest))
        hashes = fingerprint.of_files([photo.path for photo in found.photos], progress)
        obs = _observe(found.photos, hashes, plan, cache, journal, progress)
        obs = replace(obs, unplaced=(*found.skipped, *obs.unplaced))
        obs = _segment(obs, plan, cache, journal, progress)
        journal.note(*cache.notes)
        facts = {"input": {"source": str(source), "files": hashes}, "config": fingerprint.plain(plan)}
        return _fuse(obs, folder, plan, journal, progress, facts)


def fuse_observations(
    path: Path | str,
    folder: Path | str,
    *,
    plan: Plan | None = None,
    references: Sequence[Reference] = (),
    progress: Progress = silent,
    force: bool = False,
    mapping: Path | str | None = None,
) -> Site:
    """Fuse an observations file (``.npz``) or folder that anybody's models made, and write the SITE folder.

    Args:
        path: observations, see ``exchange.load_observations``.
        folder: SITE folder; an earlier SITE there is replaced once the new one is complete.
        plan: the stages with their parameters; only its mapper is used.
        references: known distances between two pixels of a view [m].
        progress: told which stage is at work.
        force: go on although the points do not reproject onto their own pixels.
        mapping: class mapping for labels in another vocabulary, see ``exchange.load_observations``.

    Raises:
        ObservationError: the file breaks its contract; the message names the first thing that is wrong.
        OutputError: the SITE cannot be written.
    """
    from excavatwin.exchange import load_observations

    path, folder = Path(path), Path(folder)
    plan = _plan(plan, references)
    check_target(folder)
    journal = Journal()
    with journal.stage("load") as row:
        progress("load", 0, 1)
        obs = load_observations(path, force=force, mapping=mapping)
        row["views"] = len(obs.views)
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    hashes = fingerprint.of_files([file for file in files if file.is_file()])
    facts = {
        "input": {"source": str(path), "files": hashes},
        "config": {"mapper": fingerprint.plain(plan.mapper)},
    }
    return _fuse(obs, folder, plan, journal, progress, facts)


def _plan(plan: Plan | None, references: Sequence[Reference]) -> Plan:
    if plan is None:
        from excavatwin.survey.plan import Plan

        plan = Plan()
    if references:
        scale = replace(plan.mapper.scale, references=tuple(references))
        plan = replace(plan, mapper=replace(plan.mapper, scale=scale))
    return plan


def _capture(source: Path, plan: Plan, cache: StageCache, journal: Journal, progress: Progress) -> Capture:
    """The photos of a folder, or the chosen frames of a video (cached)."""
    from excavatwin.capture import open_capture

    with journal.stage("capture") as row:
        if source.is_dir():
            found = open_capture(source, progress=progress)
        else:
            content = fingerprint.of_files([source], progress) if source.exists() else {}
            code = fingerprint.of_code("excavatwin.capture")
            key = fingerprint.key(excavatwin.__version__, code, content, plan.video)
            cached = cache.load("capture", key, records.read_capture)
            row["cached"] = cached is not None

            def write(part: Path) -> None:
                frames = open_capture(source, frames_dir=part, progress=progress, sampling=plan.video)
                records.write_capture(frames, part)

            found = cached or records.read_capture(cache.store("capture", key, write))
        row["photos"] = len(found.photos)
    return found


def _observe(
    photos: Sequence[Photo], hashes: dict[str, str], plan: Plan, cache: StageCache, journal: Journal, progress: Progress
) -> Observations:
    """Poses, then dense depth; observations with evidence still all zero."""
    model = plan.photogrammetry
    code = fingerprint.of_code("excavatwin.capture", type(model).__module__)
    inputs = [excavatwin.__version__, code, [(photo.name, hashes[photo.name]) for photo in photos]]
    loops = fingerprint.of_code("excavatwin.kernels")
    place_key, dense_key = fingerprint.key(inputs, model.placing), fingerprint.key(inputs, model, loops)
    obs = cache.load("densify", dense_key, records.read_observations)
    with journal.stage("place") as row:
        placement = None if obs else cache.load("place", place_key, model.load_placement)
        row["cached"] = bool(obs or placement)
        if not row["cached"]:
            placement = model.place(photos, progress)
            fresh = placement
            cache.store("place", place_key, lambda part: model.save_placement(fresh, part))
    with journal.stage("densify") as row:
        row["cached"] = obs is not None
        if obs is None:
            assert placement is not None
            dense = model.densify(placement, photos, progress)
            cache.store("densify", dense_key, lambda part: records.write_observations(dense, part))
            obs = dense
        row["placed"] = len(obs.views)
    return obs


def _segment(obs: Observations, plan: Plan, cache: StageCache, journal: Journal, progress: Progress) -> Observations:
    """Evidence for every view, cached photo by photo; sky and water lose their points."""
    model = plan.appearance
    code = fingerprint.of_code(type(model).__module__)
    stage = f"segment/{fingerprint.key(excavatwin.__version__, code, model)}"
    views = []
    with journal.stage("segment") as row:
        row["cached"] = 0
        for done, view in enumerate(obs.views):
            progress("segment", done, len(obs.views))
            segmented, hit = _segment_view(view, model, cache, stage)
            views.append(segmented)
            row["cached"] += hit
        progress("segment", len(obs.views), len(obs.views))
        row["photos"] = len(views)
        cache.prune("segment")
    source = {**obs.source, "segmenter": type(model).__name__.lower()}
    return replace(obs, views=tuple(views), source=source)


def _segment_view(view: View, model: Any, cache: StageCache, stage: str) -> tuple[View, bool]:
    if view.image is None:
        raise InputError(
            f"view {view.name} has no image to segment; give observations with evidence to `fuse` instead."
        )
    key = fingerprint.of_array(view.image)
    found = cache.load(stage, key, records.read_segmentation)
    hit = found is not None
    if found is None:
        result = model(Picture(view.image, view.name, view.lattice))
        found = result.evidence, result.no_surface
        evidence, no_surface = found
        cache.store(stage, key, lambda part: records.write_segmentation(evidence, no_surface, part), keep=None)
    evidence, no_surface = found
    points = np.where(no_surface[..., None], np.float32(np.nan), view.points)
    confidence = np.where(no_surface, np.float32(0), view.confidence)
    return replace(view, points=points, confidence=confidence, evidence=evidence), hit


def _fuse(
    obs: Observations,
    folder: Path,
    plan: Plan,
    journal: Journal,
    progress: Progress,
    facts: dict[str, Any],
) -> Site:
    """The method, then the SITE folder; ``run.json`` is written with it, so its export time is the one before it."""
    from excavatwin.export import write_site

    with journal.stage("fuse"):
        site = plan.mapper(obs, progress)
    journal.note(*obs.doubts, *site.map.doubts)
    facts = facts | {"source": dict(obs.source)}
    photos = {
        "found": len(obs.views) + len(obs.unplaced),
        "placed": len(obs.views),
        "unplaced": [asdict(one) for one in obs.unplaced],
    }
    site = replace(site, run={**site.run, **journal.report(**facts, photos=photos)})
    progress("export", 0, 1)
    with journal.stage("export"):
        write_site(site, folder)
    progress("export", 1, 1)
    return replace(site, run={**site.run, **journal.report(**facts, photos=photos)})
