"""One of two maps that are compared: what a SITE folder says, read with every file that a comparison rests on."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from excavatwin.errors import InputError
from excavatwin.evaluation.site_folder import load_map
from excavatwin.scene.elevation_map import ElevationMap
from excavatwin.scene.taxonomy import NOT_OBSERVED, TaskClass

NEEDED = ("map.nc", "run.json", "objects.geojson", "cameras.json")
"""Files of a SITE that are read; a missing table of objects must not pass for a site without objects."""


@dataclass(frozen=True, eq=False)
class ComparedSite:
    """A SITE as far as it is compared."""

    folder: Path
    map: ElevationMap
    cameras: Mapping[str, Float64[np.ndarray, "3"]]
    """Camera centre of every placed photo by its name, in the map's frame M [m, or the map's unit]."""
    run: Mapping[str, Any]
    """The content of ``run.json``."""

    @property
    def backbones(self) -> str:
        """``"photogrammetry, appearance"``: who made its points and its evidence, as far as it says so."""
        source = self.run.get("source")
        named = source if isinstance(source, dict) else {}
        found = [str(named[role]) for role in ("reconstructor", "segmenter") if named.get(role)]
        return ", ".join(found) or "backbones not named"


def read_compared(folder: Path) -> ComparedSite:
    """A SITE folder that ``map`` or ``fuse`` wrote.

    Raises:
        InputError: no such folder, no SITE, a file of it is missing or damaged, or nothing in it is observed.
    """
    if not folder.is_dir():
        what = "is a file" if folder.exists() else "does not exist"
        raise InputError(f"{folder} {what}; give the SITE folder that `excavatwin map` or `fuse` wrote.")
    missing = [name for name in NEEDED if not (folder / name).is_file()]
    if NEEDED[0] in missing:
        raise InputError(f"{folder} is no SITE (no map.nc); give the folder that `excavatwin map` or `fuse` wrote.")
    if missing:
        raise InputError(f"{folder} lacks {missing[0]}, which a SITE holds; map it again.")
    try:
        m = load_map(folder)
        origin = np.array(m.georeference.origin if m.georeference else (0.0, 0.0, 0.0))
        run = json.loads((folder / "run.json").read_text("utf-8"))
        cameras = _centres(json.loads((folder / "cameras.json").read_text("utf-8")), origin)
    except InputError:
        raise
    except (OSError, ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
        raise InputError(f"{folder} is damaged ({type(error).__name__}: {error}); map it again.") from error
    _check(folder, m, run)
    return ComparedSite(folder, m, cameras, run)


def _centres(table: dict[str, Any], origin: Float64[np.ndarray, "3"]) -> dict[str, Float64[np.ndarray, "3"]]:
    return {
        str(camera["name"]): np.array(camera["T_map_cam"], float)[:3, 3] - origin
        for camera in table["cameras"]
        if camera["placed"]
    }


def _check(folder: Path, m: ElevationMap, run: object) -> None:
    known = [*map(int, TaskClass), NOT_OBSERVED]
    strange = np.setdiff1d(m.label, known)
    if strange.size:
        raise InputError(f"{folder} has the label {int(strange[0])}, which is no task class; map it again.")
    if not m.observed.any():
        raise InputError(f"{folder} observes no cell, so there is nothing to compare; map other photos.")
    if not isinstance(run, dict):
        raise InputError(f"{folder / 'run.json'} holds no table of a run; map it again.")
