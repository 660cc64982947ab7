"""The suite for segmenters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from excavatwin.backbones.conformance import validating, variants
from excavatwin.backbones.conformance.calls import Result, Watch, absent
from excavatwin.backbones.conformance.light import light_rows, name_of
from excavatwin.backbones.conformance.observing import of_findings
from excavatwin.backbones.conformance.preparing import NAME, prepare_row
from excavatwin.backbones.conformance.report import Report, Row, failed, judged, passed, unchecked
from excavatwin.backbones.protocols import Picture, Segmentation, Segmenter
from excavatwin.contract.evidence import ROUNDING
from excavatwin.scene.observations import View
from excavatwin.scene.progress import Progress, silent
from excavatwin.scene.taxonomy import K

_RUNS, _CONTRACT, _FITS, _SAME, _NET = (
    "runs",
    "output contract",
    "evidence on the picture",
    "deterministic",
    "no network",
)
_ODD = ("odd size 517 x 391", "upright 391 x 517")


def check_segmenter(backbone: Segmenter, pictures: Sequence[Picture], progress: Progress = silent) -> Report:
    """Does a segmenter keep what segmenters promise?

    Args:
        backbone: with the parameters that should be checked.
        pictures: at least one that it can segment; two or more are needed to see whether evidence lies on them.
        progress: told how far the suite is.
    """
    light = light_rows(backbone, "segmenter")
    heavy = (_RUNS, _CONTRACT, _FITS, _SAME, *_ODD, NAME, _NET)

    def without(reason: str, *rows: Row) -> Report:
        rest = (unchecked(name, reason) for name in heavy[len(rows) :])
        return Report(name_of(backbone), (*light, *rows, *rest))

    gone = absent(backbone)
    if gone:
        return without(gone)
    watch = Watch(progress)
    total = len(pictures) + 4
    results = [_run(backbone, picture, watch, (at, total)) for at, picture in enumerate(pictures)]
    wrong = next((one for one in results if one.error is not None), None)
    if wrong is not None:
        return without("it does not run.", failed(_RUNS, wrong.strange or str(wrong.error)))
    mistakes = [text for one, picture in zip(results, pictures, strict=True) for text in _mistakes(one.value, picture)]
    again = _run(backbone, pictures[0], watch, (total - 4, total))
    rows = (
        passed(_RUNS),
        judged(_CONTRACT, mistakes[:3], _silence(results)),
        _fits(results, pictures) if not mistakes else unchecked(_FITS, "the output breaks the contract."),
        judged(_SAME, _differences(results[0], again)),
        *(_odd(backbone, pictures[0], watch, (total - 3 + at, total), at) for at in range(2)),
        watch.call(lambda: prepare_row(backbone)).value or failed(NAME, "prepare() cannot be called."),
        judged(_NET, (f"it reached for {address}" for address in list(dict.fromkeys(watch.network))[:3])),
    )
    return Report(name_of(backbone), (*light, *rows))


def _run(backbone: Segmenter, picture: Picture, watch: Watch, at: tuple[int, int]) -> Result[Segmentation]:
    watch.progress("check: pictures", *at)
    return watch.call(lambda: backbone(picture))


def _mistakes(found: Any, picture: Picture) -> Iterator[str]:
    """What breaks the contract of one segmentation."""
    where, shape = picture.name or "the picture", picture.image.shape[:2]
    if not isinstance(found, Segmentation):
        yield f"it gave {type(found).__name__}; expected a Segmentation"
        return
    for key, array, dtype, expected in (
        ("evidence", found.evidence, np.float32, (*shape, K)),
        ("no_surface", found.no_surface, np.bool_, shape),
    ):
        if not isinstance(array, np.ndarray) or array.dtype != dtype:
            kind = getattr(array, "dtype", type(array).__name__)
            yield f"{key} of {where} is {kind}; expected a NumPy array of {np.dtype(dtype)}"
            return
        if array.shape != expected:
            swapped = array.shape[:2] == shape[::-1] and shape[0] != shape[1]
            hint = " (H and W are swapped)" if swapped else "; give it on exactly the pixels of the picture"
            yield f"{key} of {where} has shape {array.shape}; expected {expected}{hint}"
            return
    evidence = found.evidence
    if not np.isfinite(evidence).all():
        yield f"evidence of {where} is not finite everywhere; expected numbers in 0..1"
        return
    if evidence.min(initial=0) < 0 or evidence.max(initial=0) > 1 + ROUNDING:
        span = f"{evidence.min():.3g}..{evidence.max():.3g}"
        yield f"evidence of {where} lies in {span}; expected 0..1: probabilities, not logits or per cent"
        return
    largest = float(evidence.sum(axis=-1).max(initial=0))
    if largest > 1 + ROUNDING:
        yield f"evidence of {where} adds up to {largest:.3g} at a pixel; expected at most 1: divide where it exceeds 1"
    if evidence[found.no_surface].any():
        yield f"{where} has evidence where it says that there is no surface; set it to 0 there"


def _silence(results: Sequence[Result[Segmentation]]) -> str:
    said = [one.value.evidence.any(axis=-1).mean() for one in results if one.value is not None]
    return f"evidence at {np.mean(said):.0%} of the pixels"


def _fits(results: Sequence[Result[Segmentation]], pictures: Sequence[Picture]) -> Row:
    """The validator's rows that need no geometry."""
    views = []
    for result, picture in zip(results, pictures, strict=True):
        assert result.value is not None
        H, W = picture.image.shape[:2]
        nowhere = np.full((H, W, 3), np.nan, np.float32)
        flat = np.zeros((H, W), np.float32)
        views.append(
            View(picture.name, nowhere, flat, result.value.evidence, np.eye(4), np.eye(3), image=picture.image)
        )
    return of_findings(_FITS, validating.of_evidence(views))


def _differences(first: Result[Segmentation], again: Result[Segmentation]) -> Iterator[str]:
    if again.error is not None:
        yield f"the second call with the same picture {again.strange or f'failed: {again.error}'}"
        return
    one, two = first.value, again.value
    if not isinstance(one, Segmentation) or not isinstance(two, Segmentation):
        return
    for key in ("evidence", "no_surface"):
        if not np.array_equal(getattr(one, key), getattr(two, key)):
            yield f"two calls with the same picture differ in {key}; fix seeds and switch training layers off"
            return


def _odd(backbone: Segmenter, picture: Picture, watch: Watch, at: tuple[int, int], upright: int) -> Row:
    """Another size gives evidence on its pixels, or one of our errors (finished labels fit one size only)."""
    odd = variants.odd_picture(picture, bool(upright))
    result = _run(backbone, odd, watch, at)
    if result.strange:
        return failed(_ODD[upright], f"it {result.strange}; pictures come in any size.")
    if result.error is not None:
        return unchecked(_ODD[upright], f"refused: {result.error}")
    return judged(_ODD[upright], _mistakes(result.value, odd))
