"""How two maps came about, side by side: backbones, versions and parameters that differ, from their ``run.json``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

ABSENT = "-"
"""A parameter that one of the runs does not have."""
SECTIONS = {"config": "", "source": "source", "versions": "versions", "terms": "terms"}
"""Table of ``run.json`` -> prefix of its entries; parameters stand under the names of their flags."""


@dataclass(frozen=True)
class Difference:
    """One entry of ``run.json`` that is not the same in both."""

    name: str
    """Dotted, as the flag: ``mapper.decision.tau``."""
    a: str
    b: str


def run_differences(a: Mapping[str, Any], b: Mapping[str, Any]) -> tuple[Difference, ...]:
    """Backbones, versions and parameters that differ, photos last; times and paths are not compared.

    Where a stage was put in the place of another, that is one entry: its parameters have no counterparts.
    """
    found: list[Difference] = []
    for section, prefix in SECTIONS.items():
        found += _differences(prefix, a.get(section, {}), b.get(section, {}))
    found += _differences("excavatwin", a.get("excavatwin"), b.get("excavatwin"))
    return (*found, *_photos(a, b))


def _differences(name: str, a: Any, b: Any) -> list[Difference]:
    tables = isinstance(a, dict) and isinstance(b, dict)
    if not tables or a.get("stage") != b.get("stage"):
        return [] if a == b else [Difference(name, _brief(a), _brief(b))]
    rows: list[Difference] = []
    for key in [*a, *(key for key in b if key not in a)]:
        rows += _differences(f"{name}.{key}".lstrip("."), a.get(key), b.get(key))
    return rows


def _brief(value: Any) -> str:
    if value is None:
        return ABSENT
    if isinstance(value, dict):
        return str(value.get("stage") or ", ".join(map(str, value)) or ABSENT)
    return str(value)


def _photos(a: Mapping[str, Any], b: Mapping[str, Any]) -> list[Difference]:
    """Photos by content, whatever they are called; and how many were placed."""
    sides = [set(_table(_table(run, "input"), "files").values()) for run in (a, b)]
    rows = []
    if sides[0] != sides[1]:
        common = len(sides[0] & sides[1])
        said = [f"{len(side)} files, {common} of them in both" for side in sides]
        rows.append(Difference("input.files", said[0], said[1]))
    placed = [_table(run, "photos").get("placed") for run in (a, b)]
    if placed[0] != placed[1]:
        rows.append(Difference("photos.placed", _brief(placed[0]), _brief(placed[1])))
    return rows


def _table(run: Mapping[str, Any], name: str) -> dict[str, Any]:
    value = run.get(name)
    return value if isinstance(value, dict) else {}
