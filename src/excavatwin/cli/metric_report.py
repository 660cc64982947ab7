"""Metrics on the screen: one table for a site, and for a data set its sequences and their means."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.table import Table

    from excavatwin.evaluation.metric import Metric
    from excavatwin.evaluation.scores import Scores

ROUNDING = 1e-9
"""Smaller figures are rounding of zero."""
WIDTH = 118
"""Columns where no terminal tells."""
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
    lines = [f"{scores.subject}: " + ", ".join(f"{name} {value}" for name, value in scores.settings.items()), ""]
    if scores.summary:
        lines += [*rendered(sequence_table(scores)), "Over sequences:"]
    metrics = scores.summary or scores.rows[0].metrics
    lines += rendered(metric_table(metrics))
    for note in scores.notes:
        lines.append(f"  ! {note}")
    return lines


def metric_table(metrics: Sequence[Metric]) -> Table:
    """Name, value, and, where there are any, interval and the paper's value; then the meaning."""
    from rich.table import Table

    table = _plain(Table)
    intervals, papers = any(m.low is not None for m in metrics), any(m.paper is not None for m in metrics)
    table.add_column("metric", no_wrap=True)
    table.add_column("value", justify="right", no_wrap=True)
    if intervals:
        table.add_column("95 % interval", justify="right", no_wrap=True)
    if papers:
        table.add_column("paper", justify="right", no_wrap=True)
    table.add_column("meaning")
    for m in metrics:
        between = f"{figure(m.low)} .. {figure(m.high)}" if m.low is not None else ""
        cells = [m.name, figure(m.value, m.unit)]
        cells += [between] if intervals else []
        cells += [figure(m.paper, m.unit) if m.paper is not None else ""] if papers else []
        table.add_row(*cells, m.meaning)
    return table


def sequence_table(scores: Scores) -> Table:
    """One line a site with the figures that are asked for first; a site without a map says so."""
    from rich.table import Table

    table = _plain(Table)
    found = {m.name for row in scores.rows for m in row.metrics}
    names = [name for name in SHORT if name in found]
    table.add_column("sequence", no_wrap=True)
    for name in names:
        table.add_column(SHORT[name], justify="right")
    failed = any(row.failure for row in scores.rows)
    if failed:
        table.add_column("no map, because")
    for row in scores.rows:
        values = {m.name: m.value for m in row.metrics}
        cells = [figure(values.get(name)) for name in names]
        table.add_row("/".join(part for part in (row.sequence, row.epoch) if part), *cells, *[row.failure] * failed)
    return table


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


def _plain(kind: type[Table]) -> Table:
    from rich import box

    return kind(box=box.ASCII2 if sys.stdout.encoding.lower() == "ascii" else box.SIMPLE_HEAD, pad_edge=False)
