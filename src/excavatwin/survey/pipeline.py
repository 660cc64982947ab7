"""Photos or observations -> SITE: capture, reconstruct, segment, fuse, export, each finished stage remembered."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import excavatwin
from excavatwin.backbones.weights import Consent, refuse
from excavatwin.capture import Capture
from excavatwin.scene.observations import Observations
from excavatwin.scene.progress import Progress, silent
from excavatwin.scene.site import Site
from excavatwin.survey import fingerprint, memory, records
from excavatwin.survey.cache import StageCache, cache_folder, opened
from excavatwin.survey.checks import check_references, check_target
from excavatwin.survey.journal import Journal
from excavatwin.survey.observing import Workplace, observe
from excavatwin.survey.readiness import make_ready
from excavatwin.survey.segmenting import segment
from excavatwin.survey.validating import check_evidence, check_geometry

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
    consent: Consent = refuse,
    force: bool = False,
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
        consent: asked before weights are downloaded; by default nothing is ever downloaded.
        force: go on although what the backbones delivered breaks a convention.

    Raises:
        MissingExtraError: the library of a chosen backbone is not installed.
        InputError: the photos, the video or a parameter cannot be used, or weights are not on this machine.
        ObservationError: what a backbone delivered breaks a convention; the message names the mistake.
        ReconstructionError: no trustworthy geometry came out of the photos.
        OutputError: the SITE cannot be written.
    """
    source, folder = Path(source), Path(folder)
    plan = _plan(plan, references)
    check_target(folder)
    journal = Journal()
    terms = make_ready((plan.reconstructor, *plan.segmenters.values()), consent)
    with opened(cache_folder(folder)) as cache:
        if fresh:
            cache.clear()
        found = _capture(source, plan, cache, journal, progress)
        check_references(plan.mapper.scale.references, found.photos)
        flattest = max(min(photo.width, photo.height) / max(photo.width, photo.height) for photo in found.photos)
        journal.note(*memory.check(plan.reconstructor, len(found.photos), flattest))
        hashes = fingerprint.of_files([photo.path for photo in found.photos], progress)
        at = Workplace(cache, journal, progress)
        obs = observe(plan.reconstructor, found.photos, hashes, at)
        check_geometry(obs, found.photos, plan, journal, force)
        obs = replace(obs, unplaced=(*found.skipped, *obs.unplaced))
        obs = segment(obs, found.photos, plan.segmenters, plan.merging, at)
        check_evidence(obs, plan, journal, force)
        journal.note(*cache.notes)
        facts = {"input": {"source": str(source), "files": hashes}, "config": fingerprint.plain(plan), "terms": terms}
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
    remap: Mapping[str, str] = MappingProxyType({}),
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
        remap: class -> task class where the user maps otherwise.

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
        obs = load_observations(path, force=force, mapping=mapping, remap=remap)
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
