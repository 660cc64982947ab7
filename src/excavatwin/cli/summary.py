"""The last screen of a run: what was mapped, how far to trust it, where it lies and what to do next."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from excavatwin.cli.console import say, wrapped
from excavatwin.scene.elevation_map import ElevationMap
from excavatwin.scene.site import Site
from excavatwin.scene.taxonomy import Reason, class_name

#: File or folder of a SITE -> what it holds, and what opens it.
FILES = {
    "map.nc": "every layer; Python (xarray), QGIS, Panoply",
    "elevation.tif": "terrain elevation; QGIS, ArcGIS, GDAL",
    "label.tif": "class of every cell, with colours; QGIS, ArcGIS, GDAL",
    "points.laz": "fused points with class and colour; CloudCompare, QGIS",
    "objects.geojson": "machines and obstacles; QGIS",
    "objects_wgs84.geojson": "the same in longitude and latitude; web maps, Google Earth",
    "labels": "class of every pixel of every photo (PNG); any image viewer",
    "cameras.json": "where every photo was taken; any text editor",
    "preview.png": "photo, classes and relief at a glance; any image viewer",
    "run.json": "versions, parameters, times, warnings; any text editor",
    "README.txt": "which program opens what, the frame, what to doubt",
}


def say_result(site: Site, folder: Path, command: str) -> None:
    """Print the result of a run.

    Args:
        site: what the run left behind.
        folder: where it was written.
        command: the command that was run, as a start for the next one.
    """
    facts = (*headline(site), "", *table(site), *_doubts(site), *_terms(site))
    say(*facts, "", *files(folder), "", *_next(site, folder, command))


def headline(site: Site) -> list[str]:
    """How many photos were mapped, in what time, and which were not."""
    photos = site.run["photos"]
    seconds, memory = site.run["seconds"], site.run["peak_memory_bytes"]
    lines = [
        f"mapped {photos['placed']} of {photos['found']} photos in {duration(seconds)}, "
        f"peak memory {memory / 1e9:.2f} GB"
    ]
    for row in photos["unplaced"]:
        lines += wrapped("  not used: ", f"{row['name']}: {row['reason']}")
    return lines


def table(site: Site) -> list[str]:
    """The result in figures."""
    m = site.map
    grid, unit = m.grid, m.unit
    rows = [
        ("size", f"{grid.cols * grid.cell:.1f} x {grid.rows * grid.cell:.1f} {unit}, cells of {grid.cell:.3g} {unit}"),
        ("coverage", _coverage(m)),
        ("elevation", _elevation(m)),
        ("scale", _scale(m)),
        ("vertical", f"from {site.run['source'].get('gravity', 'the observations')}"),
        ("objects", _objects(m)),
        ("stages", " · ".join(_stages(site.run["stages"]))),
    ]
    return [line for name, text in rows for line in wrapped(f"  {name:<11}", text)]


def _coverage(m: ElevationMap) -> str:
    seen = m.observed.astype(bool)
    if not seen.any():
        return "no cell is observed"
    ground, known = np.isfinite(m.elevation), (m.reason == Reason.CLASSIFIED) & seen
    return (
        f"{seen.mean():.0%} of the cells observed; of these {(ground & seen).sum() / seen.sum():.0%} with terrain "
        f"elevation, {known.sum() / seen.sum():.0%} with a known class"
    )


def _elevation(m: ElevationMap) -> str:
    if not np.isfinite(m.elevation).any():
        return "no terrain found"
    low, high = np.nanpercentile(m.elevation, (1, 99))
    base = m.georeference.origin[2] if m.georeference else 0.0
    std = (
        f", standard deviation within the map {np.nanmedian(m.elevation_std):.2g} {m.unit}"
        if np.isfinite(m.elevation_std).any()
        else ""
    )
    return f"{low + base:.2f} to {high + base:.2f} {m.unit}{std}"


def _scale(m: ElevationMap) -> str:
    if m.georeference:
        known = m.georeference
        if np.isnan(known.residual):
            return f"metres, EPSG:{known.epsg}, as the files of the reconstruction say; the photos carry no GPS"
        return f"metres, EPSG:{known.epsg}; camera positions agree with GPS within {known.residual:.2f} m (RMS)"
    return "metres" if m.metric else "arbitrary unit: no metric scale is known"


def _objects(m: ElevationMap) -> str:
    counts = Counter(class_name(o.task_class) for o in m.objects)
    if not counts:
        return "none"
    return ", ".join(f"{n} {name}{'s' if n > 1 else ''}" for name, n in sorted(counts.items()))


def _stages(stages: dict[str, dict[str, Any]]) -> list[str]:
    texts = []
    for name, row in stages.items():
        cached = row.get("cached")
        part = f", {cached} cached" if cached and cached is not True and cached < row.get("photos", 0) else ", cached"
        texts.append(f"{name} {row['seconds']:.1f} s{part if cached else ''}")
    return texts


def _doubts(site: Site) -> list[str]:
    warnings = site.run.get("warnings", [])
    return ["", "Doubts:", *(line for text in warnings for line in wrapped("  ! ", text))] if warnings else []


def _terms(site: Site) -> list[str]:
    terms = site.run.get("terms", [])
    return ["", "Terms:", *(line for text in terms for line in wrapped("  ! ", text))] if terms else []


def files(folder: Path) -> list[str]:
    """What was written, and what opens it."""
    lines = [f"results saved to {folder}"]
    return lines + [f"  {name:<23}{what}" for name, what in FILES.items() if (folder / name).exists()]


def _next(site: Site, folder: Path, command: str) -> list[str]:
    if not site.map.metric and site.views:
        name = site.views[0].name
        return ["next, for metres:", f'  {command} --reference "{name}:x1,y1:x2,y2=METRES"']
    return ["next:", f"  qgis {folder / 'elevation.tif'} {folder / 'label.tif'} {folder / 'objects.geojson'}"]


def duration(seconds: float) -> str:
    """``"42.1 s"``, ``"2 min 31 s"``."""
    return f"{seconds:.1f} s" if seconds < 60 else f"{int(seconds) // 60} min {int(seconds) % 60} s"
