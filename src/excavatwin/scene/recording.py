"""Recordings: what a data set holds of one place, in our conventions, with its ground truth as optional fields.

Everything heavy stays on disk until it is called: a field such as ``frame.label`` is ``None`` where the data set has no
such thing, else a ``Stored`` array, ``frame.label()``. World frames are metric, z up; cameras follow OpenCV.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32, UInt8, UInt16

from excavatwin.errors import InputError
from excavatwin.scene.frames import unproject
from excavatwin.scene.grid import Grid
from excavatwin.scene.observations import Georeference
from excavatwin.scene.taxonomy import TaskClass

Content = TypeVar("Content")


@dataclass(frozen=True)
class Stored(Generic[Content]):
    """Something on disk that is read when called, each time anew."""

    path: Path
    read: Callable[[Path], Content]

    def __call__(self) -> Content:
        """The content."""
        return self.read(self.path)


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Returns of a laser scanner, without those that have no range."""

    xyz: Float32[np.ndarray, "N 3"]
    """In the frame of the scan [m]."""
    label: UInt16[np.ndarray, "N"] | None = None
    """Class id in the recording's vocabulary."""
    instance: UInt16[np.ndarray, "N"] | None = None
    ground: Bool[np.ndarray, "N"] | None = None
    """Whether a person called the return bare earth."""
    intensity: Float32[np.ndarray, "N"] | None = None


@dataclass(frozen=True, eq=False)
class Scan:
    """One sweep of a laser scanner, or a whole surveyed cloud."""

    name: str
    cloud: Stored[PointCloud]
    time: float | None = None
    """[s]; None when the data set does not tell."""
    labelled: bool = False
    """Whether its returns carry class ids."""
    T_W_L: Float64[np.ndarray, "4 4"] | None = None
    """Pose of the scanner in the recording's world [m]."""


@dataclass(frozen=True, eq=False)
class Frame:
    """One photo with what is known about it."""

    name: str
    """Unique in its recording."""
    image: Stored[UInt8[np.ndarray, "H W 3"]]
    """RGB, as displayed."""
    time: float | None = None
    """[s]"""
    size: tuple[int, int] | None = None
    """Width, height where the data set tells [px]."""
    K_cam: Float64[np.ndarray, "3 3"] | None = None
    """Intrinsics; pixel centres at +0.5 [px]."""
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """OpenCV k1, k2, p1, p2."""
    T_W_cam: Float64[np.ndarray, "4 4"] | None = None
    """Camera-to-world pose [m]."""
    T_L_cam: Float64[np.ndarray, "4 4"] | None = None
    """Pose of the camera in the frame of its scan [m]."""
    up_cam: Float64[np.ndarray, "3"] | None = None
    """Unit vector against gravity, in the camera, where it is known without a world pose."""
    label: Stored[UInt8[np.ndarray, "H W"]] | None = None
    """Class ids in the recording's vocabulary; 255 = ignore."""
    instance: Stored[UInt16[np.ndarray, "H W"]] | None = None
    """Object ids; 0 = none."""
    depth: Stored[Float32[np.ndarray, "H W"]] | None = None
    """Along the optical axis, NaN = none [m]."""
    scan: str | None = None
    """Name of the recording's scan that was taken nearest in time, where one is near enough."""
    split: str | None = None
    """``"train"``, ``"val"`` or ``"test"`` as the data set's authors say."""

    def world_points(self) -> Float32[np.ndarray, "H W 3"]:
        """World point of every pixel from depth and camera; NaN where there is no depth.

        Raises:
            InputError: the frame lacks depth, intrinsics or pose, or its photo is distorted.
        """
        if self.depth is None or self.K_cam is None or self.T_W_cam is None:
            raise InputError(f"frame {self.name} has no world points: it lacks depth, intrinsics or pose.")
        if any(self.distortion):
            raise InputError(f"frame {self.name} has no world points: its depth belongs to a distorted photo.")
        return unproject(self.depth(), self.K_cam, self.T_W_cam)


@dataclass(frozen=True, eq=False)
class KnownObject:
    """An object whose dimensions somebody measured."""

    object_id: int
    category: str
    """What it is, such as ``"excavator"`` or ``"chair"``."""
    size: tuple[float, float, float]
    """Along its own axes, height last [m]."""
    T_W_object: Float64[np.ndarray, "4 4"] | None = None
    """Pose of the box's centre in the world; its third axis points up when it stands upright [m]."""
    task_class: TaskClass | None = None
    name: str = ""
    z_base: float | None = None
    """Elevation of the terrain that it stands on [m]."""
    z_top: float | None = None


