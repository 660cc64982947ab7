"""What the paper leaves open, measured on emulated networks: one choice changed at a time.

    python benchmarks/fusion_choices.py [--seeds 100 101 102 103] [--only NAME ...]

Every site is rendered once and seen by emulated VGGT-like geometry and by both emulated segmenters (docs/emulators.md);
all variants are fused from the same observations, with the scale from one reference object. mIoU is strict: unknown
counts as wrong; policy "task". Seeds are those for tuning; the figures stand in docs/decisions/.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from excavatwin.mapper import Mapper, Memory
from excavatwin.semantics.admissibility import AdmitAll
from excavatwin.semantics.certainty import KeepScore
from excavatwin.semantics.consistency import KeepEvidence
from excavatwin.studies.ablation import ablations, with_references
from excavatwin.studies.cases import SEGMENTERS, Case, simulated_case
from excavatwin.studies.pixels import fused_labels, scores

COLUMNS = ("miou", "coverage", "accuracy", "aurc", "risk_ratio", "ece")


def variants(m: Mapper) -> dict[str, Mapper]:
    """Name of the change and the mapper with it."""
    c, a, d, i = m.consistency, m.admissibility, m.decision, m.instances
    assert not isinstance(c, KeepEvidence)
    assert not isinstance(a, AdmitAll)
    rows = {"default": m}
    for share in (0.0, 0.5, 1.0):
        rows[f"agreement {share:g}"] = replace(m, consistency=replace(c, agreement=share))
    for radius in (20.0, 60.0):
        rows[f"agreement within {radius:g} voxels"] = replace(m, consistency=replace(c, radius=radius))
    for reach in (10.0, 100.0):
        rows[f"reach {reach:g} voxels"] = replace(m, consistency=replace(c, reach=reach))
    for tau in (0.0, 0.4, 0.5, 0.6):
        rows[f"tau {tau:g}"] = replace(m, decision=replace(d, tau=tau))
    for support in (0.5, 1.0):
        rows[f"other classes in a component {support:g}"] = replace(m, admissibility=replace(a, in_component=support))
    for support in (0.2, 0.5):
        rows[f"objects without component {support:g}"] = replace(m, admissibility=replace(a, no_component=support))
    rows["fragments up to 0.5 join"] = replace(m, instances=replace(i, fragment=0.5))
    rows["machines of any size"] = replace(m, instances=replace(i, machine=0.0))
    rows["plain score as confidence"] = replace(m, certainty=KeepScore())
    return rows | {name: other for name, other in ablations(m).items() if name.startswith("w/o")}


def figures(m: Mapper, case: Case, memory: Memory) -> dict[str, float]:
    """Scores of one variant on one case."""
    forced = replace(m, decision=replace(m.decision, tau=0.0, least=0.0)).trace(case.observations, memory=memory)
    fused = fused_labels(m.trace(case.observations, memory=memory), case)
    return scores(fused, fused_labels(forced, case))


def main() -> None:
    """Print one table a backbone, as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[100, 101, 102, 103])
    parser.add_argument("--only", nargs="*", default=[])
    wanted = parser.parse_args()
    found: dict[str, dict[str, list[dict[str, float]]]] = {name: {} for name in SEGMENTERS}
    for seed in wanted.seeds:
        for backbone, rows in found.items():
            case, memory = simulated_case(seed, backbone), {}
            for name, m in variants(with_references(Mapper(), case)).items():
                if not wanted.only or name in wanted.only or name == "default":
                    rows.setdefault(name, []).append(figures(m, case, memory))
    for backbone, rows in found.items():
        print(f"\n{backbone}, sites {wanted.seeds}\n\n| variant | " + " | ".join(COLUMNS) + " | mIoU against default |")
        print("|---" * (len(COLUMNS) + 2) + "|")
        for name, measured in rows.items():
            means = (np.mean([one.get(key, np.nan) for one in measured]) for key in COLUMNS)
            change = [one["miou"] - full["miou"] for one, full in zip(measured, rows["default"], strict=True)]
            each = " ".join(f"{value:+.1f}" for value in change)
            print(f"| {name} | " + " | ".join(f"{value:.3g}" for value in means) + f" | {each} |", flush=True)


if __name__ == "__main__":
    main()
