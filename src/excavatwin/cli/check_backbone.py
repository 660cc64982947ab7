"""``excavatwin check-backbone``: is a backbone wired up right? The conformance suite, on a site with known truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from excavatwin.cli.mapping import Changes

if TYPE_CHECKING:
    from excavatwin.backbones.conformance import Report
    from excavatwin.backbones.protocols import Reconstructor, Segmenter
    from excavatwin.cli.rendered_site import Known
    from excavatwin.scene.photo import Photo
    from excavatwin.scene.progress import Progress

#: Pictures that a segmenter is asked about, and their longer side [px].
PICTURES, SIDE = 6, 640
#: Photos that a reconstructor is given.
PHOTOS = 12


def check_backbone_command(name: str, /, *, photos: Path | None = None, changes: Changes = None) -> int:
    """Run the conformance suite on one backbone; exit code 2 when a promise is broken.

    Parameters
    ----------
    name
        NAME, or NAME:VALUE with weights, a folder or a file, as for --reconstructor and --segmenter.
    photos
        Folder of photos to try it on; without it a small site is rendered, whose truth is known.
    """
    from tempfile import TemporaryDirectory

    from excavatwin.backbones.conformance.calls import absent
    from excavatwin.cli.console import say, shown_progress
    from excavatwin.survey.backbone_states import find_entry

    kind = find_entry(name.partition(":")[0].strip()).kind
    backbone = _made(kind, name, changes or {})
    with TemporaryDirectory(prefix="excavatwin-check-") as place, shown_progress() as progress:
        folder = Path(place)
        known, found = ({}, []) if absent(backbone) else _photos(photos, folder / "photos", progress)
        check = _reconstructor if kind == "reconstructor" else _segmenter
        report = check(backbone, found, known, folder, progress)
    where = f" on {len(found)} photos{f' of {photos}' if photos else ', rendered'}" if found else ""
    say(f"{kind} {name}{where}", "", *_table(report), "", report.verdict)
    return 2 if report.failed else 0


def _made(kind: str, text: str, changes: Mapping[str, Any]) -> Any:
    """The backbone with the parameters of the flags."""
    from excavatwin.cli.plans import Choice, read_plan

    if kind == "reconstructor":
        return read_plan(None, changes, Choice(reconstructor=text)).reconstructor
    (segmenter,) = read_plan(None, changes, Choice(segmenters=[text])).segmenters.values()
    return segmenter


def _photos(given: Path | None, folder: Path, progress: Progress) -> tuple[dict[str, Known], list[Photo]]:
    from excavatwin.capture import find_photos
    from excavatwin.cli.rendered_site import render

    if given is not None:
        return {}, find_photos(given)[:PHOTOS]
    known = render(folder, progress)
    return known, find_photos(folder)


def _reconstructor(
    backbone: Reconstructor, photos: Sequence[Photo], known: Mapping[str, Known], folder: Path, progress: Progress
) -> Report:
    from excavatwin.backbones.conformance.reconstructing import examine
    from excavatwin.cli.rendered_site import truth_rows

    found = examine(backbone, photos, folder / "scratch", progress)
    rows = truth_rows(found.observations, known) if known else ()
    return replace(found.report, rows=(*found.report.rows, *rows))


def _segmenter(
    backbone: Segmenter, photos: Sequence[Photo], known: Mapping[str, Known], folder: Path, progress: Progress
) -> Report:
    from excavatwin.backbones.conformance import check_segmenter
    from excavatwin.backbones.protocols import Picture
    from excavatwin.capture import read_photo

    pictures = [Picture(read_photo(photo, SIDE), photo.name, None, photo.path) for photo in photos[:PICTURES]]
    return check_segmenter(backbone, pictures, progress)


def _table(report: Report) -> list[str]:
    """One line a row; a reason that stands above is not repeated."""
    from excavatwin.backbones.conformance import Outcome
    from excavatwin.cli.console import wrapped

    lines: list[str] = []
    above = ""
    for row in report.rows:
        outcome = "FAILED" if row.outcome == Outcome.FAILED else str(row.outcome)
        head = f"  {outcome:<15}{row.name:<31}"
        again = row.outcome == Outcome.NOT_CHECKABLE and row.sentence == above
        lines += wrapped(head, "as above" if again else row.sentence) if row.sentence else [head.rstrip()]
        above = row.sentence
    return lines
