"""A reconstructor that reads depth and poses instead of finding them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from excavatwin.backbones.cards import Card, Tried
from excavatwin.backbones.lattices import fit
from excavatwin.capture import read_photo
from excavatwin.errors import InputError
from excavatwin.scene.observations import Lattice, Observations, Unplaced, View
from excavatwin.scene.photo import Photo
from excavatwin.scene.progress import Progress
from excavatwin.scene.taxonomy import K

POSES = "poses.json"


@dataclass(frozen=True)
class PosedDepth:
    """Depth as .npy for each photo, poses and intrinsics in ``poses.json``; metres, z up."""

    card: ClassVar[Card] = Card(
        name="posed-depth",
        kind="reconstructor",
        summary="depth maps (.npy) and poses.json in a folder",
        tried=Tried.FILES,
        argument="source",
        metric=True,
    )

    source: str = ""
    """Folder with poses.json and NAME.npy for each photo NAME.jpg."""
    farthest: float = 200.0
    """Depth beyond this is left out [m]."""

    def identity(self) -> str:
        """Names, sizes and times of the files: when they change, the map is made again."""
        files = sorted(Path(self.source).glob("*.npy")) + sorted(Path(self.source).glob(POSES)) if self.source else []
        stamps = [f"{file.name} {file.stat().st_size} {file.stat().st_mtime_ns}" for file in files]
        return f"posed-depth 1; {hashlib.sha256(' '.join(stamps).encode()).hexdigest()[:16]}"

    def __call__(self, photos: Sequence[Photo], progress: Progress, scratch: Path) -> Observations:
        """Observations of the photos that have depth and a pose.

        Raises:
            InputError: poses.json is missing or damaged, or no photo is in it.
        """
        cameras = self._cameras()
        views, unplaced = [], []
        for number, photo in enumerate(photos):
            progress("read depth", number, len(photos))
            try:
                views.append(self._view(photo, cameras))
            except InputError as error:
                unplaced.append(Unplaced(photo.name, str(error)))
        progress("read depth", len(photos), len(photos))
        if not views:
            raise InputError(f"none of the {len(photos)} photos could be used; the first: {unplaced[0].reason}")
        return Observations(
            tuple(views),
            up=np.array([0.0, 0.0, 1.0]),
            metres_per_unit=1.0,
            unplaced=tuple(unplaced),
            source={"reconstructor": "posed-depth", "confidence": "inverse depth", "gravity": "files"},
        )

    def _cameras(self) -> dict[str, Any]:
        file = Path(self.source) / POSES
        try:
            return dict(json.loads(file.read_text()))
        except (OSError, ValueError) as error:
            raise InputError(f"{file} cannot be read ({error}); give --reconstructor posed-depth:FOLDER.") from None

    def _view(self, photo: Photo, cameras: dict[str, Any]) -> View:
        file = Path(self.source) / f"{Path(photo.name).stem}.npy"
        if photo.name not in cameras or not file.is_file():
            raise InputError(f"{self.source} has no pose or no depth of {photo.name}.")
        depth = np.load(file).astype(np.float64)
        K_photo, T = (np.array(cameras[photo.name][key], float) for key in ("K", "T_world_cam"))
        H, W = depth.shape
        if abs(W / H * photo.height / photo.width - 1) > 0.01:
            raise InputError(
                f"{file.name} is {W} x {H}, but its photo {photo.width} x {photo.height}; same shape needed."
            )
        # The lattice is that of the depth map: the photo is shrunk onto it, and K with it.
        onto = fit((photo.width, photo.height), (H, W), "stretch")
        K_cam = np.vstack([onto.affine, [0, 0, 1]]) @ K_photo
        v, u = np.mgrid[:H, :W] + 0.5  # pixel centres lie at +0.5
        rays = np.stack([(u - K_cam[0, 2]) / K_cam[0, 0], (v - K_cam[1, 2]) / K_cam[1, 1], np.ones_like(u)], axis=-1)
        known = np.isfinite(depth) & (depth > 0) & (depth < self.farthest)
        points = (depth[..., None] * rays) @ T[:3, :3].T + T[:3, 3]
        return View(
            name=photo.name,
            points=np.where(known[..., None], points, np.nan).astype(np.float32),
            confidence=np.where(known, 1 / np.where(known, depth, 1), 0).astype(np.float32),
            evidence=np.zeros((H, W, K), np.float32),
            T_R_cam=T,
            K_cam=K_cam,
            image=onto.image(read_photo(photo)),
            lattice=Lattice(photo.width, photo.height, onto.affine, K_photo),
        )
