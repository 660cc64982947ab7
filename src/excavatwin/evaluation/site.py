"""All figures of a map against its truth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from excavatwin.evaluation.elevation import elevation_metrics
from excavatwin.evaluation.frame import offset_to_truth
from excavatwin.evaluation.metric import Metric
from excavatwin.evaluation.objects import object_metrics
from excavatwin.evaluation.semantics import map_confusion, photo_confusion, semantic_metrics
from excavatwin.evaluation.site_folder import load_map, load_views
from excavatwin.scene.elevation_map import ElevationMap
from excavatwin.scene.site import MappedView, Site
from excavatwin.scene.truth import Truth


def evaluate_site(
    site: Site | ElevationMap | str | Path, truth: Truth, offset: Sequence[float] | None = None
) -> tuple[Metric, ...]:
    """Elevation, classes (of the map, and of the photos where refined labels are at hand) and objects against truth.

    Args:
        site: a site, its map alone, or a SITE folder.
        offset: what to add to the map's coordinates to have them in the truth's frame [m]; worked out from the two
            georeferences when not given.

    Raises:
        InputError: map and truth cannot be brought into one frame, or the folder holds no map.
    """
    views: Sequence[MappedView] = ()
    if isinstance(site, (str, Path)):
        m, views = load_map(Path(site)), load_views(Path(site))
    elif isinstance(site, Site):
        m, views = site.map, site.views
    else:
        m = site
    shift = offset_to_truth(m, truth) if offset is None else np.asarray(offset, float)
    return (
        *elevation_metrics(m, truth, shift),
        *semantic_metrics("map", map_confusion(m, truth, shift), "the truth's cells"),
        *(semantic_metrics("photo", photo_confusion(views, truth), "the photos' pixels") if views else ()),
        *object_metrics(m.objects, truth, shift),
    )