@dataclass(frozen=True, eq=False)
class ElevationReference:
    """Terrain heights from a laser scanner, row 0 north."""

    grid: Grid
    height: Float32[np.ndarray, "Y X"]
    """Terrain at the cell centres; NaN where too few returns [m]."""
    returns: Int32[np.ndarray, "Y X"] | None = None
    """Ground returns of the cell."""


@dataclass(frozen=True)
class VolumeChange:
    """What was moved between two epochs of one place."""

    before: str
    """Name of a recording."""
    after: str
    cut: float
    """[m3]"""
    fill: float
    """[m3]"""
    net: float
    """Fill minus cut [m3]."""


@dataclass(frozen=True, eq=False)
class Recording:
    """One sequence (or one epoch of one) with all that is known about it."""

    name: str
    """Unique in its data set, ``"00000"`` or ``"site_200/epoch_00"``."""
    frames: tuple[Frame, ...] = ()
    scans: tuple[Scan, ...] = ()
    vocabulary: str | None = None
    """Name of the class mapping whose ids the labels hold."""
    voiceless: tuple[str, ...] = ()
    """Classes of the vocabulary that mean nothing here, such as the hood of a robot that is no excavator."""
    photos: Path | None = None
    """Folder that holds just the photos of ``frames``, ready for the mapper."""
    objects: tuple[KnownObject, ...] = ()
    elevation: Stored[ElevationReference] | None = None
    truth: Path | None = None
    """``truth.npz`` where the site is simulated; ``evaluation.load_truth`` reads it."""
    georeference: Georeference | None = None
    platform: str | None = None
    time: float | None = None
    """When it was recorded, where the data set tells; to be compared within the data set only [s]."""
    split: str | None = None
    breaks: tuple[int, ...] = ()
    """Indices of frames whose pose jumped since the frame before; metric figures must not span them."""
    doubts: tuple[str, ...] = ()
    """What the user should know, one sentence each."""

    def scan(self, name: str | None) -> Scan | None:
        """The scan of that name, or None."""
        return self._scan_of.get(name)

    @cached_property
    def _scan_of(self) -> dict[str | None, Scan]:
        return {scan.name: scan for scan in self.scans}


@dataclass(frozen=True)
class Excluded:
    """A known bad file or scene that is left out."""

    what: str
    reason: str


@dataclass(frozen=True, eq=False)
class Dataset:
    """A data set on disk: names now, recordings when asked for."""

    name: str
    """``"rellis-3d"``, ``"goose"``, ``"objectron"``, ``"oces"``, ``"isprs"`` or ``"orfd"``."""
    folders: tuple[Path, ...]
    """Where its parts lie; several when its archives were unpacked side by side."""
    names: tuple[str, ...]
    """Names of the recordings."""
    open: Callable[[str], Recording]
    """The recording of a name; see ``recording``."""
    counts: Mapping[str, int] = field(default_factory=dict)
    """What is there: ``"frames"``, ``"labelled frames"``, ``"scans"``, ..."""
    splits: Mapping[str, int] = field(default_factory=dict)
    """Official split -> number of its items that are there."""
    categories: tuple[str, ...] = ()
    changes: tuple[VolumeChange, ...] = ()
    vocabulary: str | None = None
    excluded: tuple[Excluded, ...] = ()
    missing: tuple[str, ...] = ()
    """What a complete copy has besides, one phrase each."""
    checks: tuple[str, ...] = ()
    """What was tested when it was opened and how it came out, one sentence each."""

    def recording(self, name: str) -> Recording:
        """One recording; arrays stay on disk.

        Raises:
            InputError: there is none of that name, or it is damaged.
        """
        if name not in self.names:
            some = ", ".join(self.names[:5]) + (", ..." if len(self.names) > 5 else "")
            raise InputError(f"{self.name} has no recording {name!r}; it has: {some or 'none'}.")
        return self.open(name)

    def __iter__(self) -> Iterator[Recording]:
        """All recordings, one after the other."""
        return (self.open(name) for name in self.names)

    def __len__(self) -> int:
        return len(self.names)
