"""The mapper: Sec. III of the paper, in its order."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, ParamSpec, TypeVar

import numpy as np
from jaxtyping import Float64

from excavatwin.geometry.gravity import Gravity, KeepFrame
from excavatwin.geometry.local_geometry import CovarianceFeatures, NoLocalGeometry
from excavatwin.geometry.objects import NoObjects, Objects
from excavatwin.geometry.outliers import KeepAll, Outliers
from excavatwin.geometry.scale import Scale
from excavatwin.geometry.terrain import PointwiseTerrain, TerrainEnvelope
from excavatwin.geometry.voxelize import Voxelize
from excavatwin.mapping.assembly import assemble, cell_support
from excavatwin.mapping.cell_labels import CellLabels
from excavatwin.mapping.elevation import Elevation
from excavatwin.mapping.instances import Instances
from excavatwin.mapping.occupancy import Occupancy
from excavatwin.mapping.raster import Raster
from excavatwin.paper import equation
from excavatwin.scene.observations import Georeference, Observations
from excavatwin.scene.progress import Progress, silent
from excavatwin.scene.site import FusedPoints, MappedView, Site
from excavatwin.scene.taxonomy import NOT_OBSERVED, Support
from excavatwin.scene.trace import Trace
from excavatwin.semantics.admissibility import Admissibility, AdmitAll
from excavatwin.semantics.certainty import Certainty, KeepScore
from excavatwin.semantics.consistency import Consistency, KeepEvidence
from excavatwin.semantics.decision import Decision
from excavatwin.semantics.projection import Correspondence
from excavatwin.semantics.reliability import Reliability, Uniform
from excavatwin.semantics.vote import Vote

P = ParamSpec("P")
R = TypeVar("R")
Memory = dict[tuple[Any, ...], tuple[Any, tuple[Any, ...]]]
"""Stage and its arguments -> what it made of them."""


@dataclass(frozen=True)
class Mapper:
    """F: observations -> semantic elevation map. One field per stage; an ablation is another stage in its place."""

    gravity: Gravity | KeepFrame = Gravity()
    scale: Scale = Scale()
    correspondence: Correspondence = Correspondence()
    voxelize: Voxelize = Voxelize()
    local_geometry: CovarianceFeatures | NoLocalGeometry = CovarianceFeatures()
    outliers: Outliers | KeepAll = Outliers()
    terrain: TerrainEnvelope | PointwiseTerrain = TerrainEnvelope()
    consistency: Consistency | KeepEvidence = Consistency()
    objects: Objects | NoObjects = Objects()
    reliability: Reliability | Uniform = Reliability()
    vote: Vote = Vote()
    admissibility: Admissibility | AdmitAll = Admissibility()
    decision: Decision = Decision()
    certainty: Certainty | KeepScore = Certainty()
    instances: Instances = Instances()
    raster: Raster = Raster()
    elevation: Elevation = Elevation()
    cell_labels: CellLabels = CellLabels()
    occupancy: Occupancy = Occupancy()

    def trace(self, observations: Observations, progress: Progress = silent, memory: Memory | None = None) -> Trace:
        """Run the method and keep every intermediate noun.

        Args:
            memory: of earlier runs on the same observations; what an equal stage made of the same nouns is taken over,
                so that variants of the mapper share what they have in common.

        Raises:
            InputError: the observations cannot be mapped as they are.
        """
        do = _Steps(progress, {} if memory is None else memory, memory is not None)
        R_G_R, tilted = do("gravity", self.gravity, observations)
        s, metric, unsure = do("scale", self.scale, observations)
        T_M_R = do("frame", similarity, s, R_G_R)
        points = do("points", self.correspondence, observations, T_M_R)  # eq:gc_correspondence
        voxels = do("voxels", self.voxelize, points, metric)
        local = do("local geometry", self.local_geometry, voxels)  # eq:cov
        local = do("outliers", self.outliers, voxels, local)  # eq:outlier
        terrain = do("terrain", self.terrain, voxels, local, metric)  # eq:gc_continuity
        evidence = do("consistency", self.consistency, voxels, voxels.evidence, terrain)  # o_s(u,k) -> e_is(k)
        objects = do("objects", self.objects, voxels, evidence, local, terrain)  # eq:gc_conf_filter
        weight = do("reliability", self.reliability, voxels, evidence, local)  # w_js
        v = do("vote", self.vote, voxels, evidence, weight)  # eq:vote
        g = do("admissibility", self.admissibility, voxels, local, terrain, objects)  # g_j(k)
        labels = do("decision", self.decision, v, g)  # eq:score, eq:semantic_decision
        labels = do("certainty", self.certainty, voxels, labels)  # gamma_i
        instance, labels = do("instances", self.instances, voxels, local, labels, terrain, metric)
        cells = do("raster", self.raster, voxels, local)
        elevation = do("elevation", self.elevation, cells, voxels, labels, terrain, weight)  # eq:semantic_elevation
        semantics = do("cell labels", self.cell_labels, cells, voxels, labels)  # eq:grid_semantics
        occupied = do("occupancy", self.occupancy, cells, voxels, labels, terrain, instance)
        doubts = (*observations.doubts, *tilted, *unsure)
        support = cell_support(cells, voxels, terrain)
        site_map = assemble(
            cells, elevation, semantics, occupied, support, metric, rescaled(observations, s), doubts
        )  # eq:multilayer_map
        return Trace(
            observations=observations, T_M_R=T_M_R, points=points, voxels=voxels, local=local, terrain=terrain,
            evidence=evidence, objects=objects, weight=weight, labels=labels, occupied=instance,
            map=site_map, seconds=do.seconds,
        )  # fmt: skip

    @equation("eq:semantic_elevation_map")
    def __call__(self, observations: Observations, progress: Progress = silent) -> Site:
        """M = F({(p_su, c_su, o_su)}): the map with its cloud and its refined label images."""
        return site_of(self.trace(observations, progress))


def similarity(s: float, R_G_R: Float64[np.ndarray, "3 3"]) -> Float64[np.ndarray, "4 4"]:
    """T_M_R: rotate upright, then scale to metres."""
    T_M_R = np.eye(4)
    T_M_R[:3, :3] = s * R_G_R
    return T_M_R


def rescaled(observations: Observations, s: float) -> Georeference | None:
    """The georeference after a reference length changed the scale: what that moves the cameras by is residual, too."""
    tie, known = observations.georeference, observations.metres_per_unit
    if tie is None or known is None or s == known:
        return tie
    moved = (s - known) * np.array([view.centre for view in observations.views])
    return replace(tie, residual=float(np.hypot(tie.residual, np.sqrt((moved**2).sum(axis=1).mean()))))


def site_of(trace: Trace) -> Site:
    """What a run leaves behind: the map, the fused cloud and every view's refined label image."""
    voxels, labels = trace.voxels, trace.labels
    support = np.where(trace.terrain.member, Support.TERRAIN, Support.NON_TERRAIN)
    points = FusedPoints(
        xyz=voxels.centre,
        label=labels.label,
        confidence=labels.confidence,
        rgb=np.round(voxels.rgb).astype(np.uint8),
        object_id=trace.occupied,
        support=np.where(trace.local.inlier, support, Support.NONE).astype(np.uint8),
    )
    images = trace.points.unflatten(labels.label[voxels.of_point], NOT_OBSERVED)
    views = tuple(
        MappedView(view.name, image, view.K_cam, camera_pose(trace.T_M_R, view.T_R_cam), view.image, view.lattice)
        for view, image in zip(trace.observations.views, images, strict=True)
    )
    return Site(trace.map, points, views, trace.observations.unplaced, {"fusion_seconds": trace.seconds})


