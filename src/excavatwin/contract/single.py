"""The contract of single views as findings: equal mistakes of several views become one."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from excavatwin.contract.checks import (
    check_precision,
    checked_image,
    checked_intrinsics,
    checked_layer,
    checked_points,
    checked_pose,
)
from excavatwin.contract.findings import Finding, named, refusal, report
from excavatwin.contract.reprojection import REFUSED, REPORTED, Reprojection, reprojection
from excavatwin.errors import ObservationError
from excavatwin.scene.observations import View
from excavatwin.scene.taxonomy import K


def contract(views: Sequence[View]) -> tuple[list[View], tuple[Finding, ...]]:
    """The views that keep the contract, and what is wrong with the others."""
    kept: list[View] = []
    wrong: dict[str, list[tuple[View, str]]] = {}
    for view in views:
        broken = _first_mistake(view)
        if broken is None:
            kept.append(view)
        else:
            check, said = broken
            wrong.setdefault(check, []).append((view, said))
    findings = []
    for cases in wrong.values():
        view, said = cases[0]
        others = f" (and {len(cases) - 1} more of {len(views)} views)" if len(cases) > 1 else ""
        findings.append(refusal(f"view {view.name!r}{others}: {said}"))
    return kept, tuple(findings)


def own_pixels(views: Sequence[View]) -> tuple[list[View], tuple[Finding, ...]]:
    """The views whose points meet their own pixels, and why the others do not."""
    kept: list[View] = []
    missed: dict[tuple[str, bool], list[tuple[View, Reprojection]]] = {}
    for view in views:
        found = reprojection(view.points, view.T_R_cam, view.K_cam)
        if found is None or (found.median <= REPORTED and not found.cause):
            kept.append(view)
            continue
        gross = found.median > REFUSED * view.shape[1]
        missed.setdefault((_plain(found.cause), gross), []).append((view, found))
    return kept, tuple(_missed(cases, gross, len(views)) for (_, gross), cases in missed.items())


def _first_mistake(view: View) -> tuple[str, str] | None:
    """The first check that a view fails, and what it said."""
    shape = view.points.shape[:2]
    checks: list[tuple[str, Callable[[], object]]] = [
        ("points", lambda: checked_points(view.points, "")),
        ("confidence", lambda: checked_layer(view.confidence, "confidence", view.points, "")),
        ("evidence", lambda: checked_layer(view.evidence, "evidence", view.points, "", K)),
        ("pose", lambda: checked_pose(view.T_R_cam, "")),
        ("intrinsics", lambda: checked_intrinsics(view.K_cam, shape, "")),
        ("precision", lambda: check_precision(view.points, view.T_R_cam[:3, 3], "")),
        ("image", lambda: None if view.image is None else checked_image(view.image, shape, "")),
    ]
    for name, check in checks:
        try:
            check()
        except ObservationError as error:
            return name, str(error).removeprefix(": ").rstrip(".")
    return None


def _plain(cause: str) -> str:
    """The mistake without its figures, which differ from view to view."""
    return "".join(letter for letter in cause.partition(";")[0] if not letter.isdigit())


def _missed(cases: Sequence[tuple[View, Reprojection]], gross: bool, total: int) -> Finding:
    _, worst = max(cases, key=lambda case: case[1].median)
    who = named([one.name for one, _ in cases], total)
    far = f"by a median of up to {worst.median:.1f} px" if worst.median < 1e6 else "for most lie behind the camera"
    cause, _, remedy = worst.cause.partition("; ")
    say = refusal if gross else report
    return say(f"the points of {who} miss their own pixels {far}", cause, remedy, median_px=worst.median)
