"""A table of a study: to read (Markdown), to print (LaTeX with booktabs), to compute with (JSON, CSV)."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from excavatwin.scene.staging import whole_file

Cell = str | float | None
"""Text, a number, or nothing (was not measured)."""


@dataclass(frozen=True)
class Table:
    """Rows under column heads."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()
    """What a reader must know to understand the figures: protocol, policy, seeds."""
    digits: int = 2
    """Decimals of the numbers."""

    def text(self, cell: Cell) -> str:
        """A cell as it is read; a dash where nothing was measured."""
        if cell is None or (isinstance(cell, float) and math.isnan(cell)):
            return "–"
        return cell if isinstance(cell, str) else f"{cell:.{self.digits}f}"

    def markdown(self) -> str:
        """GitHub-flavoured Markdown."""
        lines = [f"## {self.title}", "", "| " + " | ".join(map(piped, self.columns)) + " |"]
        numeric = [all(not isinstance(row[i], str) for row in self.rows) for i in range(len(self.columns))]
        lines.append("|" + "|".join("---:" if right else "---" for right in numeric) + "|")
        lines += ["| " + " | ".join(piped(self.text(cell)) for cell in row) + " |" for row in self.rows]
        return "\n".join([*lines, "", *(f"- {note}" for note in self.notes), ""])

    def latex(self) -> str:
        """A ``table`` environment with booktabs rules."""
        head = " & ".join(escaped(name) for name in self.columns)
        body = [" & ".join(escaped(self.text(cell)) for cell in row) + r" \\" for row in self.rows]
        return "\n".join(
            [
                r"\begin{table}[h]", r"\centering", rf"\caption{{{escaped(self.title)}}}",
                rf"\begin{{tabular}}{{@{{}}{'l' + 'c' * (len(self.columns) - 1)}@{{}}}}", r"\toprule", head + r" \\",
                r"\midrule", *body, r"\bottomrule", r"\end{tabular}",
                *(rf"\par\footnotesize {escaped(note)}" for note in self.notes), r"\end{table}", "",
            ]
        )  # fmt: skip

    def csv(self) -> str:
        """Comma-separated, numbers in full precision, empty where nothing was measured."""
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows([["" if cell is None else cell for cell in row] for row in self.rows])
        return out.getvalue()

    def json(self) -> str:
        """One object a row under its column heads; null where nothing was measured."""
        rows = [{name: missing(cell) for name, cell in zip(self.columns, row, strict=True)} for row in self.rows]
        return json.dumps({"title": self.title, "notes": self.notes, "rows": rows}, indent=1, ensure_ascii=False)


def missing(cell: Cell) -> Cell:
    """None for NaN, which JSON does not know."""
    return None if isinstance(cell, float) and math.isnan(cell) else cell


def piped(text: str) -> str:
    """Text that stays in its cell of a Markdown table."""
    return text.replace("\\", "\\\\").replace("|", "\\|")


LATEX = {sign: "\\" + sign for sign in "&%$#_{}"} | {
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"$<$", ">": r"$>$",
    "–": "--", "±": r"$\pm$", "≥": r"$\geq$", "≤": r"$\leq$",
}  # fmt: skip


def escaped(text: str) -> str:
    """Text with the characters escaped that LaTeX reads as commands."""
    return "".join(LATEX.get(sign, sign) for sign in text)


def write_tables(tables: Sequence[Table], folder: Path, stem: str) -> list[Path]:
    """Write ``STEM.md``, ``STEM.tex``, ``STEM.json`` and ``STEM[_n].csv`` (one a table), each whole or not at all.

    Raises:
        OutputError: the folder cannot be written.
    """
    texts = {
        f"{stem}.md": "\n".join(table.markdown() for table in tables),
        f"{stem}.tex": "\n".join(table.latex() for table in tables),
        f"{stem}.json": "[" + ",\n".join(table.json() for table in tables) + "]\n",
    }
    for number, table in enumerate(tables, 1):
        texts[f"{stem}.csv" if len(tables) == 1 else f"{stem}_{number}.csv"] = table.csv()
    paths = []
    for name, text in texts.items():
        with whole_file(folder / name) as part:
            part.write(text.encode())
        paths.append(folder / name)
    return paths
