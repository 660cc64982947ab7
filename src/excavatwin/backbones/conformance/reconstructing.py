"""The suite for reconstructors."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from excavatwin.backbones.conformance import variants
from excavatwin.backbones.conformance.calls import Result, Watch, absent
from excavatwin.backbones.conformance.light import light_rows, name_of
from excavatwin.backbones.conformance.observing import ROWS, contract_mistake, observation_rows
from excavatwin.backbones.conformance.report import Report, Row, failed, judged, passed, unchecked
from excavatwin.backbones.protocols import Reconstructor
from excavatwin.scene.observations import Observations
from excavatwin.scene.photo import Photo
from excavatwin.scene.progress import Progress, silent

#: Photos that the odd calls get.
FEW = 4
#: Provenance that may differ from run to run.
MEASURED = ("memory", "time")
_RUNS, _SAME, _TOLD, _NET = "runs", "deterministic", "progress", "no network"
_ODD = ("odd size 517 x 391", "upright by EXIF", "one photo", "unreadable photo")


@dataclass(frozen=True)
class Reconstruction:
    """A report, and the observations of the first call for whoever knows the truth."""

    report: Report
    observations: Observations | None


def check_reconstructor(
    backbone: Reconstructor, photos: Sequence[Photo], scratch: Path, progress: Progress = silent
) -> Report:
    """Does a reconstructor keep what reconstructors promise?

    Args:
        backbone: with the parameters that should be checked; it is called six times.
        photos: some that it can reconstruct, at least three for most.
        scratch: an empty folder, made when it is missing; every call gets a folder of its own in it. Whether something
            is written outside of it is not checked.
        progress: told how far the suite is.
    """
    return examine(backbone, photos, scratch, progress).report


def examine(backbone: Reconstructor, photos: Sequence[Photo], scratch: Path, progress: Progress) -> Reconstruction:
    """``check_reconstructor``, with the observations that it got."""
    light = light_rows(backbone, "reconstructor")
    heavy = (_RUNS, *ROWS, _SAME, *_ODD, _TOLD, _NET)

    def without(reason: str, *rows: Row) -> Reconstruction:
        rest = (unchecked(name, reason) for name in heavy[len(rows) :])
        return Reconstruction(Report(name_of(backbone), (*light, *rows, *rest)), None)

    gone = absent(backbone)
    if gone:
        return without(gone)
    watch = Watch(progress)

    def run(what: str, some: Sequence[Photo]) -> Result[Observations]:
        place = scratch / what.replace(" ", "_")
        place.mkdir(parents=True)
        return watch.call(lambda: backbone(some, watch.told(what), place))

    first = run("first call", photos)
    if first.error is not None or first.value is None:
        said = first.strange or str(first.error or "it gave nothing.")
        return without("it does not run.", failed(_RUNS, said))
    found = observation_rows(first.value, photos)
    again = run("second call", photos)
    rows = (
        passed(_RUNS),
        *found,
        judged(_SAME, differences(first.value, again)),
        *_odd_rows(run, photos, scratch),
        _progress_row(watch),
        judged(_NET, (f"it reached for {address}" for address in list(dict.fromkeys(watch.network))[:3])),
    )
    return Reconstruction(Report(name_of(backbone), (*light, *rows)), first.value)


def differences(first: Observations, again: Result[Observations]) -> Iterator[str]:
    """How the result of the same call differs: the first thing."""
    if again.error is not None or again.value is None:
        yield f"the second call with the same photos {again.strange or f'failed: {again.error}'}"
        return
    one, two = first, again.value
    for a, b in zip_longest(one.views, two.views):
        if a is None or b is None or a.name != b.name:
            yield "two calls with the same photos give different views"
            return
        for key in ("points", "confidence", "T_R_cam", "K_cam", "image"):
            if not _equal(getattr(a, key), getattr(b, key)):
                yield f"two calls with the same photos differ in {key} of {a.name}; fix seeds and orders"
                return
    for key in ("up", "metres_per_unit", "unplaced", "doubts"):
        if not _equal(getattr(one, key), getattr(two, key)):
            yield f"two calls with the same photos differ in {key}"
            return
    for key in sorted({*one.source, *two.source} - set(MEASURED)):
        if one.source.get(key) != two.source.get(key):
            yield f"two calls with the same photos differ in source[{key!r}]"
            return


def _equal(a: Any, b: Any) -> bool:
    if not isinstance(a, np.ndarray) or not isinstance(b, np.ndarray):
        return bool(np.all(a == b)) if type(a) is type(b) else False
    return a.shape == b.shape and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")


def _odd_rows(
    run: Callable[[str, Sequence[Photo]], Result[Observations]], photos: Sequence[Photo], scratch: Path
) -> Iterator[Row]:
    """Odd photos give observations that keep the contract, or one of our errors."""
    few = photos[:FEW]
    for name, upright in zip(_ODD[:2], (False, True), strict=True):
        made = variants.odd_photos(few, scratch / f"photos {name}", upright)
        yield _odd_row(name, run(name, made), refusal_is_enough=False)
    yield _odd_row(_ODD[2], run(_ODD[2], photos[:1]), refusal_is_enough=True)
    made = variants.damaged(few, scratch / f"photos {_ODD[3]}")
    yield _odd_row(_ODD[3], run(_ODD[3], made), refusal_is_enough=True)


def _odd_row(name: str, result: Result[Observations], refusal_is_enough: bool) -> Row:
    if result.strange:
        return failed(name, f"it {result.strange}; raise an InputError that says what to do, or leave the photo out.")
    if result.error is not None:
        said = f"refused: {result.error}"
        return passed(name, said) if refusal_is_enough else unchecked(name, said)
    wrong = contract_mistake(result.value)
    return failed(name, wrong) if wrong else passed(name)


def _progress_row(watch: Watch) -> Row:
    if not watch.steps:
        return failed(_TOLD, "it never told its progress; call progress(stage, done, total) as the work goes on.")
    odd = [step for step in watch.steps if not 0 <= step[1] <= max(step[2], 1)]
    return judged(_TOLD, (f"it told {done} of {total} steps of {stage!r}" for stage, done, total in odd[:1]))
