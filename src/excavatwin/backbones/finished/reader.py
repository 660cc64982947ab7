"""What all readers of finished reconstructions share: cameras and depth of another program -> observations."""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import Float64

from excavatwin.backbones.cards import Card
from excavatwin.backbones.finished.found import FoundCamera, Scene
from excavatwin.backbones.finished.lenses import Lens
from excavatwin.backbones.finished.photo_matching import Matches, fitted, match
from excavatwin.backbones.finished.posed_depth import PosedPhoto, on_lattice, view_of
from excavatwin.backbones.finished.shelf import Shelf
from excavatwin.backbones.finished.splatting import Camera, surfels
from excavatwin.backbones.finished.standing import as_found, by_photos
from excavatwin.backbones.finished.verdict import held, scaled
from excavatwin.errors import InputError, require
from excavatwin.scene.observations import Observations, Unplaced, View
from excavatwin.scene.photo import Photo
from excavatwin.scene.progress import Progress, silent

Ready = tuple[FoundCamera, PosedPhoto]
_AXES = {"x": 0, "y": 1, "z": 2}


@dataclass(frozen=True)
class Finished(ABC):
    """Base of the readers: a subclass finds cameras, depth maps and clouds in files."""

    card: ClassVar[Card]
    watched: ClassVar[tuple[str, ...]] = ("*",)
    """Patterns of the files that decide the result, under a source that is a folder."""

    source: str = ""
    """File or folder of the finished reconstruction."""
    lattice: int = 640
    """Longer side of the lattice [px]; neither finer than the photos nor than their depth maps."""
    up: str = ""
    """Axis of the reconstruction against gravity, ``z``, ``-y``, ...; empty for what the files tell, else GPS, gimbal
    tags, else cameras and terrain."""
    metres_per_unit: float | None = None
    """Metres of one unit of the reconstruction; None for what the files tell, else GPS."""

    def __post_init__(self) -> None:
        require(self, "lattice", 16)
        require(self, "metres_per_unit", 0, open_low=True)
        if self.up and self.up.lstrip("+-") not in _AXES:
            raise InputError(f"{type(self).__name__}.up is {self.up!r}; expected x, y, z, -x, -y or -z.")

    @abstractmethod
    def read(self, source: Path) -> Scene:
        """Find everything in an existing file or folder.

        Raises:
            InputError: something is missing or damaged; the message names the file.
        """

    def identity(self) -> str:
        """Versions of the libraries, and a hash of names, sizes and times of the files."""
        from excavatwin.backbones.extras import versions

        return f"{versions(self.card)}; files {self._fingerprint()}"

    def __call__(
        self, photos: Sequence[Photo], progress: Progress = silent, scratch: Path | None = None
    ) -> Observations:
        """Observations of the photos that the reconstruction holds, without evidence.

        Args:
            photos: those that the reconstruction was made from; they are matched by name.
            progress: told about ``"read depth"``.
            scratch: where points and confidence go; in memory when None.

        Raises:
            InputError: a file is missing or damaged, no photo fits, or the views contradict each other.
        """
        if not photos:
            raise InputError(f"{self.card.name} was given no photos; give the folder of photos it was made from.")
        scene = self._told(self.read(self._existing()))
        origin = _origin(scene)
        matches = match([camera.name for camera in scene.cameras], photos, scene.where)
        ready, unplaced, said = _ready(scene, matches, origin)
        shelf = Shelf(scratch)
        see = self._through_cloud if scene.splatted else self._through_maps
        for number, (view, doubt) in enumerate(see(scene, origin, ready, progress)):
            progress("read depth", number, len(ready))
            said.append(doubt)
            shelf.add(view)
        progress("read depth", len(ready), len(ready))
        views = shelf.views()
        said += held(views, scene.where)
        frame = as_found(scene, views, photos, origin) or by_photos(scene, views, photos)
        said = [*scene.doubts, *matches.doubts, *dict.fromkeys(text for text in said if text), *frame.doubts]
        facts = {
            "reconstructor": self.card.name,
            "files": scene.where,
            "depth": f"point cloud {scene.cloud.path}" if scene.splatted and scene.cloud else "depth maps",
            "confidence": scene.confidence,
            "gravity": frame.up_from,
            "origin": " ".join(f"{value:.10g}" for value in origin),
        }
        tie, without = frame.georeference, (*matches.unplaced, *unplaced)
        obs = Observations(frame.views, frame.up, frame.metres_per_unit, tie, without, tuple(said), facts)
        return replace(obs, doubts=(*obs.doubts, *scaled(obs, scene.where)))

    def _through_maps(
        self, scene: Scene, origin: Float64[np.ndarray, "3"], ready: Sequence[Ready], progress: Progress
    ) -> Iterator[tuple[View, str]]:
        """Views from depth maps, one at a time, with what is to be said about each."""
        for camera, posed in ready:
            assert camera.depth is not None
            depth = camera.depth().turned(posed.lens.turned)
            lattice, K_cam, error = posed.lens.lattice(posed.shape(self.lattice, depth), scene.where)
            on, confidence = on_lattice(depth, K_cam, posed.shape(self.lattice, depth))
            yield view_of(posed, lattice, K_cam, on, confidence), _lens_doubt(posed.lens, error)

    def _through_cloud(
        self, scene: Scene, origin: Float64[np.ndarray, "3"], ready: Sequence[Ready], progress: Progress
    ) -> Iterator[tuple[View, str]]:
        """Views of a point cloud, one at a time, with what is to be said about each."""
        assert scene.cloud is not None
        placed = [posed.lens.lattice(posed.shape(self.lattice), scene.where) for _, posed in ready]
        cameras = [
            Camera(K_cam, posed.T_R_cam, posed.shape(self.lattice))
            for (_, posed), (_, K_cam, _) in zip(ready, placed, strict=True)
        ]
        progress("read cloud", 0, 1)
        cloud = surfels(scene.cloud, origin, cameras)
        progress("read cloud", 1, 1)
        for (_, posed), (lattice, K_cam, error), camera in zip(ready, placed, cameras, strict=True):
            yield view_of(posed, lattice, K_cam, cloud.depth(camera)), _lens_doubt(posed.lens, error)

    def _told(self, scene: Scene) -> Scene:
        """The scene with what the user told about its frame."""
        up = scene.up
        if self.up:
            up = np.eye(3)[_AXES[self.up.lstrip("+-")]] * (-1.0 if self.up.startswith("-") else 1.0)
        metres = scene.metres_per_unit if self.metres_per_unit is None else self.metres_per_unit
        as_told = self.up.lstrip("+") in ("", "z") and self.metres_per_unit in (None, 1.0)
        epsg = scene.epsg if as_told else None
        return replace(scene, up=up, metres_per_unit=metres, epsg=epsg)

    def _existing(self) -> Path:
        name = self.card.name
        if not self.source:
            raise InputError(f"{name} reads finished files; say which: --reconstructor {name}:PATH.")
        path = Path(self.source).expanduser()
        if not path.exists():
            raise InputError(f"{path} does not exist; give the files of a finished reconstruction to {name}:PATH.")
        return path

    def _fingerprint(self) -> str:
        path = Path(self.source).expanduser() if self.source else Path()
        if not self.source or not path.exists():
            return "none"
        files = [path] if path.is_file() else sorted({f for pattern in self.watched for f in path.rglob(pattern)})
        facts = [(f.name, f.stat().st_size, f.stat().st_mtime_ns) for f in files if f.is_file()]
        return hashlib.sha256(repr(facts).encode()).hexdigest()[:16]


