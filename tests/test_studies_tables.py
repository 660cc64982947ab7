"""Tables of studies: well-formed in every format; the paper's figures as printed."""

from __future__ import annotations

import csv
import io
import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from excavatwin.evaluation.dimensions import MeasuredObject
from excavatwin.evaluation.metric import Metric
from excavatwin.evaluation.published import PUBLISHED
from excavatwin.studies.ablation import BACKBONE, FULL, CaseResult, names
from excavatwin.studies.ablation_tables import ablation_tables, comparison, dimensions
from excavatwin.studies.paper_tables import ABLATION, GEOMETRY, SEMANTICS, published
from excavatwin.studies.table import Table, escaped, write_tables
from excavatwin.studies.tables import Ours, paper_tables

CELLS = st.one_of(st.none(), st.floats(width=32), st.text("ab|&%$#_{}~^\\<> -–", max_size=8))


def results(backbone: str = "yoloe", count: int = 4) -> list[CaseResult]:
    """Made-up results: the full method is 10 points above the rest of its case."""
    made = []
    for n in range(count):
        rows = {name: {"miou": 30.0 + n + 10 * (name == FULL), "coverage": 90.0} for name in names()}
        rows[FULL] |= {"elevation_mae": 0.1 + 0.01 * n, "elevation_rmse": 0.2, "elevation_fitted_mae": 0.05}
        rows["oracle: true geometry"] = {}
        thing = MeasuredObject(f"site {n}", "pipe", (1.1, 1.0, 1.0), (1.0, 1.0, 1.0))
        made.append(CaseResult(f"site {n}", backbone, rows, (thing,)))
    return made


@settings(deadline=None, max_examples=60)
@given(rows=st.lists(st.tuples(CELLS, CELLS, CELLS), max_size=4), title=st.text("a&_%|\\ ", max_size=8))
def test_every_format_has_every_cell(rows: list[tuple[str | float | None, ...]], title: str) -> None:
    table = Table(title, ("name_%", "b|c", "d & e"), tuple(rows), ("100 % of it_",))
    lines = [line for line in table.markdown().splitlines() if line.startswith("| ")]
    assert [len(re.findall(r"(?<!\\)\|", line)) for line in lines] == [4] * (len(rows) + 1)
    body = table.latex().split(r"\toprule")[1].split(r"\bottomrule")[0]
    filled = [line for line in body.splitlines() if line.endswith(r" \\")]
    assert [len(re.findall(r"(?<!\\)&", line)) for line in filled] == [2] * (len(rows) + 1)
    assert table.latex().count("{") - table.latex().count(r"\{") == table.latex().count("}") - table.latex().count(
        r"\}"
    )
    assert len(json.loads(table.json())["rows"]) == len(rows)
    assert [len(row) for row in csv.reader(io.StringIO(table.csv()))] == [3] * (len(rows) + 1)


@pytest.mark.parametrize(
    ("text", "expected"),
    [("50 % & more", r"50 \% \& more"), (r"a\b", r"a\textbackslash{}b"), ("w_{j}", r"w\_\{j\}"), ("≤", r"$\leq$")],
)
def test_latex_reads_no_command_out_of_a_text(text: str, expected: str) -> None:
    assert escaped(text) == expected


def test_tables_are_written_in_four_formats(tmp_path: Path) -> None:
    table = Table("t", ("a", "b"), (("x", 1.5), ("y", float("nan"))))
    written = write_tables([table, table], tmp_path / "out", "t")
    assert sorted(path.name for path in written) == ["t.json", "t.md", "t.tex", "t_1.csv", "t_2.csv"]
    assert json.loads((tmp_path / "out" / "t.json").read_text("utf-8"))[1]["rows"][1] == {"a": "y", "b": None}


