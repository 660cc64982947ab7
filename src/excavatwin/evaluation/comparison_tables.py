"""A comparison as JSON and as CSV."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Sequence
from typing import Any

import excavatwin
from excavatwin.evaluation.comparison import Comparison
from excavatwin.evaluation.comparison_labels import NAMES, VALUES
from excavatwin.evaluation.comparison_objects import Pair
from excavatwin.evaluation.comparison_site import ComparedSite
from excavatwin.scene.elevation_map import MapObject
from excavatwin.scene.taxonomy import class_name

FORMAT, VERSION = "excavatwin-comparison", 1
COLUMNS = ("section", "name", "value", "unit", "meaning")


def to_json(c: Comparison) -> str:
    """Everything; null where there was nothing to measure."""
    matched_a, matched_b = {pair.a.object_id for pair in c.pairs}, {pair.b.object_id for pair in c.pairs}
    table = {
        "format": FORMAT,
        "version": VERSION,
        "excavatwin": excavatwin.__version__,
        "a": _site(c.a),
        "b": _site(c.b),
        "frame": {"way": c.placement.way, "scale": c.placement.scale, "unit": c.unit, "cell": c.grid.cell},
        "figures": [
            {"name": m.name, "value": finite(m.value), "unit": m.unit, "meaning": m.meaning} for m in c.metrics
        ],
        "confusion": {
            "rows": "A",
            "columns": "B",
            "names": NAMES,
            "values": VALUES,
            "cells": c.counts.tolist(),
            "area": _areas(c),
            "area_unit": f"{c.unit}2",
        },
        "objects": {
            "matched": [_plain(pair) for pair in c.pairs],
            "only_a": [_object(o) for o in c.a.map.objects if o.object_id not in matched_a],
            "only_b": [_object(o) for o in c.objects_b if o.object_id not in matched_b],
        },
        "runs": [{"name": d.name, "a": d.a, "b": d.b} for d in c.runs],
        "notes": c.notes,
    }
    return json.dumps(table, indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def to_csv(c: Comparison) -> str:
    """One line a figure, then the matrix, the matched objects, and what differs between the runs."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    for m in c.metrics:
        value = finite(m.value)
        writer.writerow([m.name.partition("_")[0], m.name, "" if value is None else value, m.unit, m.meaning])
    areas = _areas(c)
    for i, ours in enumerate(NAMES):
        for j, theirs in enumerate(NAMES):
            name, meaning = f"{ours}/{theirs}", f"A says {ours}, B says {theirs}"
            writer.writerow(["confusion_cells", name, int(c.counts[i, j]), "1", meaning])
            writer.writerow(["confusion_area", name, areas[i][j], f"{c.unit}2", meaning])
    for pair in c.pairs:
        writer.writerows(_lines(pair, c.unit))
    writer.writerows(["runs", d.name, "", "", f"A: {d.a}; B: {d.b}"] for d in c.runs)
    return out.getvalue()


def finite(value: float) -> float | None:
    """None where there was nothing to measure."""
    return float(value) if math.isfinite(value) else None


def _areas(c: Comparison) -> list[list[float]]:
    return [[round(float(n) * c.grid.cell**2, 9) for n in row] for row in c.counts]


def _site(site: ComparedSite) -> dict[str, Any]:
    m = site.map
    return {
        "folder": str(site.folder),
        "backbones": site.backbones,
        "unit": m.unit,
        "epsg": m.georeference.epsg if m.georeference else None,
        "cell": m.grid.cell,
        "rows": m.grid.rows,
        "columns": m.grid.cols,
        "objects": len(m.objects),
        "cameras": len(site.cameras),
    }


def _object(o: MapObject) -> dict[str, Any]:
    return {"object_id": o.object_id, "class": class_name(o.task_class), "centre": list(o.centre), "size": list(o.size)}


def _plain(pair: Pair) -> dict[str, Any]:
    return {
        name: [finite(v) for v in value] if isinstance(value, list) else value
        for name, value in pair.record().items()
    }  # fmt: skip


def _lines(pair: Pair, unit: str) -> Sequence[Sequence[Any]]:
    r = pair.record()
    name, who = f"{r['a']}/{r['b']}", f"{r['class_a']} {r['a']} of A, {r['class_b']} {r['b']} of B"
    rows = [
        ["object_pair", f"{name}/overlap", r["overlap"], "1", f"IoU of the boxes: {who}"],
        ["object_pair", f"{name}/distance", r["distance"], unit, f"distance of the centres: {who}"],
    ]
    sides = zip(("length", "width", "height"), r["size_a"], r["size_b"], r["size_difference"], strict=True)
    rows += [
        ["object_pair", f"{name}/{side}", step, unit, f"{side} {ours:.3f} in A, {theirs:.3f} in B"]
        for side, ours, theirs, step in sides
    ]
    return rows
