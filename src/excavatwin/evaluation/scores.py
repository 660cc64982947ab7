"""Scores: the metrics of one site, or of every site of a data set with their summary; as JSON and as CSV."""

from __future__ import annotations

import csv
import io
import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import excavatwin
from excavatwin.errors import OutputError
from excavatwin.evaluation.metric import Metric
from excavatwin.evaluation.selective import RiskCoverage
from excavatwin.scene.staging import whole_file, whole_folder

FORMAT, VERSION = "excavatwin-metrics", 1
JSON_NAME, CSV_NAME = "metrics.json", "metrics.csv"
COLUMNS = ("sequence", "epoch", "metric", "value", "unit", "low", "high", "paper", "meaning")
SUMMARY = "mean"
"""Stands in the column ``sequence`` for what is over all of them."""


@dataclass(frozen=True)
class Row:
    """One scored site."""

    sequence: str
    epoch: str
    """Empty where a sequence has one site."""
    metrics: tuple[Metric, ...]
    failure: str = ""
    """Why there is no map; the metrics are then those of a map without anything in it."""
    curve: RiskCoverage | None = None
    """Risk-coverage curve of the map's cells, thinned."""


@dataclass(frozen=True)
class Scores:
    """Everything that one run of ``excavatwin evaluate`` found."""

    subject: str
    """The SITE or the data set."""
    settings: Mapping[str, str]
    """How it was scored: truth, alignment, policy, seed."""
    rows: tuple[Row, ...]
    summary: tuple[Metric, ...] = ()
    """Over sequences, with bootstrap intervals; empty for one site."""
    notes: tuple[str, ...] = field(default=())
    """What a reader should know, one sentence each."""

    def to_json(self) -> str:
        """Everything, the risk-coverage curves too; null where there was nothing to measure."""
        table = {
            "format": FORMAT,
            "version": VERSION,
            "excavatwin": excavatwin.__version__,
            "subject": self.subject,
            "settings": dict(self.settings),
            "notes": list(self.notes),
            "summary": [_record(metric) for metric in self.summary],
            "rows": [
                {
                    "sequence": row.sequence,
                    "epoch": row.epoch,
                    "failure": row.failure or None,
                    "metrics": [_record(metric) for metric in row.metrics],
                    "risk_coverage": _curve(row.curve),
                }
                for row in self.rows
            ],
        }
        return json.dumps(table, indent=1, allow_nan=False, ensure_ascii=False) + "\n"

    def to_csv(self) -> str:
        """One line a metric, the summary last; empty where there was nothing to measure."""
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(COLUMNS)
        for row in (*self.rows, Row(SUMMARY, "", self.summary)):
            for m in row.metrics:
                numbers = [_number(v) for v in (m.low, m.high, m.paper)]
                writer.writerow([row.sequence, row.epoch, m.name, _number(m.value), m.unit, *numbers, m.meaning])
        return out.getvalue()


def check_places(folder: Path | None = None, *files: Path | None) -> None:
    """Refuse places that ``write_scores`` would refuse, before anything is computed for them.

    Raises:
        OutputError: the folder holds something else, a file is a folder or the other way round, or no permission.
    """
    if folder is not None and folder.exists():
        if not folder.is_dir():
            raise OutputError(f"{folder} is a file, where a folder was to be written; give another name.")
        foreign = [child.name for child in folder.iterdir() if not child.name.startswith(".")]
        if foreign and not (folder / JSON_NAME).is_file():
            raise OutputError(
                f"{folder} already holds something else ({min(foreign)}, no {JSON_NAME}) and will not be overwritten; "
                "give a new folder, or empty this one."
            )
    for place in (folder, *files):
        if place is None:
            continue
        if place != folder and place.is_dir():
            raise OutputError(f"{place} is a folder, where a file was to be written; give another name.")
        parent = next(p for p in place.absolute().parents if p.exists())
        if not os.access(parent, os.W_OK):
            raise OutputError(f"{place} cannot be written: {parent} is read-only for you; choose another place.")


def write_scores(
    scores: Scores, folder: Path | None = None, json_file: Path | None = None, csv_file: Path | None = None
) -> list[Path]:
    """Write what is asked for, each whole or not at all, and name the files.

    Args:
        folder: gets ``metrics.json`` and ``metrics.csv``, both or none.

    Raises:
        OutputError: a place cannot be written, or the folder holds something else.
    """
    written = []
    if folder is not None:
        with whole_folder(folder, JSON_NAME, lambda name: name in (JSON_NAME, CSV_NAME)) as staged:
            (staged / JSON_NAME).write_text(scores.to_json(), "utf-8")
            (staged / CSV_NAME).write_text(scores.to_csv(), "utf-8")
        written += [folder / JSON_NAME, folder / CSV_NAME]
    for path, text in ((json_file, scores.to_json), (csv_file, scores.to_csv)):
        if path is not None:
            with whole_file(path) as file:
                file.write(text().encode())
            written.append(path)
    return written


def _record(metric: Metric) -> dict[str, Any]:
    return {
        "name": metric.name,
        "value": _finite(metric.value),
        "unit": metric.unit,
        "low": _finite(metric.low),
        "high": _finite(metric.high),
        "paper": _finite(metric.paper),
        "meaning": metric.meaning,
    }


def _curve(curve: RiskCoverage | None) -> dict[str, list[float | None]] | None:
    if curve is None:
        return None
    columns = {"coverage": curve.coverage, "risk": curve.risk, "threshold": curve.threshold}
    return {name: [_finite(round(float(v), 6)) for v in column] for name, column in columns.items()}


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def _number(value: float | None) -> float | str:
    found = _finite(value)
    return "" if found is None else found
