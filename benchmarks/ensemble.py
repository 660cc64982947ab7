"""Two emulated segmenters alone and together, with and without calibrated weights: per pixel, and after the mapper.

    python benchmarks/ensemble.py [--seeds 108 109 110 111] [--calibrate 100 101 102 103 104 105 106 107]

Twelve views of 518 x 392 a site, VGGT-like geometry, scale from one reference object. Weights are found on the sites
of ``--calibrate`` from the true classes of their pixels, and scored on the others. mIoU is strict (unknown is wrong),
over the pixels of the photos; alone, a pixel is labelled when its best evidence is at least 0.2. About a minute a site
for rendering and two for the five fusions. The figures stand in docs/decisions/ensemble.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from excavatwin.backbones.merging import Merging, calibrate
from excavatwin.backbones.protocols import Segmentation
from excavatwin.mapper import Mapper
from excavatwin.scene.taxonomy import TASK_CLASSES, class_name
from excavatwin.studies.ablation import with_references
from excavatwin.studies.cases import SEGMENTERS, Case, simulated_case, simulated_scene
from excavatwin.studies.pixels import PixelLabels, backbone_labels, fused_labels, scores

Seen = list[dict[str, Segmentation]]
Weights = Mapping[str, tuple[float, ...]]
COLUMNS = ("miou", "coverage", "accuracy", *(f"iou_{class_name(k)}" for k in TASK_CLASSES))


def segmentation(evidence: np.ndarray) -> Segmentation:
    """Evidence of an emulator, which knows no sky: it gives none there."""
    return Segmentation(evidence, np.zeros(evidence.shape[:2], bool))


def looked_at(seed: int) -> tuple[Seen, list[np.ndarray]]:
    """What both segmenters say about the views of a site, and the truth."""
    scene = simulated_scene(seed)
    each = {name: make()(scene.views, scene.cameras, seed) for name, make in SEGMENTERS.items()}
    seen = [{name: segmentation(each[name][i]) for name in each} for i in range(len(scene.views))]
    return seen, list(scene.labels)


def weights_from(seeds: Sequence[int], names: Sequence[str]) -> Weights:
    """Calibrated weights of some of the segmenters."""
    seen: Seen = []
    truths: list[np.ndarray] = []
    for seed in seeds:
        of_site, labels = looked_at(seed)
        seen += [{name: one[name] for name in names} for one in of_site]
        truths += labels
    return calibrate(seen, truths)


def merged(case: Case, seen: Seen, names: Sequence[str], weights: Weights) -> Case:
    """The case with the merged evidence of some of the segmenters."""
    merge = Merging(weights)
    evidence = [merge({name: one[name] for name in names}).evidence for one in seen]
    both = zip(case.observations.views, evidence, strict=True)
    views = tuple(replace(view, evidence=some) for view, some in both)
    return replace(case, observations=replace(case.observations, views=views))


def figures(labels: PixelLabels) -> list[float]:
    """The columns of one site."""
    found = scores(labels)
    return [found.get(name, np.nan) for name in COLUMNS]


def main() -> None:
    """Print the weights and two tables, as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[108, 109, 110, 111])
    parser.add_argument("--calibrate", type=int, nargs="+", default=list(range(100, 108)))
    wanted = parser.parse_args()
    both, one = tuple(SEGMENTERS), ("mask2former",)
    calibrated = {names: weights_from(wanted.calibrate, names) for names in (both, one)}
    rows: dict[str, tuple[tuple[str, ...], Weights]] = {
        "YOLOE-like": (("yoloe",), {}),
        "Mask2Former-like": (one, {}),
        "Mask2Former-like, calibrated": (one, calibrated[one]),
        "both, weight 1": (both, {}),
        "both, calibrated": (both, calibrated[both]),
    }
    for names, weights in calibrated.items():
        print(f"weights of {' + '.join(names)} from sites {wanted.calibrate}: {weights}")
    found: dict[str, dict[str, list[list[float]]]] = {"alone": {}, "after the mapper": {}}
    for seed in wanted.seeds:
        case = simulated_case(seed, "mask2former")
        seen, _ = looked_at(seed)
        for row, (names, weights) in rows.items():
            some = merged(case, seen, names, weights)
            found["alone"].setdefault(row, []).append(figures(backbone_labels(some)))
            trace = with_references(Mapper(), some).trace(some.observations)
            found["after the mapper"].setdefault(row, []).append(figures(fused_labels(trace, some)))
            print(f"  site {seed}, {row}: {found['after the mapper'][row][-1][0]:.1f} %", flush=True)
    for title, table in found.items():
        print(f"\n{title}, sites {wanted.seeds}\n\n| evidence | {' | '.join(COLUMNS)} | mIoU of each site |")
        print("|---" * (len(COLUMNS) + 2) + "|")
        for row, measured in table.items():
            means = " | ".join(f"{value:.1f}" for value in np.nanmean(measured, axis=0))
            print(f"| {row} | {means} | {' '.join(f'{one[0]:.1f}' for one in measured)} |", flush=True)


if __name__ == "__main__":
    main()
