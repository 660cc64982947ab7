"""What the validator says: one noun for everything that is wrong or doubtful about observations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum


class Severity(StrEnum):
    """What should follow from a finding."""

    REFUSE = "refuse"
    """A map made from this would be wrong."""
    REPORT = "report"
    """The user should know; a map can be made."""


@dataclass(frozen=True)
class Finding:
    """One mistake, or one doubt."""

    severity: Severity
    what: str
    """What was found, a clause that names views and figures."""
    cause: str = ""
    """The mistake that explains it, named; empty when no usual one does, and for doubts that are no mistake."""
    remedy: str = ""
    """What to do about it, an imperative clause."""
    figures: Mapping[str, float] = field(default_factory=dict)
    """The figures behind it by name, with the unit as a suffix (``shift_x_px``)."""

    def __str__(self) -> str:
        """One sentence: what was found, why, what to do."""
        cause = f"; most likely {self.cause}" if self.cause else ""
        return f"{self.what}{cause}{f'; {self.remedy}' if self.remedy else ''}."


def refusal(what: str, cause: str = "", remedy: str = "", **figures: float) -> Finding:
    """A finding that must stop the work."""
    return Finding(Severity.REFUSE, what, cause, remedy, figures)


def report(what: str, cause: str = "", remedy: str = "", **figures: float) -> Finding:
    """A finding that the user should know."""
    return Finding(Severity.REPORT, what, cause, remedy, figures)


def named(names: list[str], total: int) -> str:
    """``"3 of 12 views (a.jpg, b.jpg, c.jpg)"``."""
    listed = ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
    return f"{len(names)} of {total} views ({listed})"
