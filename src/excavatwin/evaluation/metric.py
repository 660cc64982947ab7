"""A metric: what was measured, how much, in which unit."""

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
    """``"m"``, ``"GSD"``, ``"%"``, ``"deg"`` or ``"1"``."""
    meaning: str = ""
    """One phrase for the reader of a table."""

    def __str__(self) -> str:
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.name} {self.value:.4g}{unit}"
