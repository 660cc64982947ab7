"""The paper's three tables, our column beside the paper's.

The column OCES is filled from simulated sites (the paper's recordings are not public) unless sites of a data set in
the OCES layout are given; the other columns from the data sets that are given, with the SITEs mapped from them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from excavatwin.evaluation.bootstrap import mean_interval
from excavatwin.evaluation.metric import Metric
from excavatwin.studies.ablation import BACKBONE, FULL, CaseResult, ablations
from excavatwin.studies.ablation_tables import PROTOCOL, dimensions, values
from excavatwin.studies.paper_tables import ABLATION, BACKBONES, GEOMETRY, SEMANTICS, TITLES, published
from excavatwin.studies.table import Cell, Table

DIMENSION_PROTOCOLS = ("camera_baseline", "other_object", "metric_backbone", "one_dimension")
"""Of object dimensions, the one taken first where a data set allows several."""


@dataclass(frozen=True)
class Ours:
    """All that was measured."""

    simulated: Sequence[CaseResult] = ()
    """Simulated sites, both backbones."""
    source: str = ""
    """Which ones."""
    summaries: Mapping[str, Mapping[str, Metric]] = field(default_factory=dict)
    """Data set -> metrics over its sequences, by name, as ``excavatwin evaluate`` has them."""
    segmenter: str = "mask2former"
    """Backbone that the data sets' SITEs were mapped with."""

    def of(self, backbone: str) -> list[CaseResult]:
        """Simulated results with one backbone."""
        return [result for result in self.simulated if result.backbone == backbone]

    def mean(self, backbone: str, configuration: str, figure: str) -> float | None:
        """Over the simulated sites; None where it was not measured."""
        found = mean_interval(values(self.of(backbone), configuration, figure))
        return found.value if found.n else None

    def measured(self, dataset: str, name: str) -> float | None:
        """A metric of a data set; None where it was not measured."""
        metric = self.summaries.get(dataset, {}).get(name)
        return None if metric is None or metric.value != metric.value else metric.value


def paper_tables(ours: Ours) -> list[Table]:
    """tab:geometry_accuracy, tab:semantic_accuracy and tab:yoloe_ablation."""
    return [geometry_table(ours), semantic_table(ours), ablation_table(ours)]


def geometry_table(ours: Ours) -> Table:
    """Errors of object dimensions and of terrain elevation [cm]."""
    rows: list[tuple[Cell, ...]] = []
    protocols = []
    for (task, dataset), paper in GEOMETRY.items():
        kind = "dimension" if task == "Object dimension" else "elevation"
        found, how = measured_geometry(ours, dataset, kind)
        if how:
            protocols.append(f"{task}, {TITLES[dataset]}: {how}.")
        rows.append((task, TITLES[dataset], *(cell for both in zip(paper, found, strict=True) for cell in both)))
        if kind == "elevation" and (fitted := measured_geometry(ours, dataset, "elevation_fitted")[0])[0] is not None:
            pairs = (cell for one in fitted for cell in (None, one))
            rows.append((f"{task}, after a vertical shift and tilt", TITLES[dataset], *pairs))
    heads = ("MAE [cm]", "RMSE [cm]", "relative error [%]")
    columns = ("task", "data set", *(f"{who}: {head}" for head in heads for who in ("paper", "ours")))
    return Table(
        "Geometric accuracy (tab:geometry_accuracy)", columns, tuple(rows), (*protocols, *_notes(ours, GEOMETRY_NEEDS))
    )


def measured_geometry(ours: Ours, dataset: str, kind: str) -> tuple[tuple[Cell, Cell, Cell], str]:
    """Our MAE [cm], RMSE [cm] and relative error [%], and how they came about."""
    if dataset in ours.summaries:
        names = [f"dimension_{p}" for p in DIMENSION_PROTOCOLS] if kind == "dimension" else [kind]
        for name in names:
            mae, rmse = (_cm(ours.measured(dataset, f"{name}_{figure}")) for figure in ("mae", "rmse"))
            if mae is not None:
                how = ours.summaries[dataset][f"{name}_mae"].meaning
                return (mae, rmse, ours.measured(dataset, f"{name}_relative_error")), f"ours: {how}"
        return (None, None, None), ""
    best = "mask2former" if ours.of("mask2former") else "yoloe"
    if dataset != "oces" or not ours.of(best):
        return (None, None, None), ""
    where = f"ours: {BACKBONES[best]}-like evidence and VGGT-like geometry on simulated sites"
    if kind == "dimension":
        found = {metric.name: metric.value for metric in dimensions(ours.of(best))}
        mae, rmse, share = (found.get(f"dimension_other_object_{f}") for f in ("mae", "rmse", "relative_error"))
        return (_cm(mae), _cm(rmse), share), f"{where}; the scale is that of one reference object, which is not scored"
    mae, rmse = (ours.mean(best, FULL, f"{kind}_{figure}") for figure in ("mae", "rmse"))
    return (_cm(mae), _cm(rmse), None), f"{where}; scale of one reference object, position by the cameras"


