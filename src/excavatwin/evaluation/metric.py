"""A metric: what was measured, how much, in which unit, within which interval, and what the paper has."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Metric:
    """One figure."""

    name: str
    """Lower-case words and underscores; the parts of a family share their first word."""
    value: float
    """NaN where there was nothing to measure."""
    unit: str
    """``"m"``, ``"m2"``, ``"m3"``, ``"s"``, ``"GSD"``, ``"%"``, ``"deg"`` or ``"1"``."""
    meaning: str = ""
    """One phrase for the reader of a table; for an mIoU it names "strict" or "selective", and the policy."""
    paper: float | None = None
    """The paper's value in the same unit (``published.with_paper``); None where it has none."""
    low: float | None = None
    """Lower end of the bootstrap interval (``bootstrap``); None for a single measurement."""
    high: float | None = None
    """Upper end of it."""

    def __str__(self) -> str:
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.name} {self.value:.4g}{unit}"
