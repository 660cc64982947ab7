"""Rows about what a reconstructor delivers: the contract of every view, the validator, names, provenance."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from excavatwin.backbones.conformance import validating
from excavatwin.backbones.conformance.report import Row, failed, judged, passed, unchecked
from excavatwin.capture import read_photo
from excavatwin.contract import checks
from excavatwin.contract.findings import Finding, Severity
from excavatwin.contract.reprojection import REPORTED, reprojection
from excavatwin.errors import ExcavatwinError, ObservationError
from excavatwin.scene.observations import Observations, View
from excavatwin.scene.photo import Photo
from excavatwin.scene.taxonomy import K

#: Longer side at which photos are compared with pictures [px].
LOOK = 1024
ROWS = (
    "output contract",
    "no evidence of its own",
    "points on their pixels",
    "validated",
    "lattice in the photo",
    "names",
    "provenance",
)


def observation_rows(observations: Observations, photos: Sequence[Photo]) -> tuple[Row, ...]:
    """Everything that can be said about one result."""
    wrong = contract_mistake(observations)
    if wrong:
        rest = (unchecked(name, "the output breaks the contract.") for name in ROWS[1:5])
        return (failed(ROWS[0], wrong), *rest, *_bookkeeping(observations, photos))
    views = observations.views
    evident = [view.name for view in views if view.evidence.any()]
    return (
        passed(ROWS[0], f"{len(views)} views of {len(photos)} photos"),
        judged(ROWS[1], (f"{name} has evidence, which segmenters give; leave it zero" for name in evident[:1])),
        _reprojected(views),
        of_findings(ROWS[3], validating.of_geometry(observations)),
        _lattices(observations, photos),
        *_bookkeeping(observations, photos),
    )


def contract_mistake(observations: Any) -> str:
    """The first thing that breaks the contract of shapes, types and values, as a sentence; empty when nothing does."""
    if not isinstance(observations, Observations):
        return f"it gave {type(observations).__name__}; expected Observations."
    if not observations.views:
        return "there is no view; raise a ReconstructionError when nothing could be placed."
    try:
        if observations.up is not None:
            checks.checked_up(observations.up)
        checks.checked_scale(np.nan if observations.metres_per_unit is None else observations.metres_per_unit)
        for view in observations.views:
            _check_view(view)
    except ObservationError as error:
        return str(error)
    return ""


def of_findings(name: str, findings: Iterable[Finding]) -> Row:
    """Refusals fail, reports are told."""
    said = list(findings)
    refused = [str(one) for one in said if one.severity == Severity.REFUSE]
    return failed(name, " ".join(refused)) if refused else passed(name, " ".join(f"Told: {one}" for one in said))


def _check_view(view: View) -> None:
    where = f"view {view.name}"
    layers: tuple[tuple[str, Any, type], ...] = (
        ("points", view.points, np.float32),
        ("confidence", view.confidence, np.float32),
        ("evidence", view.evidence, np.float32),
        ("T_R_cam", view.T_R_cam, np.float64),
        ("K_cam", view.K_cam, np.float64),
    )
    for key, array, dtype in layers:
        if not isinstance(array, np.ndarray) or array.dtype != dtype:
            found = getattr(array, "dtype", type(array).__name__)
            raise ObservationError(f"{where}: {key} is {found}; expected a NumPy array of {np.dtype(dtype)}.")
    points = checks.checked_points(view.points, where)
    checks.checked_layer(view.confidence, "confidence", points, where)
    checks.checked_layer(view.evidence, "evidence", points, where, channels=K)
    T = checks.checked_pose(view.T_R_cam, where)
    checks.check_precision(points, T[:3, 3], where)
    checks.checked_intrinsics(view.K_cam, view.shape, where)
    if view.image is not None:
        checks.checked_image(view.image, view.shape, where)
    if not np.isfinite(points).any():
        raise ObservationError(f"{where}: it has no point; leave the photo out and name it among the unplaced.")
    if view.lattice is not None:
        affine = np.asarray(view.lattice.affine)
        if affine.shape != (2, 3) or not np.isfinite(affine).all() or np.linalg.det(affine[:, :2]) <= 0:
            raise ObservationError(
                f"{where}: the affine of the lattice is {affine.tolist()}; expected (2, 3), upright."
            )


def _reprojected(views: Sequence[View]) -> Row:
    worst, mistakes = 0.0, Counter[str]()
    for view in views:
        found = reprojection(view.points, view.T_R_cam, view.K_cam)
        if found is None:
            continue
        worst = max(worst, found.median)
        if found.median > REPORTED:
            mistakes[found.cause or "no usual mistake explains it"] += 1
    said = (f"in {n} of {len(views)} views points miss their own pixels: {cause}" for cause, n in mistakes.items())
    return judged(ROWS[2], said, f"median miss at most {worst:.2g} px")


def _lattices(observations: Observations, photos: Sequence[Photo]) -> Row:
    if all(view.image is None for view in observations.views):
        return unchecked(ROWS[4], "no view has an image; give each its RGB on the lattice, segmenters need it.")
    of_name = {photo.name: photo for photo in photos}
    looked = {}
    for view in observations.views:
        try:
            looked[view.name] = read_photo(of_name[view.name], LOOK)
        except (KeyError, ExcavatwinError):
            continue
    return of_findings(ROWS[4], validating.of_pictures(observations, looked))


def _bookkeeping(observations: Any, photos: Sequence[Photo]) -> tuple[Row, ...]:
    if not isinstance(observations, Observations):
        return tuple(unchecked(name, "there are no observations.") for name in ROWS[5:])
    mistakes = _name_mistakes(observations, [photo.name for photo in photos])
    return judged(ROWS[5], mistakes), judged(ROWS[6], _source_mistakes(observations))


def _name_mistakes(observations: Observations, known: Sequence[str]) -> Iterator[str]:
    views, unplaced = [view.name for view in observations.views], [one.name for one in observations.unplaced]
    for name, times in Counter([*views, *unplaced]).items():
        if times > 1:
            yield f"{name} appears {times} times among views and unplaced photos"
    strange = sorted({*views, *unplaced} - set(known))
    if strange:
        yield f"{', '.join(strange[:3])} is none of the photos' names"
    lost = sorted(set(known) - {*views, *unplaced})
    if lost:
        yield f"{', '.join(lost[:3])} is neither a view nor unplaced: photos must not get lost silently"
    yield from (f"{one.name} is unplaced without a reason" for one in observations.unplaced if not one.reason.strip())


def _source_mistakes(observations: Observations) -> Iterator[str]:
    if not observations.source.get("reconstructor"):
        yield 'source lacks "reconstructor", the name of who made this'
    if not observations.source.get("confidence"):
        yield 'source lacks "confidence", the kind of its numbers, such as "1 + exp", "sigmoid" or "photos that agree"'
