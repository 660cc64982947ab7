"""Tables of an ablation: means over cases with their intervals, and paired differences to the full method."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from excavatwin.evaluation.bootstrap import Interval, mean_interval, paired_difference
from excavatwin.evaluation.dimensions import Estimates, MeasuredObject, dimension_metrics
from excavatwin.evaluation.metric import Metric
from excavatwin.evaluation.semantics import TASK_POLICY
from excavatwin.scene.taxonomy import TASK_CLASSES, class_name
from excavatwin.studies.ablation import FULL, CaseResult
from excavatwin.studies.paper_tables import BACKBONES, published
from excavatwin.studies.table import Cell, Table

PROTOCOL = (
    f"mIoU is strict (a pixel without a class counts as wrong) and by policy {TASK_POLICY!r}, over the classes that "
    "the truth of a case has, over all scored pixels of all its photos; coverage is the share of them with a class."
)
MEANS = (
    "Figures are means over cases; brackets hold the 95 % bootstrap interval over cases; differences are paired by "
    "case."
)
FULL_FIGURES = {
    "miou": ("%", "mIoU, strict"),
    "miou_selective": ("%", "mIoU, selective: pixels without a class left out"),
    "coverage": ("%", "share of the pixels with a class"),
    "accuracy": ("%", "share of the pixels with the right class"),
    "risk_at_95": ("%", "wrong ones among the most confident 95 % of the pixels"),
    "risk_forced": ("%", "wrong ones of all pixels under forced arg-max (tau = 0)"),
    "risk_ratio": ("1", "the former over the latter"),
    "aurc": ("%", "area under the risk-coverage curve"),
    "ece": ("%", "expected calibration error"),
    "elevation_mae": ("m", "terrain MAE by the declared scale and gravity"),
    "elevation_rmse": ("m", "terrain RMSE by the declared scale and gravity"),
    "elevation_fitted_mae": ("m", "terrain MAE after an extra vertical shift and tilt"),
    "elevation_fitted_rmse": ("m", "terrain RMSE after an extra vertical shift and tilt"),
    "elevation_placed_mae": ("m", "terrain MAE by the true similarity"),
    "elevation_scale_error": ("%", "error of the scale, signed"),
    "oracle_elevation_mae": ("m", "terrain MAE of the oracle: true labels and true similarity, same points"),
    "oracle_elevation_fitted_mae": ("m", "terrain MAE of the oracle after an extra vertical shift and tilt"),
    "elevation_ratio": ("1", "terrain MAE over the oracle's"),
    "elevation_fitted_ratio": ("1", "the same, both after an extra vertical shift and tilt"),
    "elevation_placed_ratio": ("1", "terrain MAE over the oracle's, both by the true similarity"),
}
"""Figure of the full method -> unit, meaning."""


def ablation_tables(results: Sequence[CaseResult], source: str, dataset: str = "oces") -> list[Table]:
    """Three tables a backbone: configurations, classes, the full method.

    Args:
        results: of all cases and backbones.
        source: where the cases come from, such as the seeds.
        dataset: whose column of the paper stands beside ours; none of that name leaves it out.
    """
    tables = []
    for backbone in dict.fromkeys(result.backbone for result in results):
        mine = [result for result in results if result.backbone == backbone]
        notes = (f"{len(mine)} case{'s' if len(mine) != 1 else ''}: {source}.", PROTOCOL, MEANS)
        tables += [
            comparison(mine, backbone, dataset, notes),
            classes(mine, backbone, notes),
            full_method(mine, backbone, notes),
        ]
    return tables


def title_of(backbone: str, results: Sequence[CaseResult]) -> str:
    """``YOLOE-like`` for emulated backbones, else the name."""
    simulated = bool(results) and results[0].case.startswith("site ")
    return f"{BACKBONES[backbone]}-like" if simulated and backbone in BACKBONES else BACKBONES.get(backbone, backbone)


def values(results: Sequence[CaseResult], configuration: str, figure: str) -> np.ndarray:
    """A figure of a configuration, case by case; NaN where a case does not have it."""
    return np.array([result.rows.get(configuration, {}).get(figure, np.nan) for result in results], float)


def configurations_of(results: Sequence[CaseResult]) -> list[str]:
    """Names in the order of their first appearance; those without any figure are left out."""
    return list(dict.fromkeys(name for result in results for name, row in result.rows.items() if row))


def comparison(results: Sequence[CaseResult], backbone: str, dataset: str, notes: Sequence[str]) -> Table:
    """Every configuration: mIoU, difference to the full method, coverage, and the paper's figures."""
    rows: list[tuple[Cell, ...]] = []
    for name in configurations_of(results):
        miou = values(results, name, "miou")
        difference = paired_difference(miou, values(results, FULL, "miou"))
        paper = published(dataset, backbone, name) or (None, None)
        mean = mean_interval(miou)
        rows.append(
            (
                name, mean.value, bracket(mean), None if name == FULL else difference.value,
                None if name == FULL else bracket(difference), *(
                    mean_interval(values(results, name, figure)).value
                    for figure in ("coverage", "miou_selective", "accuracy")
                ), *paper,
            )
        )  # fmt: skip
    columns: tuple[str, ...] = (
        "configuration", "mIoU [%]", "95 % interval", "to full", "95 % interval of it", "coverage [%]",
        "selective mIoU [%]", "accuracy [%]", "paper: mIoU [%]", "paper: coverage [%]",
    )  # fmt: skip
    if dataset != "oces":
        columns, rows = columns[:-2], [row[:-2] for row in rows]
    else:
        notes = (*notes, "The paper's columns are its OCES figures, recorded with the real backbone; ours are not it.")
    return Table(f"Ablation, {title_of(backbone, results)} backbone", columns, tuple(rows), tuple(notes))


