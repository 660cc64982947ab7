"""Elevation reference of RELLIS-3D by a stated protocol; the paper scores "a selected scene" and gives none.

Scans within ``half_window`` seconds are put together by ``poses.txt``. Of their returns, those of construction terrain,
other terrain and grass stay. The height of a cell is a low quantile of at least ``least`` returns: grass stands on the
ground and its blades only add. Up is the z axis of the world of ``poses.txt``: there are no extrinsics of the IMU.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from excavatwin.errors import InputError, require
from excavatwin.scene.frames import transform
from excavatwin.scene.grid import Grid
from excavatwin.scene.recording import ElevationReference, Frame, Recording, Scan
from excavatwin.scene.taxonomy import TERRAIN_CLASSES
from excavatwin.vocabularies import read_vocabulary

#: The Ouster's rate, for scans without times [1/s].
RATE = 10.0
#: Grass stands on terrain that the scanner sees between its blades.
GROUND_COVER = "grass"


@dataclass(frozen=True)
class ElevationProtocol:
    """How scans become a reference; state it beside the figures."""

    half_window: float = 5.0
    """Scans this long before and after the photo are used [s]."""
    cell: float = 0.2
    """[m]"""
    quantile: float = 0.1
    """Of the heights of a cell."""
    least: int = 3
    """Returns that a cell needs."""
    reach: float = 25.0
    """Returns farther from their scanner are not used: beams graze the ground there [m]."""
    policy: str = "diggable"
    """Of the class mapping that says what is terrain."""

    def __post_init__(self) -> None:
        require(self, "half_window", 0)
        require(self, "cell", 0, open_low=True)
        require(self, "quantile", 0, 1)
        require(self, "least", 1)
        require(self, "reach", 0, open_low=True)

    def __call__(self, recording: Recording, frame: Frame) -> ElevationReference:
        """Terrain around a photo in the world of ``poses.txt``.

        Raises:
            InputError: no labelled scan with a pose lies in the window.
        """
        from excavatwin.kernels.cells import cell_quantile, group_rows

        ground = ground_ids(self.policy)
        parts = [self._ground(scan, ground) for scan in self._window(recording, frame)]
        xyz = np.concatenate(parts) if parts else np.zeros((0, 3))
        if not len(xyz):
            raise InputError(
                f"RELLIS-3D {recording.name}/{frame.name}: no labelled scan with a pose within {self.half_window:g} s; "
                "unpack the scans, their labels and poses.txt of this sequence."
            )
        low, high = np.floor(xyz.min(0) / self.cell), np.floor(xyz.max(0) / self.cell) + 1
        cols, rows = (int(n) for n in (high - low)[:2])
        grid = Grid(low[0] * self.cell, high[1] * self.cell, self.cell, rows, cols)
        start, member = group_rows(grid.flat_index(xyz[:, :2]), rows * cols)
        height, returns = cell_quantile(xyz[:, 2], start, member, self.quantile), np.diff(start)
        height[returns < self.least] = np.nan
        return ElevationReference(grid, height.reshape(grid.shape), returns.astype(np.int32).reshape(grid.shape))

    def _window(self, recording: Recording, frame: Frame) -> Iterator[Scan]:
        centre = recording.scan(frame.scan)
        for scan in recording.scans:
            if scan.labelled and scan.T_W_L is not None and _apart(scan, frame, centre) <= self.half_window:
                yield scan

    def _ground(self, scan: Scan, ground: tuple[int, ...]) -> Float64[np.ndarray, "n 3"]:
        cloud = scan.cloud()
        assert cloud.label is not None
        assert scan.T_W_L is not None
        keep = np.isin(cloud.label, ground) & (np.linalg.norm(cloud.xyz, axis=1) <= self.reach)
        return transform(scan.T_W_L, cloud.xyz[keep].astype(np.float64))


def ground_ids(policy: str) -> tuple[int, ...]:
    """Ids of RELLIS-3D that are terrain under a policy, and grass."""
    vocabulary = read_vocabulary("rellis-3d", policy)
    M = vocabulary.matrix(list(vocabulary.names.values()))
    terrain = M[:, [k - 1 for k in TERRAIN_CLASSES]].sum(1) > 0.5
    return tuple(
        i for (i, name), yes in zip(vocabulary.names.items(), terrain, strict=True) if yes or name == GROUND_COVER
    )


def elevation_windows(recording: Recording, count: int = 20) -> tuple[Frame, ...]:
    """Photos spread evenly over a sequence whose scan is labelled and placed: the centres of independent windows."""
    usable = [
        frame
        for frame in recording.frames
        if frame.T_W_cam is not None and (scan := recording.scan(frame.scan)) is not None and scan.labelled
    ]
    if not usable:
        return ()
    return tuple(usable[i] for i in np.unique(np.linspace(0, len(usable) - 1, count).round().astype(int)))


def _apart(scan: Scan, frame: Frame, centre: Scan | None) -> float:
    """Time between a scan and a photo [s]; by number at the scanner's rate where scans have no time."""
    if scan.time is not None and frame.time is not None:
        return abs(scan.time - frame.time)
    return abs(int(scan.name) - int(centre.name)) / RATE if centre else float("inf")
