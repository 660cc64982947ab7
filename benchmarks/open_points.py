"""What the paper leaves open, measured: the sample's map against its truth, one choice changed at a time.

    python benchmarks/open_points.py [--observations FILE.npz]

The photos in ``sample/`` are reconstructed and segmented once (about a minute; kept in FILE when given), then every
variant is fused from the same observations; "sparse" ones from 3 % of the evidence. mIoU is strict: unknown counts as
wrong; class mapping of the built-in "appearance" segmenter. The figures stand in docs/decisions/.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from excavatwin.backbones.appearance import Appearance
from excavatwin.backbones.photogrammetry import Photogrammetry
from excavatwin.backbones.protocols import Picture
from excavatwin.capture import find_photos
from excavatwin.evaluation import evaluate_site, load_truth
from excavatwin.exchange import load_observations, save_observations
from excavatwin.geometry.local_geometry import NoLocalGeometry
from excavatwin.geometry.objects import NoObjects
from excavatwin.geometry.outliers import KeepAll, Outliers
from excavatwin.geometry.terrain import PointwiseTerrain
from excavatwin.mapper import Mapper
from excavatwin.scene.observations import Observations
from excavatwin.scene.support import LocalGeometry
from excavatwin.scene.voxels import Voxels
from excavatwin.semantics.admissibility import AdmitAll
from excavatwin.semantics.consistency import Consistency, KeepEvidence
from excavatwin.semantics.reliability import Reliability, Uniform

SAMPLE = Path(__file__).parents[1] / "sample"
COLUMNS = {
    "elevation_fitted_mae_gsd": "MAE/GSD",
    "elevation_fitted_p95": "p95 m",
    "elevation_completeness": "complete %",
    "map_miou": "mIoU %",
    "map_coverage": "cover %",
    "map_iou_excavator": "EX %",
    "map_iou_obstacle": "OB %",
    "object_size_relative_error": "size %",
}


@dataclass(frozen=True)
class InMetres(Outliers):
    """The Hampel test on distances in metres, not in what the photos can resolve."""

    def __call__(self, voxels: Voxels, local: LocalGeometry) -> LocalGeometry:
        return super().__call__(replace(voxels, footprint=np.full_like(voxels.footprint, voxels.size)), local)


def observe() -> Observations:
    """The sample as the built-in backbones see it."""
    segment = Appearance()
    observations = Photogrammetry()(find_photos(SAMPLE / "photos"))
    views = []
    for view in observations.views:
        assert view.image is not None
        seen = segment(Picture(view.image))
        points = np.where(seen.no_surface[..., None], np.nan, view.points).astype(np.float32)
        views.append(replace(view, points=points, evidence=seen.evidence))
    return replace(observations, views=tuple(views))


def sparse(observations: Observations, share: float = 0.03, radius: int = 12, seed: int = 1) -> Observations:
    """The same with evidence in a few discs only, as an instance segmenter that recognises little would give it."""
    rng = np.random.default_rng(seed)
    views = []
    for view in observations.views:
        H, W = view.shape
        y, x = np.mgrid[:H, :W]
        kept = np.zeros((H, W), bool)
        while kept.mean() < share:
            kept |= (y - rng.integers(H)) ** 2 + (x - rng.integers(W)) ** 2 < radius**2
        views.append(replace(view, evidence=view.evidence * kept[..., None]))
    return replace(observations, views=tuple(views))


def sparse_variants() -> Iterator[tuple[str, Mapper]]:
    """Choices that matter when the evidence has gaps."""
    m = Mapper()
    yield "sparse: default", m
    for reach in (5.0, 10.0, 50.0, 100.0, 400.0):
        yield f"sparse: reach {reach:g} voxels", replace(m, consistency=replace(m.consistency, reach=reach))
    for smallest in (1, 40):
        yield f"sparse: clusters from {smallest}", replace(m, consistency=replace(m.consistency, min_cluster=smallest))
    yield "sparse: w/o spatial consistency", replace(m, consistency=KeepEvidence())
    yield "sparse: w/o view reliability", replace(m, reliability=Uniform())
    yield "sparse: plain voting (g = 1)", replace(m, admissibility=AdmitAll())


def variants() -> Iterator[tuple[str, Mapper]]:
    """Name of the change and the mapper with it."""
    m = Mapper()
    yield "default", m
    for footprints in (1.0, 1.5, 3.0, 4.0):
        yield f"voxel of {footprints:g} footprints", replace(m, voxelize=replace(m.voxelize, footprints=footprints))
    for k in (8, 16, 48):
        yield f"{k} neighbours", replace(m, voxelize=replace(m.voxelize, k=k))
    for gamma in (3.0, 12.0):
        yield f"gamma {gamma:g}", replace(m, outliers=Outliers(gamma=gamma))
    yield "gamma 6, distances in metres", replace(m, outliers=InMetres())
    yield "no outlier test", replace(m, outliers=KeepAll())
    for percentile in (0.0, 0.25, 0.5):
        yield f"reference at quantile {percentile:g}", replace(m, terrain=replace(m.terrain, percentile=percentile))
    for delta_h in (0.2, 1.5, 3.0):
        yield f"delta_h {delta_h:g}", replace(m, terrain=replace(m.terrain, delta_h=delta_h))
    for window in (4.0, 8.0, 20.0):
        yield f"window {window:g} m", replace(m, terrain=replace(m.terrain, window=window))
    yield "no smear", replace(m, terrain=replace(m.terrain, smear=1))
    for q in (0.0, 0.3, 0.5):
        yield f"q {q:g}", replace(m, objects=replace(m.objects, q=q))
    for reach in (5.0, 100.0):
        yield f"reach {reach:g} voxels", replace(m, consistency=Consistency(reach=reach))
    for tau in (0.35, 0.65, 0.8):
        yield f"tau {tau:g}", replace(m, decision=replace(m.decision, tau=tau))
    for doubtful in (0.0, 0.15, 0.4):
        yield f"doubtful support {doubtful:g}", replace(m, admissibility=replace(m.admissibility, doubtful=doubtful))
    for gamma_min in (0.0, 0.5, 1.0):
        yield f"gamma_min {gamma_min:g}", replace(m, cell_labels=replace(m.cell_labels, gamma_min=gamma_min))
    for term in ("semantic", "reconstruction", "angle", "distance"):
        yield f"reliability without {term}", replace(m, reliability=replace(Reliability(), **{term: 0.0}))
    yield "w/o local geometry", replace(m, local_geometry=NoLocalGeometry(), outliers=KeepAll())
    yield "w/o terrain continuity", replace(m, terrain=PointwiseTerrain())
    yield "w/o object support", replace(m, objects=NoObjects())
    yield "w/o spatial consistency", replace(m, consistency=KeepEvidence())
    yield "w/o view reliability", replace(m, reliability=Uniform())
    yield "plain voting (g = 1)", replace(m, admissibility=AdmitAll())


def main() -> None:
    """Print one row a variant, as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--observations", type=Path)
    file = parser.parse_args().observations
    if file is not None and file.exists():
        observations = load_observations(file)
    else:
        observations = observe()
        if file is not None:
            save_observations(observations, file)
    truth = load_truth(SAMPLE / "truth.npz")
    print("| variant | " + " | ".join(COLUMNS.values()) + " |\n|" + "---|" * (len(COLUMNS) + 1))
    for seen, changes in ((observations, variants()), (sparse(observations), sparse_variants())):
        for name, mapper in changes:
            value = {metric.name: metric.value for metric in evaluate_site(mapper.trace(seen).map, truth)}
            print(f"| {name} | " + " | ".join(f"{value.get(key, np.nan):.3g}" for key in COLUMNS) + " |", flush=True)


if __name__ == "__main__":
    main()
