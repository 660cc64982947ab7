"""Object dimensions without a leak: the scored dimension of an object never sets the scale that it is scored with.

A reconstruction has an arbitrary scale. Scaling it by the very object that is then measured makes any shape look
right, so each protocol says where the scale comes from: P1 ``camera_baseline``, P2 ``one_dimension`` (with
``class_mean_ratio``, the guess that needs no reconstruction, beside it), P3 ``other_object``, P4 ``metric_backbone``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from excavatwin.errors import InputError
from excavatwin.evaluation.bootstrap import Interval, bootstrap
from excavatwin.evaluation.metric import Metric
from excavatwin.scene.frames import umeyama


@dataclass(frozen=True)
class MeasuredObject:
    """One object with its dimensions as reconstructed and as they are, axis by axis."""

    sequence: str
    """Clip, flight or site: the unit of the bootstrap, and of "another" object of the class."""
    category: str
    measured: tuple[float, float, float]
    """Length, width, height, or x, y, z of the annotation [units of the reconstruction]; all above 0."""
    true: tuple[float, float, float]
    """The same axes [m]."""
    reconstruction: str = ""
    """What shares one scale, where a sequence was reconstructed several times; else the sequence."""

    @property
    def scaled_by(self) -> str:
        """Key of the scale."""
        return self.reconstruction or self.sequence


@dataclass(frozen=True)
class Estimates:
    """Dimensions in metres under one protocol."""

    protocol: str
    """``camera_baseline``, ``one_dimension``, ``class_mean_ratio``, ``other_object`` or ``metric_backbone``."""
    scale: Float64[np.ndarray, "n"]
    """Metres per unit that each object was given; NaN where the protocol has none for it."""
    size: Float64[np.ndarray, "n 3"]
    """Estimated dimensions [m]; NaN where there is no scale."""
    scored: Bool[np.ndarray, "n 3"]
    """Dimensions that may be compared: never the one that set the scale."""


def camera_scale(reconstructed: Float64[np.ndarray, "S 3"], true: Float64[np.ndarray, "S 3"]) -> float:
    """Metres per unit by the least-squares similarity of camera centres (Umeyama, PAMI 1991).

    Raises:
        InputError: fewer than three cameras, or all in one place.
    """
    if len(reconstructed) < 3 or np.ptp(reconstructed, axis=0).max() <= 0:
        raise InputError(f"{len(reconstructed)} cameras do not fix a scale; at least three apart are needed.")
    return umeyama(np.asarray(reconstructed, float), np.asarray(true, float), np.ones(len(true)))[0]


def camera_baseline(objects: Sequence[MeasuredObject], scale_of: Mapping[str, float]) -> Estimates:
    """P1: one scale a reconstruction, from its camera centres (``camera_scale``); all three dimensions are scored."""
    scale = np.array([scale_of.get(o.scaled_by, np.nan) for o in objects], float)
    return _scaled("camera_baseline", objects, scale, np.ones((len(objects), 3), bool))


def metric_backbone(objects: Sequence[MeasuredObject], scale_of: Mapping[str, float] | float = 1.0) -> Estimates:
    """P4: the scale that the reconstruction itself declares, without any anchor in the scene."""
    scales = [scale_of if isinstance(scale_of, float | int) else scale_of.get(o.scaled_by, np.nan) for o in objects]
    return _scaled("metric_backbone", objects, np.array(scales, float), np.ones((len(objects), 3), bool))


def one_dimension(objects: Sequence[MeasuredObject]) -> Estimates:
    """P2: the longest true edge of the object sets the scale; only the other two are scored."""
    measured, true = _sizes(objects)
    longest, rows = _longest(true), np.arange(len(objects))
    scored = np.ones((len(objects), 3), bool)
    scored[rows, longest] = False
    return _scaled("one_dimension", objects, true[rows, longest] / measured[rows, longest], scored)


def class_mean_ratio(objects: Sequence[MeasuredObject]) -> Estimates:
    """What P2 must beat: the longest edge times the mean proportions of the class, without looking at any photo.

    The means are over the other *sequences'* objects of the category, so an object does not predict itself.
    """
    _, true = _sizes(objects)
    longest, rows = _longest(true), np.arange(len(objects))
    size, scored = np.full((len(objects), 3), np.nan), np.ones((len(objects), 3), bool)
    scored[rows, longest] = False
    for i, o in enumerate(objects):
        others = [j for j, b in enumerate(objects) if b.category == o.category and b.sequence != o.sequence]
        if others:
            proportions = true[others] / true[others][:, [longest[i]]]
            size[i] = proportions.mean(axis=0) * true[i, longest[i]]
    return Estimates("class_mean_ratio", np.full(len(objects), np.nan), size, scored)


def other_object(objects: Sequence[MeasuredObject]) -> Estimates:
    """P3: the median, over the *other* objects of the reconstruction, of true over measured longest edge."""
    measured, true = _sizes(objects)
    longest, rows = _longest(true), np.arange(len(objects))
    factor = true[rows, longest] / measured[rows, longest]
    scale = np.full(len(objects), np.nan)
    for i, o in enumerate(objects):
        others = [j for j, b in enumerate(objects) if j != i and b.scaled_by == o.scaled_by]
        if others:
            scale[i] = np.median(factor[others])
    return _scaled("other_object", objects, scale, np.ones((len(objects), 3), bool))


def dimension_metrics(
    estimates: Estimates, objects: Sequence[MeasuredObject], name: str = "dimension"
) -> tuple[Metric, ...]:
    """MAE, RMSE and relative error over all scored dimensions, with bootstrap intervals over sequences.

    Objects without a scale are not scored, and ``NAME_PROTOCOL_objects`` tells how many were.
    """
    _, true = _sizes(objects)
    usable = estimates.scored & np.isfinite(estimates.size)
    error = np.where(usable, estimates.size - true, np.nan)
    size, relative = np.abs(error), 100 * np.abs(error) / true
    head, how = f"{name}_{estimates.protocol}", MEANING[estimates.protocol]
    kinds: tuple[tuple[str, str, str, np.ndarray, Callable[[np.ndarray], float]], ...] = (
        ("mae", "m", "mean absolute error of dimensions", size, np.mean),
        ("rmse", "m", "root mean square error of dimensions", error, lambda e: np.sqrt(np.mean(e**2))),
        ("relative_error", "%", "mean error of dimensions, of the true ones", relative, np.mean),
        ("relative_error_median", "%", "median of the same", relative, np.median),
    )
    sequence, category = np.array([o.sequence for o in objects]), np.array([o.category for o in objects])
    figures = []
    for kind, unit, meaning, values, statistic in kinds:
        interval = _over_sequences(values, sequence, statistic)
        low, high = (v if np.isfinite(v) else None for v in (interval.low, interval.high))
        figures.append(Metric(f"{head}_{kind}", interval.value, unit, f"{meaning}; {how}", None, low, high))
    scored = int(usable.any(axis=1).sum())
    figures.append(Metric(f"{head}_objects", scored, "1", f"objects scored, of {len(objects)}; {how}"))
    for one in np.unique(category) if len(np.unique(category)) > 1 else ():
        value = _over_sequences(relative[category == one], sequence[category == one], np.median).value
        meaning = f"median relative error of {one}; {how}"
        figures.append(Metric(f"{head}_relative_error_median_{one}", value, "%", meaning))
    return tuple(figures)


def _over_sequences(
    values: Float64[np.ndarray, "n 3"], sequence: np.ndarray, statistic: Callable[[np.ndarray], float]
) -> Interval:
    """A statistic of all finite values, resampled by sequence."""
    rows = [values[sequence == s] for s in np.unique(sequence)]
    rows = [row[np.isfinite(row)] for row in rows if np.isfinite(row).any()]
    return bootstrap(rows, lambda chosen: float(statistic(np.concatenate(chosen))))


MEANING = {
    "camera_baseline": "P1, scale from the camera centres",
    "one_dimension": "P2, scale from the longest edge, the other two scored",
    "class_mean_ratio": "guess for P2 from the class's mean proportions, no reconstruction",
    "other_object": "P3, scale from the other objects of the sequence",
    "metric_backbone": "P4, the reconstruction's own scale, no anchor",
}
"""Where each protocol has its scale from."""


def _scaled(
    protocol: str, objects: Sequence[MeasuredObject], scale: Float64[np.ndarray, "n"], scored: Bool[np.ndarray, "n 3"]
) -> Estimates:
    measured, _ = _sizes(objects)
    return Estimates(protocol, scale, measured * scale[:, None], scored)


def _sizes(objects: Sequence[MeasuredObject]) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
    measured = np.array([o.measured for o in objects], float).reshape(-1, 3)
    true = np.array([o.true for o in objects], float).reshape(-1, 3)
    if not ((measured > 0).all() and (true > 0).all()):
        raise InputError("an object has a dimension of zero or less; leave objects without extent out.")
    return measured, true


def _longest(true: Float64[np.ndarray, "n 3"]) -> np.ndarray:
    return true.argmax(axis=1) if len(true) else np.zeros(0, int)
