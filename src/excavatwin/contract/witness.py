"""Do class ids mean what they should? A weak but independent witness, such as colour cues, can tell gross shifts.

A witness is evidence of low quality for the same classes (vegetation is green, machines are yellow). It may be wrong
about any pixel, but its errors do not follow a shift of ids: the evidence must vary together with the witness under
the right reading of the ids, and not under others.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float32, Float64

from excavatwin.contract.findings import Finding, refusal
from excavatwin.scene.observations import View
from excavatwin.scene.taxonomy import TASK_CLASSES, K, class_name

#: Least joint variation under the other reading: below, the evidence or the witness says too little.
LEAST = 0.03
#: What the reported reading may still have of it.
LEFT = 0.25
#: Standard errors by which the other reading must be better.
CLEARLY = 4.0

Reading = tuple[int, ...]
"""Which id 0..K each stored id 0..K means; 0 = none."""

_REPORTED: Reading = tuple(range(K + 1))
_LESS: Reading = (0, *range(K))
_MORE: Reading = (*range(1, K + 1), 0)


def witnessed(views: Sequence[View], witness: Mapping[str, Float32[np.ndarray, "H W K"]]) -> tuple[Finding, ...]:
    """Whether the ids of the evidence are shifted or shuffled.

    Args:
        witness: evidence of another kind for the same pixels, by the names of the views.
    """
    able = [view for view in views if view.evidence.any() and _fits(view, witness.get(view.name))]
    if not able:
        return ()
    # few views are looked at in quarters: a test needs a scatter
    tables = [table for view in able for table in _tables(view, witness[view.name], 1 if len(able) > 3 else 2)]
    reported = _scores(tables, _REPORTED)
    for reading, cause, remedy in (
        (_LESS, "the ids are counted from 1 where 0 was meant (1-based labels)", "subtract 1 from the ids"),
        (_MORE, "the index of the arg-max channel (0-based) is taken for the id", "add 1: channel 0 is id 1"),
    ):
        if _clearly(_scores(tables, reading), reported, CLEARLY, LEAST):
            return (_finding(cause, remedy, tables, reading, reported, len(able)),)
    best = max(
        ((0, *order) for order in itertools.permutations(range(1, K + 1))),
        key=lambda reading: float(_scores(tables, reading).mean()),
    )
    if _clearly(_scores(tables, best), np.maximum(reported, 0), 2.5 * CLEARLY, 2 * LEAST):  # the best of 120: stricter
        order = ", ".join(class_name(best[k]) for k in TASK_CLASSES)
        cause, remedy = "the class ids are in another order", f"channels 1..{K} look like {order}"
        return (_finding(cause, remedy, tables, best, reported, len(able)),)
    return ()


def _fits(view: View, seen: Float32[np.ndarray, "h w K"] | None) -> bool:
    return seen is not None and seen.shape == view.evidence.shape


def _tables(view: View, witness: Float32[np.ndarray, "H W K"], parts: int) -> list[Float64[np.ndarray, "C K"]]:
    """How much more of each class the witness sees where the evidence says k = 0..K than in the whole part."""
    H, W = view.shape
    found = []
    for i, j in itertools.product(range(parts), repeat=2):
        rows, cols = slice(i * H // parts, (i + 1) * H // parts, 3), slice(j * W // parts, (j + 1) * W // parts, 3)
        evidence, seen = (e[rows, cols].reshape(-1, K).astype(np.float64) for e in (view.evidence, witness))
        said = np.where(evidence.max(axis=1) > 0.02, evidence.argmax(axis=1) + 1, 0)
        said_one_hot = np.eye(K + 1)[said]
        found.append(said_one_hot.T @ (seen - seen.mean(axis=0)) / len(seen))
    return found


def _scores(tables: Sequence[Float64[np.ndarray, "C K"]], reading: Reading) -> Float64[np.ndarray, "n"]:
    """Joint variation of evidence and witness under a reading, part by part."""
    pairs = [(said, means - 1) for said, means in enumerate(reading) if means]
    said, means = (list(column) for column in zip(*pairs, strict=True))
    return np.array([table[said, means].sum() for table in tables])


def _clearly(other: Float64[np.ndarray, "n"], reported: Float64[np.ndarray, "n"], errors: float, least: float) -> bool:
    gain = other - reported
    if len(gain) < 4 or other.mean() < least or reported.mean() > LEFT * other.mean():
        return False
    return bool(gain.mean() > errors * gain.std(ddof=1) / np.sqrt(len(gain)))


def _finding(
    cause: str, remedy: str, tables: Sequence[np.ndarray], reading: Reading, reported: np.ndarray, views: int
) -> Finding:
    then, now = float(_scores(tables, reading).mean()), float(reported.mean())
    return refusal(
        f"in {views} view{'s' if views > 1 else ''} the classes do not go with what the colours say "
        f"(joint variation {now:+.3f}), but do when read otherwise ({then:+.3f})",
        cause,
        remedy,
        as_reported=now,
        otherwise=then,
    )
