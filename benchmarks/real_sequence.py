"""The driver of long sequences on real photos: chunks that were reconstructed independently, put together, against all
photos reconstructed together.

    python benchmarks/real_sequence.py PHOTOS [--size 20] [--shared 8] [--loops 2]

No weights are at hand where this runs, so the part of the network is played by the built-in photogrammetry, which is
given the lattice images of one chunk at a time, without EXIF: it finds its own focal length, in a frame and at a scale
of its own, from these pixels alone. Two runs are compared: one chunk with all photos, and many chunks. Some ten minutes
for 75 photos. The figures stand in docs/long-sequences.md.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np

from excavatwin.backbones.cards import Card, Tried
from excavatwin.backbones.photogrammetry import Dense, Photogrammetry
from excavatwin.backbones.sequence.chunking import Chunking
from excavatwin.backbones.sequence.feed_forward import FeedForward
from excavatwin.backbones.sequence.network import Network, Prediction
from excavatwin.capture import find_photos
from excavatwin.scene.frames import umeyama
from excavatwin.scene.observations import Observations
from excavatwin.scene.photo import Photo
from excavatwin.scene.progress import silent


@dataclass(frozen=True)
class Played(FeedForward):
    """Photogrammetry in the part of a network."""

    card: ClassVar[Card] = Card("played", "reconstructor", "photogrammetry on a chunk's lattice images", Tried.STAND_IN)
    confidence: ClassVar[str] = "confirming views"
    patch: ClassVar[int] = 4

    lattice: int = 480
    asked: list[int] = field(default_factory=list)

    def identity(self) -> str:
        """Nothing but itself."""
        return "photogrammetry"

    def memory(self, images: int, height: int, width: int) -> float:
        """Not used: the chunk size is given."""
        return 0.0

    def open(self) -> Network:
        """The network."""
        return self.predict

    def predict(self, images: np.ndarray) -> Prediction:
        """Points and cameras; photos that are not placed have none."""
        from PIL import Image

        self.asked.append(len(images))
        S, H, W = images.shape[:3]
        with tempfile.TemporaryDirectory() as folder:
            photos = []
            for i, image in enumerate(images):
                path = Path(folder) / f"{i:04d}.png"
                Image.fromarray(image).save(path)
                photos.append(Photo(path.name, path, W, H, "one"))
            found = Photogrammetry(lattice=self.lattice, dense=Dense())(photos)
        points, confidence = np.full((S, H, W, 3), np.nan, np.float32), np.zeros((S, H, W), np.float32)
        T, K = np.array([np.eye(4)] * S), np.array([[[W, 0, W / 2], [0, W, H / 2], [0, 0, 1.0]]] * S)
        for view in found.views:
            i = int(view.name[:4])
            points[i], confidence[i], T[i], K[i] = view.points, view.confidence, view.T_R_cam, view.K_cam
        return Prediction(points, confidence, T, K)


def compared(parts: Observations, whole: Observations) -> str:
    """The points of both, after the best similarity: shares of the viewing distance and of the scene."""
    a, b, eye = [], [], []
    for view in parts.views:
        other = whole.view(view.name)
        if other is not None:
            a.append(np.asarray(view.points[::4, ::4], float).reshape(-1, 3))
            b.append(np.asarray(other.points[::4, ::4], float).reshape(-1, 3))
            eye.append(np.broadcast_to(other.centre, b[-1].shape))
    p, q, c = (np.concatenate(x) for x in (a, b, eye))
    use = np.isfinite(p).all(1) & np.isfinite(q).all(1)
    p, q, c = p[use], q[use], c[use]
    weight = np.ones(len(p))
    for _ in range(4):
        s, R, t = umeyama(p, q, weight)
        miss = np.linalg.norm(s * p @ R.T + t - q, axis=1)
        weight = (miss <= np.quantile(miss, 0.9)).astype(float)
    distance = float(np.median(np.linalg.norm(q - c, axis=1)))
    scene = float(np.linalg.norm(np.subtract(*np.quantile(q, [0.98, 0.02], axis=0))))
    middle, high = np.quantile(miss, [0.5, 0.95])
    return (
        f"{len(a)} photos: points differ by {middle / distance:.2%} of the distance (median), {high / distance:.2%} "
        f"(p95); {middle / scene:.2%} and {high / scene:.2%} of the scene"
    )


def main() -> None:
    """Both runs, and their difference."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photos", type=Path)
    parser.add_argument("--size", type=int, default=20)
    parser.add_argument("--shared", type=int, default=8)
    parser.add_argument("--loops", type=int, nargs="*", default=[0, 2])
    given = parser.parse_args()
    photos = find_photos(given.photos)
    with tempfile.TemporaryDirectory() as folder:
        runs: dict[str, Observations] = {}
        plans = {"whole": Chunking(size=len(photos))}
        plans |= {f"loops {n}": Chunking(size=given.size, shared=given.shared, loops=n) for n in given.loops}
        for name, chunking in plans.items():
            scratch = Path(folder) / name
            scratch.mkdir()
            runs[name] = Played(chunking=chunking)(photos, silent, scratch)
            source = runs[name].source
            print(name, source["chunks"], source["loops"], source["drift"], sep="; ", flush=True)
            print(*runs[name].doubts, sep="\n", flush=True)
            if name != "whole":
                print(compared(runs[name], runs["whole"]), flush=True)


if __name__ == "__main__":
    main()
