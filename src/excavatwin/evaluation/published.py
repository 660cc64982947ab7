"""The paper's figures, to stand beside ours: tab:geometry_accuracy and tab:semantic_accuracy."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from excavatwin.evaluation.metric import Metric


@dataclass(frozen=True)
class Published:
    """One figure of the paper."""

    value: float
    unit: str
    row: str
    """Table label and row."""


def _geometry(
    mae: float, rmse: float, relative: float | None, row: str, names: tuple[str, ...]
) -> dict[str, Published]:
    values = (mae / 100, "m"), (rmse / 100, "m"), (relative, "%")  # the table is in centimetres
    row = f"tab:geometry_accuracy, {row}"
    return {
        name: Published(value, unit, row)
        for name, (value, unit) in zip(names, values, strict=False)
        if value is not None
    }


def _semantics(miou: float, coverage: float, row: str) -> dict[str, Published]:
    row = f"tab:semantic_accuracy, {row}"
    return {"photo_miou": Published(miou, "%", row), "photo_coverage": Published(coverage, "%", row)}


_ELEVATION = ("elevation_mae", "elevation_rmse")
_DIMENSION = ("dimension_mae", "dimension_rmse", "dimension_relative_error")
_OCES = {
    **_geometry(12.61, 15.32, None, "OCES", _ELEVATION),
    **_geometry(6.23, 8.94, 10.43, "OCES", _DIMENSION),
}

#: Data set -> segmenter of the paper -> metric -> what the paper has, for "+ Ours". The paper does not say whether its
#: mIoU is strict, by which policy classes were mapped, or where the scale of its dimensions comes from.
PUBLISHED: Mapping[str, Mapping[str, Mapping[str, Published]]] = {
    "oces": {
        "mask2former": {**_OCES, **_semantics(53.19, 99.28, "OCES, Mask2Former + Ours")},
        "yoloe": {**_OCES, **_semantics(34.57, 80.40, "OCES, YOLOE + Ours")},
    },
    "goose-ex": {
        "mask2former": _semantics(38.03, 96.15, "GOOSE-Ex, Mask2Former + Ours"),
        "yoloe": _semantics(20.77, 90.52, "GOOSE-Ex, YOLOE + Ours"),
    },
    "rellis-3d": {name: _geometry(28.30, 32.14, None, "RELLIS-3D", _ELEVATION) for name in ("mask2former", "yoloe")},
    "objectron": {name: _geometry(2.63, 4.55, 9.01, "Objectron", _DIMENSION) for name in ("mask2former", "yoloe")},
}


def with_paper(metrics: Iterable[Metric], dataset: str, segmenter: str = "mask2former") -> tuple[Metric, ...]:
    """The metrics with the paper's values beside them where it has one, and its row named in the meaning.

    A dimension under any protocol stands beside the paper's only dimension figure.

    Args:
        dataset: name as in ``datasets``.
        segmenter: whose row of the semantic table; by default the better one.
    """
    rows = PUBLISHED.get(dataset, {}).get(segmenter, {})
    return tuple(_beside(metric, rows) for metric in metrics)


def _beside(metric: Metric, rows: Mapping[str, Published]) -> Metric:
    name = metric.name
    for protocol in ("camera_baseline", "one_dimension", "other_object", "metric_backbone"):
        name = name.replace(f"dimension_{protocol}_", "dimension_")
    found = rows.get(name)
    if found is None or found.unit != metric.unit:
        return metric
    return replace(metric, paper=found.value, meaning=f"{metric.meaning} (paper: {found.row})")
