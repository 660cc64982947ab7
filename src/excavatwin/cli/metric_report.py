"""Metrics on the screen: one table for a site, and for a data set its sequences and their means."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.table import Table

    from excavatwin.evaluation.metric import Metric
    from excavatwin.evaluation.scores import Row, Scores

ROUNDING = 1e-9
"""Smaller figures are rounding of zero."""
WIDTH = 118
"""Columns where no terminal tells."""
DETAILS = r"^elevation_fitted_(?!mae$|rmse$)|_mae_gsd$|^dimension_.*_median|_iou_|_accuracy_selective$"
"""Figures of a data set that are left to the files."""
SHORT = {
    "elevation_mae": "elevation MAE [m]",
    "elevation_fitted_mae": "fitted [m]",
    "elevation_completeness": "complete [%]",
    "photo_miou": "mIoU strict [%]",
    "photo_coverage": "coverage [%]",
    "object_recall": "recall [%]",
    "object_size_relative_error": "size [%]",
}
"""Columns of the table of sequences: metric -> head."""


def report(scores: Scores) -> list[str]:
    """The lines of the last screen."""
    from excavatwin.cli.console import wrapped

    lines = [f"{scores.subject}: " + ", ".join(f"{name} {value}" for name, value in scores.settings.items()), ""]
    if scores.summary:
        lines += rendered(sequence_table(scores))
        for row in scores.rows:
            lines += wrapped(f"  ! no map of {site_name(row)}: ", row.failure, WIDTH) if row.failure else []
        lines += ["", "Over sequences:"]
    lines += rendered(summary_table(scores.summary) if scores.summary else metric_table(scores.rows[0].metrics))
    if scores.summary:
        lines.append("All figures of every site with their meaning go into metrics.csv and metrics.json: -o FOLDER.")
    return lines + [line for note in scores.notes for line in wrapped("  ! ", note, WIDTH)]


def metric_table(metrics: Sequence[Metric]) -> Table:
    """Name, value and meaning."""
    table = _plain()
    table.add_column("metric", no_wrap=True)
    table.add_column("value", justify="right", no_wrap=True)
    table.add_column("meaning")
    for m in metrics:
        table.add_row(m.name, figure(m.value, m.unit), m.meaning)
    return table


def summary_table(metrics: Sequence[Metric]) -> Table:
    """Name, value, interval, the paper's value, and in a few words which kind of mIoU and which row of the paper."""
    table = _plain()
    table.add_column("metric", no_wrap=True)
    for head in ("value", "95 % interval", "paper"):
        table.add_column(head, justify="right", no_wrap=True)
    table.add_column("")
    for m in metrics:
        if re.search(DETAILS, m.name):
            continue
        between = f"{figure(m.low)} .. {figure(m.high)}" if m.low is not None else ""
        paper = figure(m.paper, m.unit) if m.paper is not None else ""
        table.add_row(m.name, figure(m.value, m.unit), between, paper, remark(m))
    return table


def remark(m: Metric) -> str:
    """``"strict, policy 'task'"``, the row of the paper's table, in how many sequences there was a value."""
    found = [re.search(r"^(strict|selective) ", m.meaning), re.search(r"policy '[^']*'", m.meaning)]
    found += [re.search(r"(?<=\()\d+ of \d+ sequences", m.meaning), re.search(r"(?<=paper: )[^)]*", m.meaning)]
    return ", ".join(match[0].strip().removeprefix("tab:") for match in found if match)


def sequence_table(scores: Scores) -> Table:
    """One line a site with the figures that are asked for first."""
    table = _plain()
    found = {m.name for row in scores.rows for m in row.metrics}
    names = [name for name in SHORT if name in found]
    table.add_column("sequence", no_wrap=True)
    for name in names:
        table.add_column(SHORT[name], justify="right")
    for row in scores.rows:
        values = {m.name: m.value for m in row.metrics}
        table.add_row(site_name(row), *(figure(values.get(name)) for name in names))
    return table


def site_name(row: Row) -> str:
    """``"site_200/epoch_00"``."""
    return "/".join(part for part in (row.sequence, row.epoch) if part)


def figure(value: float | None, unit: str = "1") -> str:
    """Three digits that count, with the unit; a dash where nothing was measured."""
    if value is None or not math.isfinite(value):
        return "-"
    if abs(value) < ROUNDING:
        value = 0.0
    digits = f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
    return digits if unit == "1" else f"{digits} {unit}"


def rendered(table: Table) -> list[str]:
    """A table as lines, as wide as the terminal, without trailing blanks."""
    import io

    from rich.console import Console

    terminal = Console(file=sys.stdout)
    wide = terminal.width if terminal.is_terminal else max(terminal.width, WIDTH)
    out = io.StringIO()
    Console(file=out, width=wide, color_system=None, markup=False, highlight=False).print(table)
    return [line.rstrip() for line in out.getvalue().strip("\n").splitlines() if line.strip()]


def _plain() -> Table:
    from rich import box
    from rich.table import Table

    return Table(box=box.ASCII2 if sys.stdout.encoding.lower() == "ascii" else box.SIMPLE_HEAD, pad_edge=False)