def classes(results: Sequence[CaseResult], backbone: str, notes: Sequence[str]) -> Table:
    """Strict IoU of every class under every configuration; a mean over the cases whose truth has the class."""
    names = [class_name(k) for k in TASK_CLASSES]
    rows: tuple[tuple[Cell, ...], ...] = tuple(
        (name, *(mean_interval(values(results, name, f"iou_{one}")).value for one in names))
        for name in configurations_of(results)
    )
    columns = ("configuration", *(f"{one.replace('_', ' ')} [%]" for one in names))
    return Table(f"Strict IoU of each class, {title_of(backbone, results)} backbone", columns, rows, tuple(notes))


def full_method(results: Sequence[CaseResult], backbone: str, notes: Sequence[str]) -> Table:
    """What else is known of the full method: the worth of its confidence, terrain, object dimensions."""
    rows: list[tuple[Cell, ...]] = []
    for figure, (unit, meaning) in FULL_FIGURES.items():
        found = mean_interval(values(results, FULL, figure))
        if found.n:
            digits = 4 if unit == "m" else 2
            n = float(found.n)
            rows.append((meaning, unit, f"{found.value:.{digits}f}", bracket(found, digits), f"{n:.0f}"))
    for metric in dimensions(results):
        digits = 4 if metric.unit == "m" else 0 if metric.unit == "1" else 2
        low, high = (float("nan") if v is None else v for v in (metric.low, metric.high))
        interval = Interval(metric.value, low, high, len(results))
        meaning = metric.meaning.partition(";")[0] + "; scale from one reference object, not among them"
        rows.append((meaning, metric.unit, f"{metric.value:.{digits}f}", bracket(interval, digits), None))
    columns = ("figure", "unit", "mean", "95 % interval", "cases")
    return Table(f"The full method, {title_of(backbone, results)} backbone", columns, tuple(rows), tuple(notes))


def dimensions(results: Sequence[CaseResult]) -> tuple[Metric, ...]:
    """Errors of object dimensions; the scale is that of one reference object, which is not among them."""
    objects: list[MeasuredObject] = [one for result in results for one in result.objects]
    if not objects:
        return ()
    size = np.array([one.measured for one in objects], float)
    every = np.ones(size.shape, bool)
    metrics = dimension_metrics(Estimates("other_object", np.ones(len(objects)), size, every), objects)
    return tuple(metric for metric in metrics if not metric.name.rpartition("_median_")[1])


def bracket(interval: Interval, digits: int = 2) -> Cell:
    """``[low, high]``; nothing where one case tells nothing about the next."""
    if not np.isfinite(interval.low):
        return None
    return f"[{interval.low:.{digits}f}, {interval.high:.{digits}f}]"