def test_the_papers_figures_agree_with_those_of_evaluate() -> None:
    for dataset, rows in SEMANTICS.items():
        for backbone, row in rows.items():
            other = PUBLISHED[dataset][backbone]
            assert row[FULL] == (other["photo_miou"].value, other["photo_coverage"].value)
    for (task, dataset), (mae, rmse, _) in GEOMETRY.items():
        kind = "dimension" if task == "Object dimension" else "elevation"
        other = PUBLISHED[dataset]["yoloe"]
        assert (other[f"{kind}_mae"].value, other[f"{kind}_rmse"].value) == pytest.approx((mae / 100, rmse / 100))
    assert set(ABLATION["oces"]) == {name for name in names() if name.startswith("w/o")}
    assert published("oces", "mask2former", "w/o object support") is None


def test_a_difference_is_paired_by_case() -> None:
    table = comparison(results(), "yoloe", "oces", ())
    plain = next(row for row in table.rows if row[0] == "plain 3D voting")
    assert plain[1] == pytest.approx(31.5)
    assert plain[2] != "[31.50, 31.50]"  # the cases differ
    assert plain[3:5] == (pytest.approx(-10.0), "[-10.00, -10.00]")  # what they share drops out
    full = next(row for row in table.rows if row[0] == FULL)
    assert full[3] is None
    assert full[-2:] == (34.57, 80.40)
    assert not any(row[0] == "oracle: true geometry" for row in table.rows)


def test_tables_name_policy_strictness_and_seeds() -> None:
    tables = ablation_tables([*results(), *results("mask2former")], "seeds 3 to 6")
    assert len(tables) == 6
    for table in tables:
        text = " ".join(table.notes)
        assert "strict" in text
        assert "'task'" in text
        assert "seeds 3 to 6" in text
    assert "YOLOE-like" in tables[0].title
    assert "Mask2Former-like" in tables[3].title


def test_dimensions_are_taken_as_measured() -> None:
    found = {metric.name: metric for metric in dimensions(results())}
    assert found["dimension_other_object_mae"].value == pytest.approx(0.1 / 3)
    assert found["dimension_other_object_relative_error"].value == pytest.approx(10 / 3)
    assert dimensions([replace(results()[0], objects=())]) == ()


def test_the_papers_tables_have_our_column_beside_theirs() -> None:
    ours = Ours([*results(), *results("mask2former")], "seeds 3 to 6")
    geometry, semantics, ablation = paper_tables(ours)
    terrain = next(row for row in geometry.rows if row[:2] == ("Terrain elevation", "OCES"))
    assert terrain[2:4] == (12.61, pytest.approx(11.5))
    assert next(row for row in geometry.rows if row[1] == "RELLIS-3D")[3] is None
    assert semantics.rows[1] == ("YOLOE", "+ ours", 20.77, None, 90.52, None, 34.57, 41.5, 80.40, 90.0)
    assert ablation.rows[0] == (BACKBONE, 3.34, None, 2.57, None, 6.53, 31.5, 2.70, 90.0)
    assert [row[0] for row in ablation.rows][-1] == FULL
    assert "seeds 3 to 6" in " ".join(semantics.notes)


def test_given_data_fill_their_own_columns() -> None:
    def metric(name: str, value: float) -> Metric:
        return Metric(name, value, "m", "how")

    goose = {m.name: m for m in (metric("photo_miou", 40.0), metric("photo_coverage", 95.0))}
    rellis = {m.name: m for m in (metric("elevation_mae", 0.25), metric("elevation_rmse", 0.3))}
    box = {
        m.name: m for m in (metric("dimension_one_dimension_mae", 0.02), metric("dimension_one_dimension_rmse", 0.03))
    }
    ours = Ours(summaries={"goose-ex": goose, "rellis-3d": rellis, "objectron": box}, segmenter="yoloe")
    geometry, semantics, _ = paper_tables(ours)
    assert [row[3] for row in geometry.rows if row[1] in ("Objectron", "RELLIS-3D")][:2] == [2.0, 25.0]
    assert semantics.rows[1][2:6] == (20.77, 40.0, 90.52, 95.0)
    assert semantics.rows[3][3] is None  # the sites were not mapped with Mask2Former
