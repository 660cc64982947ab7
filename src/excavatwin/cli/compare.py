"""``excavatwin compare``: the same site mapped twice."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter


def compare_command(
    site_a: Path,
    site_b: Path,
    /,
    *,
    align: Literal["auto", "declared", "cameras"] = "auto",
    output: Annotated[Path | None, Parameter(name=["--output", "-o"])] = None,
) -> None:
    """Compare two maps of one site: heights, classes, coverage, objects, and how they were made.

    Parameters
    ----------
    site_a
        SITE folder that `map` or `fuse` wrote. Its grid, its frame and its unit are those of the comparison.
    site_b
        Another SITE folder of the same site. Differences are B minus A.
    align
        How B comes into A's frame: declared (georeferences), cameras (photos of equal names: turn about the vertical
        and shift; scale only where a map has none), or auto (declared where both are georeferenced, else cameras).
    output
        Folder for comparison.json, comparison.csv, comparison.png and difference.tif.
    """
    from excavatwin.cli.compare_report import report
    from excavatwin.cli.console import say
    from excavatwin.studies.site_comparison import compare_folders, write_comparison

    comparison = compare_folders(site_a, site_b, align)
    written = write_comparison(comparison, output) if output is not None else []
    say(*report(comparison))
    if written:
        say("", *(f"saved to {path}" for path in written))
    else:
        say("", "The difference as a GeoTIFF, the picture and every figure go into a folder: -o FOLDER.")