def semantic_table(ours: Ours) -> Table:
    """mIoU and coverage of both backbones alone and fused [%]."""
    rows = tuple(
        (
            BACKBONES[backbone], "+ ours" if configuration == FULL else "backbone",
            *(cell for dataset in SEMANTICS for cell in _beside(ours, dataset, backbone, configuration)),
        )
        for backbone in BACKBONES
        for configuration in (BACKBONE, FULL)
    )  # fmt: skip
    notes = (PROTOCOL, *_notes(ours, SEMANTIC_NEEDS))
    return Table(
        "Semantic accuracy and spatial coverage (tab:semantic_accuracy)", ("backbone", "method", *_heads(SEMANTICS)),
        rows, notes,
    )  # fmt: skip


def ablation_table(ours: Ours) -> Table:
    """The paper's ablation, which it has for YOLOE [%]."""
    names = (BACKBONE, *(name for name in ablations_in_order() if name != FULL), FULL)
    rows = tuple(
        (name, *(cell for dataset in ABLATION for cell in _beside(ours, dataset, "yoloe", name))) for name in names
    )
    notes = (PROTOCOL, *_notes(ours, ABLATION_NEEDS))
    return Table("Ablation with YOLOE (tab:yoloe_ablation)", ("configuration", *_heads(ABLATION)), rows, notes)


def ablations_in_order() -> tuple[str, ...]:
    """The full method and the paper's rows."""
    from excavatwin.mapper import Mapper

    return tuple(ablations(Mapper()))


GEOMETRY_NEEDS = "`excavatwin tables DATASET --sites SITES` fills the row of a data set (Objectron, RELLIS-3D)."
SEMANTIC_NEEDS = "`excavatwin tables DATASET --sites SITES --segmenter NAME` fills the '+ ours' row of GOOSE-Ex."
ABLATION_NEEDS = "`excavatwin ablate OBSERVATIONS --truth truth.npz` runs the same rows on data of your own."


def _heads(datasets: Mapping[str, object]) -> list[str]:
    figures = ("mIoU [%]", "coverage [%]")
    return [f"{TITLES[d]} {who}: {figure}" for d in datasets for figure in figures for who in ("paper", "ours")]


def _beside(ours: Ours, dataset: str, backbone: str, configuration: str) -> tuple[Cell, ...]:
    """The paper's mIoU, ours, the paper's coverage, ours."""
    paper = published(dataset, backbone, configuration) or (None, None)
    mine: list[float | None] = [None, None]
    if dataset in ours.summaries:
        if configuration == FULL and backbone == ours.segmenter:
            mine = [ours.measured(dataset, f"photo_{figure}") for figure in ("miou", "coverage")]
    elif dataset == "oces":
        mine = [ours.mean(backbone, configuration, figure) for figure in ("miou", "coverage")]
    return paper[0], mine[0], paper[1], mine[1]


def _notes(ours: Ours, needs: str) -> tuple[str, ...]:
    """Where the figures come from, and how to fill a dash."""
    notes = []
    if ours.simulated and "oces" not in ours.summaries:
        notes.append(
            f"Ours in the columns and rows of OCES: {ours.source}, with emulated backbones, means over sites; "
            " the paper's: its own recordings, which are not public. The two are not the same data."
        )
    notes += [f"Ours in {TITLES[d]}: the given SITEs, {BACKBONES[ours.segmenter]}." for d in ours.summaries]
    return (*notes, f"A dash was not measured: {needs}")


def _cm(metres: float | None) -> float | None:
    return None if metres is None else 100 * metres
