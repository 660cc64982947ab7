"""What each part of the method is worth: the paper's rows (tab:yoloe_ablation), baselines of others, oracles.

A row of the ablation is the mapper with one stage replaced by its identity twin; a baseline has another vote in place
of all that the method adds to voting; an oracle is the full method on observations of which one half is true.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from excavatwin.errors import InputError
from excavatwin.evaluation.dimensions import MeasuredObject
from excavatwin.geometry.local_geometry import NoLocalGeometry
from excavatwin.geometry.objects import NoObjects
from excavatwin.geometry.outliers import KeepAll
from excavatwin.geometry.scale import Scale
from excavatwin.geometry.terrain import PointwiseTerrain
from excavatwin.mapper import Mapper, Memory
from excavatwin.scene.progress import Progress, silent
from excavatwin.scene.trace import Trace
from excavatwin.semantics.consistency import KeepEvidence
from excavatwin.semantics.reliability import Uniform
from excavatwin.studies.baselines import baselines
from excavatwin.studies.cases import Case, with_true_classes
from excavatwin.studies.pixels import backbone_labels, fused_labels, scores
from excavatwin.studies.terrain import measured_objects, terrain_figures

FULL = "full method"
BACKBONE = "backbone"
TRUE_CLASSES = "oracle: true classes"
TRUE_GEOMETRY = "oracle: true geometry"
ORACLES = (TRUE_CLASSES, TRUE_GEOMETRY)

Figures = dict[str, float]
"""Name of a figure -> value."""


@dataclass(frozen=True)
class CaseResult:
    """Everything that was measured on one case with one backbone."""

    case: str
    backbone: str
    """Name of the segmenter."""
    rows: dict[str, Figures]
    """Configuration -> figures; none where the case does not have what it takes."""
    objects: tuple[MeasuredObject, ...] = ()
    """Objects as the full method measures them, without the one that gave the scale."""
    doubts: tuple[str, ...] = field(default=())
    """What the full method's map tells about itself."""


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
    """All that is compared on the same observations, by name; baselines keep the mapper's points, voxels and raster."""
    shared = {name: getattr(m, name) for name in ("gravity", "scale", "correspondence", "voxelize", "raster")}
    return {**ablations(m), **{name: replace(b, **shared) for name, b in baselines().items()}}


def names() -> tuple[str, ...]:
    """Of every configuration, in the order of the tables."""
    return (BACKBONE, *configurations(Mapper()), *ORACLES)


def chosen(only: Sequence[str]) -> tuple[str, ...]:
    """The configurations to run: those named, with the full method that they are compared with; all without a name.

    Raises:
        InputError: there is no configuration of that name.
    """
    for name in only:
        if name not in names():
            raise InputError(f"{name!r} is no configuration; use one of: {', '.join(names())}.")
    return tuple(name for name in names() if not only or name in only or name == FULL)


def with_references(mapper: Mapper, case: Case) -> Mapper:
    """The mapper with the case's known lengths, unless it has its own: scale from one object, as in the paper."""
    return mapper if mapper.scale.references else replace(mapper, scale=Scale(case.references, mapper.scale.search))


def study_case(
    case: Case, backbone: str, mapper: Mapper | None = None, only: Sequence[str] = (), progress: Progress = silent
) -> CaseResult:
    """Fuse a case with every configuration and score each; terrain and objects are those of the full method.

    Args:
        backbone: name of the segmenter behind the case's evidence, for the result.
        mapper: the full method.
        only: names of configurations; empty means all. The full method is always there.

    Raises:
        InputError: no such configuration, or the observations cannot be mapped.
    """
    mapper = with_references(mapper or Mapper(), case)
    mappers, wanted, rows = configurations(mapper), chosen(only), {}
    memory: Memory = {}
    full: Trace | None = None
    for done, name in enumerate(wanted):
        progress(f"{case.name}, {backbone}: {name}", done, len(wanted))
        if name == BACKBONE:
            rows[name] = scores(backbone_labels(case))
        elif name in ORACLES:
            rows[name] = oracle(name, case, mapper)
        else:
            trace = mappers[name].trace(case.observations, memory=memory)
            if name == FULL:
                full = trace
                rows[name] = full_figures(trace, case, mapper, memory)
            else:
                rows[name] = scores(fused_labels(trace, case))
    progress(f"{case.name}, {backbone}: scored", len(wanted), len(wanted))
    assert full is not None
    objects = measured_objects(full, case)
    return CaseResult(case.name, backbone, rows, objects, full.map.doubts)


def full_figures(trace: Trace, case: Case, mapper: Mapper, memory: Memory) -> Figures:
    """Classes with what their confidence is worth, and the terrain where its truth is known."""
    forced = replace(mapper, decision=replace(mapper.decision, tau=0.0, least=0.0))
    unrejected = forced.trace(case.observations, memory=memory)
    figures = scores(fused_labels(trace, case), fused_labels(unrejected, case))
    return figures | terrain_figures(trace, case)


def oracle(name: str, case: Case, mapper: Mapper) -> Figures:
    """The full method where one half of what it is given is true; nothing where the case does not know that half."""
    if name == TRUE_CLASSES:
        return scores(fused_labels(mapper.trace(with_true_classes(case)), case))
    if case.exact is None:
        return {}
    return scores(fused_labels(replace(mapper, scale=Scale()).trace(case.exact), case))
