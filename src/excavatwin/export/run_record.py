"""``run.json``: how the map came about. Also the one place where numpy, paths and NaN become JSON."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable, Mapping, Set
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from excavatwin import __version__
from excavatwin.export.placement import frame_sentence
from excavatwin.scene.site import Site


def run_record(site: Site, files: Iterable[str]) -> dict[str, Any]:
    """Versions, resolved configuration, inputs, stage times, peak memory, warnings, and what is in the folder."""
    g = site.map.georeference
    return {
        "excavatwin": __version__,
        **site.run,
        "map": {
            "rows": site.map.grid.rows,
            "columns": site.map.grid.cols,
            "cell": site.map.grid.cell,
            "unit": site.map.unit,
            "frame": frame_sentence(site.map),
            "epsg": g.epsg if g else None,
            "origin": g.origin if g else None,
            "objects": len(site.map.objects),
            "points": len(site.points.xyz),
        },
        "doubts": site.map.doubts,
        "provenance": site.map.provenance,
        "photos_placed": [view.name for view in site.views],
        "photos_unplaced": {photo.name: photo.reason for photo in site.unplaced},
        "files": sorted(files),
    }


def to_json(value: Any, indent: int | None = None) -> str:
    """JSON text; NaN and infinity, which JSON does not have, become null."""
    return json.dumps(_plain(value), indent=indent, allow_nan=False, ensure_ascii=False)


def _plain(value: Any) -> Any:
    """The same in dictionaries, lists, strings and numbers."""
    match value:
        case Enum():
            return value.name.lower()
        case bool() | int() | str() | None:
            return value
        case float() | np.floating():
            return float(value) if math.isfinite(value) else None
        case np.bool_() | np.integer():
            return value.item()
        case np.ndarray():
            return _plain(value.tolist())
        case Mapping():
            return {str(_plain(key)): _plain(item) for key, item in value.items()}
        case Path():
            return value.as_posix()
        case Set():
            return sorted((_plain(item) for item in value), key=str)
        case list() | tuple():
            return [_plain(item) for item in value]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {f.name: _plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
        return {"type": type(value).__name__, **fields}
    return str(value)
