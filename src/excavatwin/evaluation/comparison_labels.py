"""Classes and coverage of two maps of one site, cell by cell. Neither is the truth, so nothing here is an accuracy."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int64, UInt8

from excavatwin.evaluation.comparison_grid import Layers
from excavatwin.evaluation.metric import Metric
from excavatwin.scene.taxonomy import NOT_OBSERVED, TASK_CLASSES, K, TaskClass, class_name

VALUES: tuple[int, ...] = (*map(int, TASK_CLASSES), int(TaskClass.UNKNOWN), NOT_OBSERVED)
"""What a cell can be, in the order of the matrix: the classes 1..K, unknown, not observed."""
NAMES = tuple(class_name(value) for value in VALUES)


def cross_table(a: UInt8[np.ndarray, "*n"], b: UInt8[np.ndarray, "*n"]) -> Int64[np.ndarray, "L L"]:
    """Cells by what A says (rows) and what B says (columns), in the order of ``VALUES``.

    Cells that neither observes are not counted: how many there are depends on the grid alone.
    """
    index = np.zeros(256, np.int64)
    index[list(VALUES)] = np.arange(K + 2)
    counts = np.bincount((index[a] * (K + 2) + index[b]).ravel(), minlength=(K + 2) ** 2).reshape(K + 2, K + 2)
    counts[-1, -1] = 0
    return counts


def kappa(counts: Int64[np.ndarray, "k k"]) -> float:
    """Agreement beyond chance (Cohen 1960); NaN where there is nothing, or one class alone."""
    total = counts.sum()
    if total == 0:
        return float("nan")
    observed = np.trace(counts) / total
    expected = float((counts.sum(0) * counts.sum(1)).sum()) / float(total) ** 2
    return float((observed - expected) / (1 - expected)) if expected < 1 else float("nan")


def overlap(counts: Int64[np.ndarray, "k k"]) -> Float64[np.ndarray, "k"]:
    """Intersection of what A and B call a class over their union; NaN where neither does."""
    hit = np.diag(counts).astype(float)
    union = counts.sum(0) + counts.sum(1) - hit
    return np.where(union > 0, hit / np.maximum(union, 1), np.nan)


def label_figures(counts: Int64[np.ndarray, "L L"]) -> tuple[Metric, ...]:
    """Agreement, kappa, IoU of each class, and what each map leaves unknown."""
    classified, observed = counts[:K, :K], counts[: K + 1, : K + 1]
    both, seen = classified.sum(), observed.sum()
    nan = float("nan")
    iou = overlap(observed)[:K]
    named = [k for k in range(K) if np.isfinite(iou[k])]
    return (
        Metric(
            "label_agreement", 100 * float(np.trace(classified) / both) if both else nan, "%",
            "cells of the same class, of those to which both give a class",
        ),
        Metric("label_kappa", kappa(classified), "1", "agreement beyond chance (Cohen), over the same cells"),
        Metric("label_miou", 100 * float(iou[named].mean()) if named else nan, "%", "mean of the IoU below"),
        *(
            Metric(
                f"label_iou_{NAMES[k]}", 100 * float(iou[k]), "%",
                "cells that both call it, of those that one does; where both observe, unknown counts against it",
            )
            for k in named
        ),
        Metric(
            "label_unknown_a", 100 * float(observed[K].sum() / seen) if seen else nan, "%",
            "cells that A leaves unknown, of those that both observe",
        ),
        Metric(
            "label_unknown_b", 100 * float(observed[:, K].sum() / seen) if seen else nan, "%",
            "cells that B leaves unknown, of those that both observe",
        ),
    )  # fmt: skip


def coverage(a: Layers, b: Layers) -> dict[str, tuple[int, int, int]]:
    """Cells that are observed, have terrain, have a class: in A only, in B only, in both."""
    sides = {
        "observed": (a.observed, b.observed),
        "terrain": (a.terrain, b.terrain),
        "classified": tuple((side.label > TaskClass.UNKNOWN) & side.observed for side in (a, b)),
    }
    return {
        name: (int((ours & ~theirs).sum()), int((theirs & ~ours).sum()), int((ours & theirs).sum()))
        for name, (ours, theirs) in sides.items()
    }


def coverage_figures(found: dict[str, tuple[int, int, int]], cell: float, unit: str) -> tuple[Metric, ...]:
    """The same in areas, and what both have as a share of what one has."""
    phrase = {"observed": "observed", "terrain": "with a terrain height", "classified": "with a class"}
    rows = []
    for name, (only_a, only_b, both) in found.items():
        for side, n in (("only_a", only_a), ("only_b", only_b), ("both", both)):
            where = "both maps" if side == "both" else f"{side[-1].upper()} only"
            rows.append(Metric(f"coverage_{name}_{side}", n * cell**2, f"{unit}2", f"{phrase[name]} in {where}"))
        either = only_a + only_b + both
        share = 100 * both / either if either else float("nan")
        rows.append(Metric(f"coverage_{name}_shared", share, "%", f"{phrase[name]} in both, of what is in one"))
    return tuple(rows)
