"""A flight over analytic ground, photographed to disk, and a network that knows the truth up to what it is told to err.

The network recognises each image it is given by its pixels, so it can be asked for any photos in any order, and answers
in a frame of its own for every set of photos, as networks do.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np

from excavatwin.backbones.cards import Card, Tried
from excavatwin.backbones.sequence.feed_forward import FeedForward
from excavatwin.backbones.sequence.network import Network, Prediction
from excavatwin.backbones.sequence.selection import Selection
from excavatwin.backbones.sequence.similarities import moved_pose, similarity
from excavatwin.scene.frames import transform
from excavatwin.scene.photo import Photo

EVERY = Selection(overlap=1.0, sharpness=0.0)
"""No photo is left out."""


def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Rolling ground with mounds [m]."""
    rolling = 0.8 * np.sin(x / 9) * np.cos(y / 7) + 0.25 * np.sin(x / 2.3 + 1) * np.sin(y / 2.9)
    return rolling + 1.5 * np.exp(-((np.mod(x, 17) - 8) ** 2 + (np.mod(y, 13) - 6) ** 2) / 5)


def down(x: float, y: float, heading: float, above: float = 20.0, tilt: float = 12.0) -> np.ndarray:
    """Pose of a camera that looks down and ``tilt`` ahead, flying in the direction ``heading`` from east [deg]."""
    h, t = np.radians([heading, tilt])
    ahead = np.array([np.cos(h), np.sin(h), 0])
    forward = np.sin(t) * ahead - np.cos(t) * np.array([0, 0, 1.0])
    right = np.cross(ahead, [0, 0, 1.0])
    T = np.eye(4)
    T[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    T[:3, 3] = (x, y, above)
    return T


def line(count: int, step: float = 2.0) -> np.ndarray:
    """Poses along a gently winding line."""
    return np.array([down(step * i, 3 * np.sin(i / 5), 20 * np.cos(i / 5), 20 + np.sin(i / 3)) for i in range(count)])


def ring(count: int, radius: float = 30.0) -> np.ndarray:
    """Poses around a circle whose end meets its beginning."""
    turn = 2 * np.pi * np.arange(count) / (count - 3)
    return np.array(
        [down(radius * np.cos(a), radius * np.sin(a), np.degrees(a) + 90, 20 + np.sin(3 * a)) for a in turn]
    )


@dataclass(frozen=True, eq=False)
class Flight:
    """Photos of the ground, and the truth."""

    poses: np.ndarray
    folder: Path
    shape: tuple[int, int] = (48, 64)
    seed: int = 0

    @property
    def K(self) -> np.ndarray:
        """Intrinsics on the photo, which is the lattice."""
        H, W = self.shape
        return np.array([[0.8 * W, 0, W / 2], [0, 0.8 * W, H / 2], [0, 0, 1.0]])

    @cached_property
    def _known(self) -> dict[int, np.ndarray]:
        return {}

    def points(self, i: int) -> np.ndarray:
        """True points of a view, float64 [m]."""
        if i not in self._known:
            self._known[i] = self._met(i)
        return self._known[i]

    def _met(self, i: int) -> np.ndarray:
        """Where the rays of a view meet the ground."""
        H, W = self.shape
        v, u = np.mgrid[:H, :W] + 0.5
        rays = np.stack([(u - W / 2) / (0.8 * W), (v - H / 2) / (0.8 * W), np.ones_like(u)], -1)
        rays = rays @ self.poses[i][:3, :3].T
        eye = self.poses[i][:3, 3]
        t = -eye[2] / rays[..., 2]
        for _ in range(25):
            t = (height(eye[0] + t * rays[..., 0], eye[1] + t * rays[..., 1]) - eye[2]) / rays[..., 2]
        return eye + t[..., None] * rays

    @cached_property
    def _texture(self) -> np.ndarray:
        rng = np.random.default_rng(self.seed)
        n = 1024
        frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(n), np.fft.fftfreq(n)))
        frequency[0, 0] = 1
        spectrum = np.fft.fft2(rng.normal(size=(3, n, n))) / frequency**0.8
        pattern = np.real(np.fft.ifft2(spectrum))
        pattern /= pattern.std(axis=(1, 2), keepdims=True)
        return np.clip(118 + 38 * pattern, 0, 255).astype(np.uint8).transpose(1, 2, 0)

    def image(self, i: int) -> np.ndarray:
        """The photo: what the ground is painted with."""
        import cv2

        at = np.mod(self.points(i)[..., :2] / 0.09, 1024).astype(np.float32)
        return cv2.remap(self._texture, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)

    @cached_property
    def photos(self) -> tuple[Photo, ...]:
        """The photos, written to the folder when first asked for."""
        from PIL import Image

        self.folder.mkdir(parents=True, exist_ok=True)
        made = []
        for i in range(len(self.poses)):
            path = self.folder / f"photo_{i:04d}.png"
            Image.fromarray(self.image(i)).save(path)
            made.append(Photo(path.name, path, self.shape[1], self.shape[0], "x", time=float(i)))
        return tuple(made)

    @cached_property
    def index(self) -> dict[bytes, int]:
        """Which photo an image is."""
        from excavatwin.capture import read_photo

        return {read_photo(photo).tobytes(): i for i, photo in enumerate(self.photos)}


