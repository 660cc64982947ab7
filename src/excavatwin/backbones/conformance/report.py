"""What the suite says about a backbone: one row a promise."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum


class Outcome(StrEnum):
    """What came of one promise."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_CHECKABLE = "not checkable"


@dataclass(frozen=True)
class Row:
    """One promise, and whether it is kept."""

    name: str
    outcome: Outcome
    sentence: str = ""
    """What was found, and for failures what to do; may be empty for a plain pass."""

    def __str__(self) -> str:
        return f"{self.outcome:<15}{self.name:<28}{self.sentence}".rstrip()


@dataclass(frozen=True)
class Report:
    """All rows about one backbone."""

    backbone: str
    """Name on its card, or of its class."""
    rows: tuple[Row, ...]

    @property
    def failed(self) -> tuple[Row, ...]:
        """Promises that are broken."""
        return tuple(row for row in self.rows if row.outcome == Outcome.FAILED)

    @property
    def not_checkable(self) -> tuple[Row, ...]:
        """Promises that nobody could look at here."""
        return tuple(row for row in self.rows if row.outcome == Outcome.NOT_CHECKABLE)

    @property
    def verdict(self) -> str:
        """One sentence."""
        failed, open_ = len(self.failed), len(self.not_checkable)
        passed = len(self.rows) - failed - open_
        left = f", {open_} not checkable here" if open_ else ""
        return f"{self.backbone}: {f'{failed} FAILED, ' if failed else ''}{passed} passed{left}."

    def row(self, name: str) -> Row:
        """The row of that name; KeyError when there is none."""
        return {row.name: row for row in self.rows}[name]

    def __str__(self) -> str:
        return "\n".join([*map(str, self.rows), self.verdict])


def passed(name: str, sentence: str = "") -> Row:
    """A promise that is kept."""
    return Row(name, Outcome.PASSED, sentence)


def failed(name: str, sentence: str) -> Row:
    """A promise that is broken."""
    return Row(name, Outcome.FAILED, sentence)


def unchecked(name: str, reason: str) -> Row:
    """A promise that nobody could look at here."""
    return Row(name, Outcome.NOT_CHECKABLE, reason)


def judged(name: str, mistakes: Iterable[str], sentence: str = "") -> Row:
    """Failed with all mistakes, or passed when there are none."""
    found = list(mistakes)
    return failed(name, "; ".join(found) + ".") if found else passed(name, sentence)
