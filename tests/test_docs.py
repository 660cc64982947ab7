"""The documentation holds: the conventions page runs, commands exist, tables agree with the code."""

from __future__ import annotations

import re
import shlex
import tomllib
from pathlib import Path

import pytest

from test_cli import observations

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
EQUATIONS_PAGE = ROOT / "docs" / "equations.md"
_BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.DOTALL | re.MULTILINE)


def blocks(page: Path, language: str) -> list[str]:
    return [text for kind, text in _BLOCK.findall(page.read_text()) if kind == language]


def test_conventions_page_runs() -> None:
    page = ROOT / "docs" / "conventions.md"
    source = page.read_text()
    namespace: dict[str, object] = {"__name__": "conventions"}
    for match in _BLOCK.finditer(source):
        if match[1] == "python":
            line = source.count("\n", 0, match.start(2))
            exec(compile("\n" * line + match[2], str(page), "exec"), namespace)
    assert namespace["K"] == 5


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_and_pictures_lead_somewhere(page: Path) -> None:
    targets = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text())
    missing = [t for t in targets if not re.match(r"\w+:", t) and not (page.parent / t).exists()]
    assert not missing


def test_commands_of_the_readme_exist() -> None:
    from excavatwin.cli.app import app
    from excavatwin.cli.flags import split_stage_flags

    commands = set(app)
    seen = set()
    for text in [*blocks(ROOT / "README.md", "console"), *blocks(ROOT / "README.md", "sh")]:
        for line in text.replace("\\\n", " ").splitlines():
            words = shlex.split(line.removeprefix("$ "), comments=True)
            if words[:1] != ["excavatwin"]:
                continue
            assert words[1] in commands
            seen.add(words[1])
            words, _ = split_stage_flags(words[1:])
            app.parse_args([word for word in words if word != ">"][: words.index(">") if ">" in words else None])
    assert {"map", "fuse", "doctor"} <= seen


def test_python_of_the_readme_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    called: list[tuple[str, ...]] = []
    observations(tmp_path / "observations.npz")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "excavatwin.survey.map_photos", lambda *words: called.append(words)
    )  # minutes: tested elsewhere
    for text in blocks(ROOT / "README.md", "python"):
        exec(compile(text, "README.md", "exec"), {})
    assert called == [("photos", "site")]


def test_make_targets_of_the_readme_exist() -> None:
    targets = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert set(re.findall(r"\bmake (demo|test|lint)\b", (ROOT / "README.md").read_text())) <= set(targets)


def test_help_names_every_file_of_a_site() -> None:
    from excavatwin.cli.summary import FILES

    readme = (ROOT / "README.md").read_text()
    assert [name for name in FILES if f"`{name}" not in readme] == []


def equation_table() -> str:
    """The table of docs/equations.md, from the code: label, what it states, its one function, its naive twin."""
    import excavatwin.mapper  # noqa: F401 - claims the labels
    from excavatwin.paper import CLAIMS, EQUATIONS
    from test_equations import TWINS

    rows = ["| label | what it states | function | naive twin |", "|---|---|---|---|"]
    for label, statement in EQUATIONS.items():
        place = _source_of(CLAIMS[label])
        function = CLAIMS[label].removeprefix("excavatwin.")
        rows.append(f"| `{label}` | {statement} | [`{function}`](../{place}) | `{TWINS[label]}` |")
    return "\n".join(rows) + "\n"


def _source_of(name: str) -> Path:
    parts = name.split(".")
    places = [Path("src", *parts[:n]).with_suffix(".py") for n in range(len(parts), 0, -1)]
    return next(place for place in places if (ROOT / place).exists())


def test_equation_table_is_that_of_the_code() -> None:
    """After a change: ``python tests/test_docs.py`` writes the table anew."""
    assert equation_table() in EQUATIONS_PAGE.read_text()


def test_constraints_are_plain_versions() -> None:
    lines = [row for row in (ROOT / "constraints.txt").read_text().splitlines() if not row.startswith("#")]
    assert all(re.fullmatch(r"[a-z0-9-]+==[\w.]+", line) for line in lines)
    pinned = {line.split("==")[0] for line in lines}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = {re.split(r"[\[>=<]", need)[0] for need in project["dependencies"]}
    assert wanted <= pinned


def test_changelog_has_this_version() -> None:
    import excavatwin

    assert f"## [{excavatwin.__version__}]" in (ROOT / "CHANGELOG.md").read_text()


if __name__ == "__main__":
    text = EQUATIONS_PAGE.read_text()
    EQUATIONS_PAGE.write_text(re.sub(r"(\|.*\n)+", lambda _: equation_table(), text, count=1))