def camera_pose(T_M_R: Float64[np.ndarray, "4 4"], T_R_cam: Float64[np.ndarray, "4 4"]) -> Float64[np.ndarray, "4 4"]:
    """T_M_cam: a rigid pose; the similarity's scale moves the camera but does not stretch it."""
    T_M_cam = T_M_R @ T_R_cam
    T_M_cam[:3, :3] /= np.cbrt(np.linalg.det(T_M_R[:3, :3]))
    return T_M_cam


@dataclass
class _Steps:
    """Runs the stages one after the other, tells the listener where it is and notes how long each took."""

    progress: Progress
    memory: Memory
    remember: bool
    seconds: dict[str, float] = field(default_factory=dict)
    stages: int = 20

    def __call__(self, name: str, stage: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
        self.progress(f"fusion: {name}", len(self.seconds), self.stages)
        start = time.perf_counter()
        key = (stage, *(arg if isinstance(arg, (bool, float)) else id(arg) for arg in args))
        if self.remember and key in self.memory:
            result = self.memory[key][0]
        else:
            result = stage(*args, **kwargs)
            if self.remember:
                self.memory[key] = (result, args)  # the arguments are kept so that their ids stay theirs
        self.seconds[name] = time.perf_counter() - start
        self.progress(f"fusion: {name}", len(self.seconds), self.stages)
        return result
