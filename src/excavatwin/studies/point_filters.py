"""Ground filters that work on the points: ours, and the two peers that other packages bring (CSF, PDAL's SMRF)."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
from jaxtyping import Bool, Float64

from excavatwin.errors import MissingExtraError
from excavatwin.geometry.local_geometry import CovarianceFeatures
from excavatwin.geometry.outliers import Outliers
from excavatwin.geometry.terrain import TerrainEnvelope, plain_cloud
from excavatwin.geometry.voxelize import Voxelize
from excavatwin.scene.points import Points
from excavatwin.scene.taxonomy import K


class Filter(Protocol):
    """A ground filter: its parameters are its fields."""

    name: str

    def __call__(self, xyz: Float64[np.ndarray, "N 3"]) -> Bool[np.ndarray, "N"]:
        """Which points lie on the ground."""
        ...


@dataclass(frozen=True)
class Envelope:
    """Our stages on a plain cloud: voxels, local geometry, outliers, terrain envelope; then every point is tested."""

    size: float = 1.0
    """Edge of a voxel, about the spacing of the points [m]."""
    window: float = 36.0
    """Widest body [m]."""
    terrain: TerrainEnvelope | None = None
    """Another terrain stage than that for plain clouds."""
    outliers: Outliers = field(default_factory=lambda: Outliers(gamma=12.0))
    """The test for spatial outliers, milder than for photos: swaths overlap, and between them points are sparse."""

    name = "ExcavaTwin"

    def __call__(self, xyz: Float64[np.ndarray, "N 3"]) -> Bool[np.ndarray, "N"]:
        """Points that agree with the ground around them; spatial outliers do not."""
        stage = self.terrain or plain_cloud(self.window)
        points = as_points(xyz, self.size / 2)
        voxels = Voxelize(size=self.size)(points, metric=True)
        local = self.outliers(voxels, CovarianceFeatures()(voxels))
        terrain = stage(voxels, local, metric=True)
        return stage.on_ground(terrain.grid, terrain.ground, points.xyz)


@dataclass(frozen=True)
class Csf:
    """Cloth simulation filter (Zhang et al., 2016), the authors' package."""

    cloth: float = 0.5
    """Spacing of the cloth's nodes [m]."""
    rigidness: int = 3
    """1 steep slopes, 2 relief, 3 flat."""
    threshold: float = 0.5
    """Distance to the cloth within which a point is ground [m]."""
    smooth: bool = True
    """Post-processing of steep slopes."""
    iterations: int = 500
    """Steps of the simulation, at most."""

    name = "CSF"

    def __call__(self, xyz: Float64[np.ndarray, "N 3"]) -> Bool[np.ndarray, "N"]:
        """Points near the cloth that fell on the inverted cloud.

        Raises:
            MissingExtraError: the package is not installed.
        """
        try:
            import CSF  # type: ignore[import-untyped]
        except ImportError as error:
            raise MissingExtraError(
                'The cloth simulation filter is not installed; run: pip install "excavatwin[study]"'
            ) from error
        cloth = CSF.CSF()
        cloth.params.bSloopSmooth, cloth.params.rigidness = self.smooth, self.rigidness
        cloth.params.cloth_resolution, cloth.params.class_threshold = self.cloth, self.threshold
        cloth.params.interations, cloth.params.time_step = self.iterations, 0.65
        ground, other = CSF.VecInt(), CSF.VecInt()
        with muted():
            cloth.setPointCloud(np.ascontiguousarray(xyz, np.float64))
            cloth.do_filtering(ground, other, False)
        mask = np.zeros(len(xyz), bool)
        mask[np.fromiter(ground, np.int64, len(ground))] = True
        return mask


@dataclass(frozen=True)
class PdalSmrf:
    """SMRF as PDAL has it (``filters.smrf``), through its executable."""

    cell: float = 1.0
    """[m]"""
    slope: float = 0.15
    """Steepest terrain (tangent)."""
    window: float = 18.0
    """Largest window [m]."""
    threshold: float = 0.5
    """Height above the ground within which a point belongs to it [m]."""
    scaling: float = 1.25
    """What the ground's slope (tangent) adds to the threshold [m]."""

    name = "SMRF (PDAL)"

    @staticmethod
    def installed() -> bool:
        """Whether the executable ``pdal`` is on the path."""
        return shutil.which("pdal") is not None

    def __call__(self, xyz: Float64[np.ndarray, "N 3"]) -> Bool[np.ndarray, "N"]:
        """Points that PDAL classifies as ground (2).

        Raises:
            MissingExtraError: ``pdal`` is not installed, or refuses.
        """
        if not self.installed():
            raise MissingExtraError("The executable pdal is not on the path; install PDAL (https://pdal.io).")
        import laspy

        with tempfile.TemporaryDirectory() as folder:
            source, target = Path(folder) / "in.las", Path(folder) / "out.las"
            las = laspy.create(point_format=0)
            las.header.scales, las.header.offsets = [0.0001] * 3, np.floor(xyz.min(axis=0))
            las.x, las.y, las.z = xyz.T
            las.write(source)
            options = {"cell": self.cell, "slope": self.slope, "window": self.window, "threshold": self.threshold,
                       "scalar": self.scaling}  # fmt: skip
            command = ["pdal", "translate", str(source), str(target), "smrf"]
            command += [f"--filters.smrf.{key}={value}" for key, value in options.items()]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                raise MissingExtraError(f"pdal failed: {done.stderr.strip()}; update PDAL, or take it off the path.")
            return np.asarray(laspy.read(target).classification) == 2


def as_points(xyz: Float64[np.ndarray, "N 3"], footprint: float) -> Points:
    """A plain cloud as one view from above, without evidence, from a local origin."""
    n = len(xyz)
    local = (xyz - [*np.floor(xyz[:, :2].mean(axis=0)), 0.0]).astype(np.float32)
    return Points(
        xyz=local, confidence=np.ones(n, np.float32), evidence=np.zeros((n, K), np.float32),
        view=np.zeros(n, np.int32), pixel=np.arange(n), rgb=np.full((n, 3), 128, np.uint8),
        centres=np.array([[0.0, 0.0, float(xyz[:, 2].max()) + 1000.0]]), footprint=np.full(n, footprint, np.float32),
        shapes=((1, n),),
    )  # fmt: skip


@contextlib.contextmanager
def muted() -> Iterator[None]:
    """What compiled code writes to standard output goes nowhere."""
    sys.stdout.flush()
    kept = os.dup(1)
    with open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        try:
            yield
        finally:
            os.dup2(kept, 1)
            os.close(kept)