def _ready(
    scene: Scene, matches: Matches, origin: Float64[np.ndarray, "3"]
) -> tuple[list[Ready], list[Unplaced], list[str]]:
    """Cameras with their photos, photos whose camera has no depth, and what was assumed."""
    ready, unplaced, said = [], [], []
    for photo, index in matches.pairs:
        camera = scene.cameras[index]
        if camera.depth is None and not scene.splatted:
            unplaced.append(Unplaced(photo.name, f"{camera.lack} in {scene.where}"))
            continue
        lens, doubt = fitted(camera.lens_of(photo), photo, scene.where)
        said.append(doubt)
        ready.append((camera, PosedPhoto(photo, lens, _posed(camera.T_W_cam, lens, origin))))
    if not ready:
        raise InputError(f"none of the photos has a depth map in {scene.where}; make depth for these photos.")
    return ready, unplaced, said


def _origin(scene: Scene) -> Float64[np.ndarray, "3"]:
    """What is subtracted so that float32 keeps points exact: whole units, only where coordinates are large."""
    centres = np.array([camera.T_W_cam[:3, 3] for camera in scene.cameras])
    middle = np.round(np.median(centres, axis=0))
    spread = float(np.abs(centres - middle).max(initial=0.0))
    return middle if scene.epsg or np.abs(middle).max(initial=0.0) > max(20 * spread, 100) else np.zeros(3)


def _posed(
    T_W_cam: Float64[np.ndarray, "4 4"], lens: Lens, origin: Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, "4 4"]:
    T = np.array(T_W_cam, float)
    T[:3, :3] = T[:3, :3] @ lens.rotation()
    T[:3, 3] -= origin
    return T


def _lens_doubt(lens: Lens, error: float) -> str:
    if error < 0.25:
        return ""
    return (
        f"the lens model {lens.model} has more terms than k1, k2, p1, p2: places in the photos that are given by the "
        f"lattice are off by up to {error:.1f} px of it."
    )
