"""Rendered photos with exact truth: terrain, objects and their dimensions from our photogrammetry.

    python benchmarks/rendered_photos.py FOLDER [--out FOLDER] [--lattice PIXELS] [SEQUENCE ...]

FOLDER is a data set in the OCES-like layout, such as `excavatwin simulate` writes it. The photos of every epoch are
mapped with the defaults, from scratch, and scored twice: as the map declares its place, and after its cameras were laid
on the true ones (a shift and a turn about the vertical). Per epoch:

- GSD: footprint of a photo's pixel at the scene's centre;
- MAE: mean absolute error of the terrain, as declared / with aligned cameras / after a further vertical shift and tilt;
- complete: share of the terrain with an elevation;
- recall, precision, class: of the objects, in the second frame;
- size: mean relative error of length, width and height of all objects found / of those 20 GSD or more across;
- then one line an object: mapped and true dimensions.

The last line holds the means over the epochs, each epoch counting once.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from excavatwin.backbones.photogrammetry import Photogrammetry
from excavatwin.datasets.oces import open_oces
from excavatwin.evaluation.metric import Metric
from excavatwin.evaluation.site import evaluate_site
from excavatwin.evaluation.truth_file import load_truth
from excavatwin.survey import map_photos
from excavatwin.survey.plan import Plan

COLUMNS: tuple[tuple[str, str, float, str], ...] = (
    ("GSD cm", "gsd", 100, ".1f"),
    ("MAE cm", "declared elevation_mae", 100, ".2f"),
    ("aligned", "elevation_mae", 100, ".2f"),
    ("fitted", "elevation_fitted_mae", 100, ".2f"),
    ("complete %", "elevation_completeness", 1, ".1f"),
    ("recall %", "object_recall", 1, ".0f"),
    ("precision %", "object_precision", 1, ".0f"),
    ("class %", "object_class_accuracy", 1, ".0f"),
    ("size %", "object_size_relative_error", 1, ".1f"),
    ("resolved %", "object_size_relative_error_resolved", 1, ".1f"),
    ("seconds", "seconds", 1, ".0f"),
)
"""Heading, figure, factor and format of every column."""


def figures(photos: Path, truth_file: Path, out: Path, plan: Plan) -> tuple[dict[str, float], list[Metric]]:
    """Figures of one epoch, and the errors of its objects."""
    start = time.perf_counter()
    map_photos(photos, out, plan=plan, fresh=True)
    seconds = time.perf_counter() - start
    truth = load_truth(truth_file)
    aligned = evaluate_site(out, truth, way="cameras")
    values = {metric.name: float(metric.value) for metric in aligned}
    values |= {f"declared {m.name}": float(m.value) for m in evaluate_site(out, truth) if m.name == "elevation_mae"}
    sides = ("_length_error", "_width_error", "_height_error")
    return values | {"seconds": seconds}, [metric for metric in aligned if metric.name.endswith(sides)]


def line(name: str, values: dict[str, float]) -> str:
    """One row of the table."""
    cells = [f"{factor * values.get(key, np.nan):{form}}" for _, key, factor, form in COLUMNS]
    return f"| {name} | " + " | ".join(cells) + " |"


def main(arguments: Sequence[str] | None = None) -> int:
    """Map, score, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="data set in the OCES-like layout")
    parser.add_argument("sequences", nargs="*", help="names of sequences; all when none is given")
    parser.add_argument("--out", type=Path, help="where the maps go; by default they are thrown away")
    parser.add_argument("--lattice", type=int, default=Photogrammetry().lattice, help="see `excavatwin config`")
    chosen = parser.parse_intermixed_args(arguments)
    dataset = open_oces([chosen.folder])
    names = [n for n in dataset.names if not chosen.sequences or n.split("/")[0] in chosen.sequences]
    if not names:
        parser.error(f"none of {', '.join(chosen.sequences)} in {chosen.folder}; it holds {', '.join(dataset.names)}")
    plan = replace(Plan(), reconstructor=Photogrammetry(lattice=chosen.lattice))
    rows, objects = {}, {}
    with tempfile.TemporaryDirectory() as scratch:
        for name in names:
            recording = dataset.open(name)
            assert recording.photos is not None
            assert recording.truth is not None
            out = (chosen.out or Path(scratch)) / name.replace("/", "_")
            out.parent.mkdir(parents=True, exist_ok=True)
            rows[name], objects[name] = figures(recording.photos, recording.truth, out, plan)
    print("| epoch | " + " | ".join(heading for heading, *_ in COLUMNS) + " |")
    print("|---" * (len(COLUMNS) + 1) + "|")
    for name, values in rows.items():
        print(line(name, values))
    mean = {key: float(np.mean([values.get(key, np.nan) for values in rows.values()])) for _, key, *_ in COLUMNS}
    print(line("mean", mean))
    for name, errors in objects.items():
        print(f"\n{name}")
        for metric in errors:
            print(f"  {metric.name:40s} {metric.value:+6.1f} %   {metric.meaning}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