@dataclass(frozen=True, eq=False)
class Emulated(FeedForward):
    """A network whose answers are the truth, with errors on request."""

    card: ClassVar[Card] = Card("emulated", "reconstructor", "the truth, moved about", Tried.STAND_IN)
    confidence: ClassVar[str] = "emulated"
    patch: ClassVar[int] = 4

    lattice: int = 64
    selection: Selection = field(default_factory=lambda: EVERY)
    flight: Flight | None = None
    frames: int = 0
    """Seed of the similarities; -1 answers in metres in the true frame."""
    depth_error: float = 0.0
    """Relative error of each view's depth as a whole, standard deviation."""
    tilt: float = 0.0
    """Bend of every answer along the flight [1 / m]: the cause of drift."""
    outliers: float = 0.0
    """Share of the pixels whose points are anywhere."""
    metric: bool = False
    budget: int = 10_000
    """Images at once for which memory suffices."""
    asked: list[tuple[int, ...]] = field(default_factory=list)
    """What it was asked for."""

    def identity(self) -> str:
        return "emulated 1"

    def memory(self, images: int, height: int, width: int) -> float:
        return 1e6 * images

    def open(self) -> Network:
        return self.answer

    def answer(self, images: np.ndarray) -> Prediction:
        """The network."""
        assert self.flight is not None
        if len(images) > self.budget:
            raise RuntimeError("CUDA out of memory. Tried to allocate 2.00 GiB")
        which = [self.flight.index[image.tobytes()] for image in images]
        self.asked.append(tuple(which))
        rng = np.random.default_rng([abs(self.frames), *which])
        S = np.eye(4) if self.frames < 0 else random_similarity(rng)
        points, poses = [], []
        for i in which:
            true, T = self.flight.points(i), self.flight.poses[i]
            wrong = 1 + self.depth_error * rng.normal()
            p = T[:3, 3] + wrong * (true - T[:3, 3])
            p, T = bent(p, T, self.flight.poses[which[0]], self.tilt)
            lost = rng.random(p.shape[:2]) < self.outliers
            p = np.where(lost[..., None], T[:3, 3] + rng.uniform(0.2, 3, p.shape[:2])[..., None] * (p - T[:3, 3]), p)
            points.append(transform(S, p))
            poses.append(moved_pose(S, T))
        confidence = np.array([1 + np.random.default_rng(i).random(self.flight.shape) for i in which])
        K = np.broadcast_to(self.flight.K, (len(which), 3, 3))
        return Prediction(
            np.array(points, np.float32), confidence.astype(np.float32), np.array(poses), K, metric=self.metric
        )

    def with_chunks(self, size: int | None, shared: int = 4, loops: int = 0) -> Emulated:
        """The same with another plan."""
        return replace(self, chunking=replace(self.chunking, size=size, shared=shared, loops=loops), asked=[])


def bent(p: np.ndarray, T: np.ndarray, first: np.ndarray, tilt: float) -> tuple[np.ndarray, np.ndarray]:
    """Points and pose turned about the first camera in proportion to the way from there: rays stay rays."""
    from scipy.spatial.transform import Rotation

    way = T[:3, 3] - first[:3, 3]
    R = Rotation.from_rotvec(tilt * np.cross([0, 0, 1.0], way)).as_matrix()
    moved = np.eye(4)
    moved[:3, :3], moved[:3, 3] = R, first[:3, 3] - R @ first[:3, 3]
    return transform(moved, p), moved @ T


def random_similarity(rng: np.random.Generator) -> np.ndarray:
    """Any rotation, a scale from 0.05 to 20, a shift."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    q = q if np.linalg.det(q) > 0 else q[:, [1, 0, 2]]
    scale = float(np.exp(rng.uniform(-3, 3)))
    return similarity(scale, q, scale * 20 * rng.normal(size=3))
