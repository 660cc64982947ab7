"""All figures of a map against its truth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from excavatwin.evaluation.alignment import Alignment, align, alignment_metrics, shifted
from excavatwin.evaluation.elevation import elevation_metrics
from excavatwin.evaluation.metric import Metric
from excavatwin.evaluation.objects import object_metrics
from excavatwin.evaluation.semantics import TASK_POLICY, confusion, map_scores, photo_confusion, semantic_metrics
from excavatwin.evaluation.site_folder import load_map, load_views
from excavatwin.scene.elevation_map import ElevationMap
from excavatwin.scene.site import MappedView, Site
from excavatwin.scene.taxonomy import NOT_OBSERVED
from excavatwin.scene.truth import Truth


def read_site(site: Site | ElevationMap | str | Path) -> tuple[ElevationMap, tuple[MappedView, ...]]:
    """Map and placed photos in the map's frame M, of a site, of its map alone, or of a SITE folder.

    Raises:
        InputError: the folder holds no map.
    """
    if isinstance(site, (str, Path)):
        m = load_map(Path(site))
        return m, load_views(Path(site), m.georeference.origin if m.georeference else (0.0, 0.0, 0.0))
    return (site.map, site.views) if isinstance(site, Site) else (site, ())


def evaluate_site(
    site: Site | ElevationMap | str | Path,
    truth: Truth,
    offset: Sequence[float] | None = None,
    *,
    way: str = "auto",
    elevation: Truth | None = None,
    policy: str = TASK_POLICY,
) -> tuple[Metric, ...]:
    """Elevation, classes (of the map, and of the photos where refined labels are at hand) and objects against truth.

    Args:
        site: a site, its map alone, or a SITE folder.
        offset: what to add to the map's coordinates to have them in the truth's frame [m]; else ``way`` decides.
        way: how to bring both into one frame, see ``alignment.align``.
        elevation: heights to score against instead of the truth's, in its frame (``reference.in_frame_of``).
        policy: class mapping by which the truth's classes came about; it stands beside every mIoU.

    Raises:
        InputError: map and truth cannot be brought into one frame, or the folder holds no map.
    """
    m, views = read_site(site)
    alignment = align(m, views, truth, way) if offset is None else shifted(offset)
    return score(m, views, truth, alignment, elevation, policy)


def score(
    m: ElevationMap,
    views: Sequence[MappedView],
    truth: Truth,
    alignment: Alignment,
    elevation: Truth | None = None,
    policy: str = TASK_POLICY,
) -> tuple[Metric, ...]:
    """The same for what is already read and aligned."""
    return (
        *elevation_metrics(m, elevation or truth, alignment),
        *map_scores(m, truth, alignment, policy),
        *photo_metrics(views, truth, policy),
        *object_metrics([alignment.moved(o) for o in m.objects], truth),
        *alignment_metrics(alignment),
    )


def photo_metrics(views: Sequence[MappedView], truth: Truth, policy: str = TASK_POLICY) -> tuple[Metric, ...]:
    """Refined label images against the true classes of the photos' pixels; nothing without such images."""
    if not views or not truth.views:
        return ()
    return semantic_metrics("photo", photo_confusion(views, truth), "the photos' pixels", policy)


def unmapped_metrics(truth: Truth, policy: str = TASK_POLICY) -> tuple[Metric, ...]:
    """What a site scores of which no map could be made: nothing has a class, nothing is found, nothing is complete.

    Leaving such a site out would make a method look better the more often it fails.
    """
    nothing = np.full(truth.label.size, NOT_OBSERVED, np.uint8)
    return (
        Metric("elevation_completeness", 0.0, "%", "share of the terrain with a height"),
        *semantic_metrics("map", confusion(nothing, truth.label.ravel()), "the truth's cells", policy),
        *(semantic_metrics("photo", photo_confusion((), truth), "the photos' pixels", policy) if truth.views else ()),
        Metric("object_recall", 0.0 if truth.objects else float("nan"), "%", f"of {len(truth.objects)} true objects"),
    )
