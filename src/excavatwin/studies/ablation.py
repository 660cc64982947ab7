"""What each part of the method is worth: the paper's five rows (tab:yoloe_ablation), the full method, and baselines."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from excavatwin.geometry.local_geometry import NoLocalGeometry
from excavatwin.geometry.objects import NoObjects
from excavatwin.geometry.outliers import KeepAll
from excavatwin.geometry.terrain import PointwiseTerrain
from excavatwin.mapper import Mapper, Memory
from excavatwin.scene.progress import Progress, silent
from excavatwin.semantics.consistency import KeepEvidence
from excavatwin.semantics.reliability import Uniform
from excavatwin.studies.baselines import baselines
from excavatwin.studies.cases import Case
from excavatwin.studies.pixels import PixelLabels, backbone_labels, fused_labels, scores

FULL = "full method"
BACKBONE = "backbone"


@dataclass(frozen=True)
class Row:
    """One configuration on one case."""

    case: str
    configuration: str
    figures: Mapping[str, float]
    """Name of the figure -> value."""


def ablations(m: Mapper) -> dict[str, Mapper]:
    """The paper's rows: each part replaced by its identity twin, and nothing else changed."""
    return {
        FULL: m,
        "w/o local geometry": replace(m, local_geometry=NoLocalGeometry(), outliers=KeepAll()),
        "w/o terrain continuity": replace(m, terrain=PointwiseTerrain()),
        "w/o object support": replace(m, objects=NoObjects()),
        "w/o spatial consistency": replace(m, consistency=KeepEvidence()),
        "w/o view reliability": replace(m, reliability=Uniform()),
    }


def configurations(m: Mapper) -> dict[str, Mapper]:
    """All that is compared, by name."""
    return {**ablations(m), **baselines()}


def ablate(
    cases: Iterable[Case], mapper: Mapper, only: Sequence[str] = (), progress: Progress = silent, total: int = 0
) -> list[Row]:
    """Fuse every case with every configuration, and score its backbone alone.

    Args:
        only: names of configurations; empty means all.
        total: number of cases, for the progress bar.
    """
    rows = []
    chosen = {name: m for name, m in configurations(mapper).items() if not only or name in only}
    for number, case in enumerate(cases):
        rows.append(Row(case.name, BACKBONE, scores(backbone_labels(case))))
        memory: Memory = {}
        for k, (name, m) in enumerate(chosen.items()):
            progress(f"{case.name}: {name}", number * len(chosen) + k, total * len(chosen))
            trace = m.trace(case.observations, memory=memory)
            labels: PixelLabels = fused_labels(trace, case)
            rows.append(Row(case.name, name, scores(labels)))
    return rows
