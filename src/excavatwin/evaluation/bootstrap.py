"""Percentile bootstrap over sequences (Efron 1979): how far a mean could be off by the choice of the sequences.

The sequence is the unit, never the frame, cell or object: those of one sequence share its light, flight and site.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from excavatwin.errors import InputError
from excavatwin.evaluation.metric import Metric

Row = TypeVar("Row")

SAMPLES = 2000
"""Resamplings."""
LEVEL = 0.95
"""Share of the resampled values inside the interval."""


@dataclass(frozen=True)
class Interval:
    """A value with its interval."""

    value: float
    low: float
    """NaN with fewer than two sequences: one sequence tells nothing about the next."""
    high: float
    n: int
    """Sequences behind it."""

    @property
    def excludes_zero(self) -> bool:
        """Whether a difference is told apart from none."""
        return self.low > 0 or self.high < 0


def bootstrap(rows: Sequence[Row], statistic: Callable[[Sequence[Row]], float], seed: int = 0) -> Interval:
    """Any statistic of sequences, such as an mIoU of summed confusions.

    Args:
        rows: one entry a sequence.
        statistic: of a resampled list of them; resamplings for which it is NaN are left out.
    """
    n = len(rows)
    value = statistic(rows) if n else float("nan")
    if n < 2:
        return Interval(value, float("nan"), float("nan"), n)
    picks = np.random.default_rng(seed).integers(0, n, (SAMPLES, n))
    return _interval(value, np.array([statistic([rows[i] for i in pick]) for pick in picks], float), n)


def mean_interval(values: Float[np.ndarray, "n"] | Sequence[float], seed: int = 0) -> Interval:
    """Mean over sequences; a NaN (nothing to measure in that sequence) is left out, and ``n`` counts the others."""
    x = np.asarray(values, float)
    x = x[np.isfinite(x)]
    n = len(x)
    value = float(x.mean()) if n else float("nan")
    if n < 2:
        return Interval(value, float("nan"), float("nan"), n)
    picks = np.random.default_rng(seed).integers(0, n, (SAMPLES, n))
    return _interval(value, x[picks].mean(axis=1), n)


def paired_difference(
    ours: Float[np.ndarray, "n"] | Sequence[float], theirs: Float[np.ndarray, "n"] | Sequence[float], seed: int = 0
) -> Interval:
    """Mean of ours minus theirs, sequence by sequence: what both share (an easy site) drops out.

    Raises:
        InputError: the two are not paired.
    """
    a, b = np.asarray(ours, float), np.asarray(theirs, float)
    if a.shape != b.shape:
        raise InputError(f"paired values have {len(a)} and {len(b)} entries; give one of each per sequence.")
    return mean_interval(a - b, seed)


def _interval(value: float, resampled: np.ndarray, n: int) -> Interval:
    resampled = resampled[np.isfinite(resampled)]
    if not len(resampled):
        return Interval(value, float("nan"), float("nan"), n)
    tail = 100 * (1 - LEVEL) / 2
    low, high = np.percentile(resampled, (tail, 100 - tail))
    return Interval(value, float(low), float(high), n)


def over_sequences(tables: Mapping[str, Sequence[Sequence[Metric]]], seed: int = 0) -> tuple[Metric, ...]:
    """Mean of every metric over sequences with its interval.

    Args:
        tables: sequence -> metrics of each of its epochs; the epochs of one sequence are averaged first.

    Returns:
        Metrics in the order of their first appearance; the meaning tells in how many sequences there was a value
        where that is not all of them.
    """
    first: dict[str, Metric] = {}
    for epochs in tables.values():
        for metrics in epochs:
            for metric in metrics:
                first.setdefault(metric.name, metric)
    figures = []
    for name, metric in first.items():
        values = np.array([_mean_of(name, epochs) for epochs in tables.values()])
        interval = mean_interval(values, seed)
        few = f" ({interval.n} of {len(tables)} sequences)" if interval.n < len(tables) else ""
        low, high = (v if np.isfinite(v) else None for v in (interval.low, interval.high))
        figures.append(replace(metric, value=interval.value, low=low, high=high, meaning=metric.meaning + few))
    return tuple(figures)


def _mean_of(name: str, epochs: Sequence[Sequence[Metric]]) -> float:
    values = [m.value for metrics in epochs for m in metrics if m.name == name and np.isfinite(m.value)]
    return float(np.mean(values)) if values else float("nan")
