"""A series of maps of one site: what was moved between them, how good the last one is, how often one came."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from excavatwin.errors import InputError
from excavatwin.evaluation.metric import Metric
from excavatwin.evaluation.volume import Survey, Volumes, detected, levelled, survey_change, volume_metrics, volumes
from excavatwin.scene.truth import Truth


def change_metrics(
    before: Survey, after: Survey, truths: tuple[Truth, Truth], stated: Volumes | None = None
) -> tuple[Metric, ...]:
    """Volumes between two epochs: as the maps stand, and ``*_levelled_*`` after bringing both to one level.

    The second uses the two maps alone (``volume.levelled``) and counts detected changes only (``volume.detected``):
    what a surveyor does with two flights.

    Args:
        truths: of the two epochs, on one grid; both maps are already in their frame.
        stated: the true volumes where they are known better than by these rasters.

    Raises:
        InputError: the truths are on different grids.
    """
    grid = truths[0].grid
    if truths[1].grid != grid:
        raise InputError("the truths of two epochs lie on different grids; their volumes cannot be compared.")
    raw, sigma = survey_change(before, after, grid)
    true = truths[1].height.astype(float) - truths[0].height
    region = np.isfinite(true)
    whole = stated or volumes(true, grid.cell, region)
    shared = volumes(np.where(np.isfinite(raw), true, np.nan), grid.cell, region)
    level = detected(levelled(raw), sigma)
    return (
        *volume_metrics("volume", volumes(raw, grid.cell, region), whole, shared),
        *(
            metric
            for metric in volume_metrics("volume_levelled", volumes(level, grid.cell, region), whole, shared, LEVELLED)
            if not metric.name.endswith(("_area", "_share", "_hidden"))  # they are the same
        ),
    )


LEVELLED = "both maps on one level, detected changes only"


def final_terrain_metrics(epochs: Sequence[Sequence[Metric]]) -> tuple[Metric, ...]:
    """Terrain error of the last epoch, when the work is done; nothing for a series of one."""
    if len(epochs) < 2:
        return ()
    last = {metric.name: metric for metric in epochs[-1]}
    return tuple(
        Metric(f"final_terrain_{kind}", last[name].value, last[name].unit, f"{last[name].meaning}, last epoch")
        for kind, name in (
            ("mae", "elevation_mae"),
            ("rmse", "elevation_rmse"),
            ("fitted_mae", "elevation_fitted_mae"),
            ("completeness", "elevation_completeness"),
        )
        if name in last
    )


def update_interval_metrics(times: Sequence[float]) -> tuple[Metric, ...]:
    """How often a map came: statistics of the intervals between successive times; nothing below two of them.

    Args:
        times: when each map was there [s], of any origin.

    Raises:
        InputError: the times do not ascend.
    """
    t = np.asarray(times, float)
    gaps = np.diff(t)
    if (gaps < 0).any():
        raise InputError("the times of a series of maps do not ascend; sort the maps by time.")
    if not len(gaps):
        return ()
    figures = (
        ("mean", float(gaps.mean()), "mean time between two maps"),
        ("median", float(np.median(gaps)), "median time between two maps"),
        ("p95", float(np.percentile(gaps, 95)), "95 % of the maps come sooner after the one before"),
        ("max", float(gaps.max()), "longest time without a new map"),
    )
    return tuple(Metric(f"update_interval_{kind}", value, "s", meaning) for kind, value, meaning in figures)
