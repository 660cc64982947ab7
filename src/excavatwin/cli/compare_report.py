"""Two maps on the screen: the figures, the matrix of classes, and what differs in how they were made."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from excavatwin.cli.console import wrapped
from excavatwin.cli.metric_report import ROUNDING, WIDTH, figure

if TYPE_CHECKING:
    from excavatwin.evaluation.comparison import Comparison
    from excavatwin.evaluation.comparison_site import ComparedSite

RUNS = 12
"""Entries of run.json that are shown; the rest is in the files."""
SHORT = {"construction_terrain": "construction", "removable_cover": "cover", "not_observed": "not seen"}
"""Class -> head of its column, where the name is too long for one."""


def report(c: Comparison) -> list[str]:
    """The lines of the screen."""
    lines = [*site("A", c.a), *site("B", c.b), *frame(c), "", *elevation(c), "", *coverage(c), "", *labels(c)]
    lines += ["", *objects(c), "", *runs(c)]
    return lines + (["", *(line for note in c.notes for line in wrapped("  ! ", note, WIDTH))] if c.notes else [])


def site(name: str, s: ComparedSite) -> list[str]:
    """Folder, backbones, cells."""
    m = s.map
    where = f"EPSG:{m.georeference.epsg}" if m.georeference else "local frame"
    unit = m.unit if m.metric else "arbitrary units"
    text = f"{s.folder}: {s.backbones}; {len(s.cameras)} photos; cells of {m.grid.cell:.3g} {unit}, {where}"
    return wrapped(f"{name}  ", text, WIDTH)


def frame(c: Comparison) -> list[str]:
    """How B came into A's frame."""
    how = {
        "declared": "both georeferences, as declared",
        "reprojected": "both georeferences, B reprojected",
        "cameras": f"{c.value('frame_cameras'):.0f} cameras of equal names",
    }[c.placement.way]
    text = f"B placed by {how}"
    if math.isfinite(c.value("frame_residual")):
        text += f"; the shared cameras lie {figure(c.value('frame_residual'), c.unit)} apart (RMS)"
    if c.placement.scale != 1:
        text += f"; B's lengths times {c.placement.scale:.4g}"
    return wrapped("   ", text, WIDTH)


def elevation(c: Comparison) -> list[str]:
    """The difference as placed, and after what a shift, a tilt and the cameras explain."""
    tilt, s = c.value("elevation_tilt"), c.value("frame_similarity_scale")
    s = 0.0 if abs(s) < ROUNDING else s
    names = {
        "declared": "as placed",
        "shifted": "after the best vertical shift",
        "levelled": f"after shift and tilt ({figure(tilt, 'deg')})",
        "similarity": f"after the cameras' similarity ({s:+.2g} % in scale)",
    }
    head = f"Terrain height, B minus A [{c.unit}]"
    lines = [f"{head:<46}{'mean':>9}{'median':>9}{'NMAD':>9}{'95 %':>9}{'RMSE':>9}{'cells':>10}"]
    for name, said in names.items():
        values = [c.value(f"elevation_{name}_{kind}") for kind in ("mean", "median", "nmad", "p95", "rmse")]
        cells = c.value(f"elevation_{name}_cells")
        if math.isfinite(cells):
            lines.append(f"  {said:<44}" + "".join(f"{figure(v):>9}" for v in values) + f"{cells:>10.0f}")
    return lines


def coverage(c: Comparison) -> list[str]:
    """What is seen by one, the other, both."""
    lines = [f"{f'Coverage [{c.unit}2]':<46}{'A only':>11}{'B only':>11}{'both':>11}{'shared':>9}"]
    for name, said in (("observed", "observed"), ("terrain", "with a terrain height"), ("classified", "with a class")):
        areas = [c.value(f"coverage_{name}_{side}") for side in ("only_a", "only_b", "both")]
        share = c.value(f"coverage_{name}_shared")
        lines.append(f"  {said:<44}" + "".join(f"{v:>11.1f}" for v in areas) + f"{figure(share):>7} %")
    return lines


def labels(c: Comparison) -> list[str]:
    """Agreement, kappa, and the matrix in areas with the IoU of each class."""
    from excavatwin.evaluation.comparison_labels import NAMES

    text = (
        f"Classes: {figure(c.value('label_agreement'), '%')} of what both classify agrees, kappa "
        f"{figure(c.value('label_kappa'))}; matrix in {c.unit}2, rows A, columns B"
    )
    short = [SHORT.get(name, name.replace("_", " ")) for name in NAMES]
    lines = [*wrapped("", text, WIDTH), f"  {'':<15}" + "".join(f"{name:>14}" for name in short) + f"{'IoU':>8}"]
    for i, name in enumerate(NAMES):
        areas = [f"{float(n) * c.grid.cell**2:.1f}" if n else "-" for n in c.counts[i]]
        iou = c.value(f"label_iou_{name}")
        tail = f"{iou:>6.1f} %" if math.isfinite(iou) else ""
        lines.append((f"  {short[i]:<15}" + "".join(f"{area:>14}" for area in areas) + tail).rstrip())
    return lines


def objects(c: Comparison) -> list[str]:
    """How many are the same, and each of those."""
    only_a, only_b = c.value("object_only_a"), c.value("object_only_b")
    lines = [f"Objects: {len(c.pairs)} in both maps, {only_a:.0f} in A only, {only_b:.0f} in B only"]
    for pair in c.pairs:
        r = pair.record()
        kind = r["class_a"] if r["class_a"] == r["class_b"] else f"{r['class_a']} | {r['class_b']}"
        sizes = [" x ".join(f"{side:.2f}" for side in r[f"size_{which}"]) for which in "ab"]
        lines.append(
            f"  {r['a']:>3} | {r['b']:<3} {kind:<14} {sizes[0]} | {sizes[1]} {c.unit}, "
            f"{figure(r['distance'], c.unit)} apart, overlap {100 * r['overlap']:.0f} %"
        )
    return lines


def runs(c: Comparison) -> list[str]:
    """What differs in how they were made."""
    if not c.runs:
        return ["Both runs used the same photos, backbones, versions and parameters."]
    lines = ["Made differently (A | B):"]
    for d in c.runs[:RUNS]:
        lines += wrapped("  ", f"{d.name} {d.a} | {d.b}", WIDTH)
    more = len(c.runs) - RUNS
    return lines + ([f"  and {more} more entries, all in comparison.json: -o FOLDER"] if more > 0 else [])
