"""Observations with photos and a witness in which everything is right: what the validator's tests break on purpose.

Rendered truth, exact on the lattice of the views; the photos are twice as fine and came onto it as network inputs do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np

from excavatwin.backbones.appearance import Appearance
from excavatwin.backbones.lattices import fit
from excavatwin.backbones.protocols import Picture
from excavatwin.scene.observations import Lattice, Observations, View
from excavatwin.simulation import DigSite, lawnmower, orbit, render_view
from excavatwin.simulation.camera import Camera

SITE = DigSite(cell=0.1, margin=4.0)
SIZE = (728, 548)
"""Width and height of the photos [px]."""
SHAPES = {"crop": (224, 364), "pad": (364, 364), "stretch": (274, 364)}
"""(H, W) of the lattice; the first cuts 25 rows off on both sides, the second adds 45."""


@dataclass(frozen=True)
class Sound:
    """Everything that the validator takes."""

    observations: Observations
    photos: dict[str, np.ndarray]
    witness: dict[str, np.ndarray]


@lru_cache
def sound(mode: str = "crop", flight: str = "orbit", views: int = 4) -> Sound:
    """Views that came onto their lattice by ``mode``."""
    fly = {"orbit": orbit, "lawnmower": lawnmower}[flight]
    cameras = fly(views, width=SIZE[0], aspect=SIZE[1] / SIZE[0], seed=7)
    made = [_view(f"{number:02d}.jpg", camera, mode) for number, camera in enumerate(cameras)]
    observations = Observations(
        tuple(view for view, _ in made), np.array([0.0, 0, 1]), 1.0, source={"confidence": "1 + exp"}
    )
    photos = {view.name: photo for view, photo in made}
    witness = {view.name: Appearance()(Picture(view.image)).evidence for view, _ in made}
    return Sound(observations, photos, witness)


def changed(observations: Observations, change) -> Observations:
    """The same change made to every view."""
    return replace(observations, views=tuple(change(view) for view in observations.views))


def one_hot(view: View) -> View:
    """The view with labels as evidence."""
    label = np.where(view.evidence.max(-1) > 0.4, view.evidence.argmax(-1) + 1, 0)
    return replace(view, evidence=(label[..., None] == np.arange(1, 6)).astype(np.float32))


@lru_cache
def _photo(pose: bytes, width: int, height: int, focal: float) -> np.ndarray:
    camera = Camera(width, height, focal, np.frombuffer(pose).reshape(4, 4))
    return render_view(SITE, camera, samples=1).image


def _view(name: str, camera: Camera, mode: str) -> tuple[View, np.ndarray]:
    photo = _photo(camera.T_M_cam.tobytes(), camera.width, camera.height, camera.focal)
    H, W = SHAPES[mode]
    placed = fit(SIZE, (H, W), mode)
    shown = Camera(W, min(H, placed.resized[1]), camera.focal / 2, camera.T_M_cam)  # all modes halve this photo
    true = render_view(SITE, shown, samples=0)
    pad = (H - shown.height) // 2
    rows = ((pad, pad), (0, 0))
    points = np.pad(true.points, (*rows, (0, 0)), constant_values=np.nan)
    label = np.pad(true.label, rows, constant_values=255)
    distance = np.linalg.norm(points - camera.T_M_cam[:3, 3], axis=-1)
    evidence = 0.9 * (label[..., None] == np.arange(1, 6)).astype(np.float32)
    view = View(
        name=name,
        points=points,
        confidence=np.nan_to_num(1 + 8 * np.exp(-distance / 20), nan=1).astype(np.float32),
        evidence=cv2.GaussianBlur(evidence, (0, 0), 0.7).clip(0, 1),
        T_R_cam=camera.T_M_cam.copy(),
        K_cam=np.array([[shown.focal, 0, W / 2], [0, shown.focal, H / 2], [0, 0, 1.0]]),
        image=placed.image(photo),
        lattice=Lattice(*SIZE, placed.affine, camera.K_cam),
    )
    return view, photo
