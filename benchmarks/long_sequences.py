"""Long sequences through a feed-forward network: is memory flat, do seams hold, how far does the map drift?

    python benchmarks/long_sequences.py [--most 500] [--json FILE] [--keep FOLDER]

A drone flies to and fro over a simulated site of 180 m; its photos (240 x 180 px) go through the driver with a network
that is emulated: of every set of photos it is asked about it gives points, poses and confidence with the errors of VGGT
(``simulation.emulators.VggtLike``), drawn anew for every set, in the frame of its first camera and at a scale of its
own. Each row runs in a process of its own. Memory is anonymous memory (pages of files do not count; the system takes
them back at will), sampled every 10 ms, above what the process held before the driver was called.

"step" is what a seam adds: the error vectors (against truth) of the photos before and after it, averaged on cells of
2 m that both see, and the median length of their difference; "inside" is the same between neighbours within a chunk.
The worst step is given as a share of what one chunk shows and of the height of flight, too. The error is that of all
points after the best similarity, its 95th percentile also as a share of the scene. A quarter of an hour on two cores.
The figures stand in docs/long-sequences.md.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from sequence_figures import scored, table

from excavatwin.backbones.cards import Card, Tried
from excavatwin.backbones.sequence.chunking import Chunking, owners
from excavatwin.backbones.sequence.feed_forward import FeedForward
from excavatwin.backbones.sequence.network import Network, Prediction
from excavatwin.backbones.sequence.selection import Selection
from excavatwin.scene.photo import Photo
from excavatwin.scene.progress import silent
from excavatwin.simulation import DigSite, lawnmower, render_view
from excavatwin.simulation.camera import Camera
from excavatwin.simulation.emulators import VggtLike

SITE = DigSite(cell=0.2, margin=75.0)
WIDTH = 240
EXTENT = 128.0
"""Of the square that is flown over [m]."""
TWICE = VggtLike(rotation=0.4, translation=0.002, focal=0.004, depth_warp=0.005, bend=0.004, noise=0.002)


@dataclass(frozen=True)
class Row:
    """One row of the table."""

    name: str
    photos: int = 500
    size: int = 32
    shared: int = 8
    loops: int = 2
    errors: VggtLike = field(default_factory=VggtLike)
    line: bool = False
    """One straight line of flight, on which no place is seen again."""


ROWS = (
    Row("50 photos", 50),
    Row("100 photos", 100),
    Row("200 photos", 200),
    Row("500 photos"),
    Row("500, one loop a chunk", loops=1),
    Row("500, loops are not closed", loops=0),
    Row("500, chunks of 16, 4 shared", size=16, shared=4),
    Row("500, chunks of 64, 16 shared", size=64, shared=16),
    Row("500, twice the errors", errors=TWICE),
    Row("500, twice the errors, no loops", loops=0, errors=TWICE),
    Row("100 in one straight line", 100, line=True),
    Row("100 in that line, one chunk", 100, size=100, line=True),
    Row("100 photos, one chunk", 100, size=100),
)


@dataclass(frozen=True, eq=False)
class Vggt(FeedForward):
    """An emulated network: knows the cameras, sees the truth through VGGT's errors."""

    card: ClassVar[Card] = Card("emulated VGGT", "reconstructor", "simulated truth with errors", Tried.STAND_IN)
    confidence: ClassVar[str] = "1 + exp"
    patch: ClassVar[int] = 4

    lattice: int = WIDTH
    selection: Selection = field(default_factory=lambda: Selection(overlap=1.0, sharpness=0.0))
    errors: VggtLike = field(default_factory=VggtLike)
    cameras: dict[bytes, int] = field(default_factory=dict)
    """Which camera took an image."""
    flight: tuple[Camera, ...] = ()
    asked: list[int] = field(default_factory=list)
    """Photos of each prediction."""

    def identity(self) -> str:
        """Nothing but itself."""
        return "emulated"

    def memory(self, images: int, height: int, width: int) -> float:
        """Not used: the chunk size is given."""
        return 0.0

    def open(self) -> Network:
        """The network."""
        return self.predict

    def predict(self, images: np.ndarray) -> Prediction:
        """Points and cameras of some images."""
        which = [self.cameras[thumb(image)] for image in images]
        self.asked.append(len(which))
        cameras = [self.flight[i] for i in which]
        seed = int(np.random.default_rng(which).integers(1 << 30))
        views = self.errors([render_view(SITE, camera, samples=0) for camera in cameras], cameras, seed).views
        return Prediction(
            np.stack([view.points for view in views]),
            np.stack([view.confidence for view in views]),
            np.stack([view.T_R_cam for view in views]),
            np.stack([view.K_cam for view in views]),
        )


def thumb(image: np.ndarray) -> bytes:
    """What an image is recognised by."""
    return image[::9, ::9].tobytes()


def flight(row: Row) -> tuple[Camera, ...]:
    """The cameras, lines flown to and fro, or the first 460 m of one line through the middle."""
    if not row.line:
        return lawnmower(extent=EXTENT, width=WIDTH)[: row.photos]
    cameras = []
    for camera in lawnmower(extent=460.0, width=WIDTH)[: row.photos]:
        pose = camera.T_M_cam.copy()
        pose[0, 3] += 230.0
        cameras.append(replace(camera, T_M_cam=pose))
    return tuple(cameras)


def photographed(folder: Path, row: Row) -> tuple[Photo, ...]:
    """The photos, rendered where they are not there yet."""
    from PIL import Image

    photos = []
    for i, camera in enumerate(flight(row)):
        path = folder / f"{'line_' if row.line else ''}{i:04d}.png"
        if not path.exists():
            Image.fromarray(render_view(SITE, camera, samples=1).image).save(path)
        photos.append(Photo(path.name, path, camera.width, camera.height, "drone", time=float(i)))
    return tuple(photos)


class Memory:
    """Peak anonymous memory of this process while it runs [bytes]."""

    def __init__(self) -> None:
        self.before = self.peak = held()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def _watch(self) -> None:
        while not self._stop.wait(0.01):
            self.peak = max(self.peak, held())

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Watch what happens inside."""
        self._thread.start()
        yield
        self._stop.set()
        self._thread.join()


def held() -> int:
    """Anonymous memory now [bytes]."""
    rows = Path("/proc/self/status").read_text().splitlines()
    return 1024 * int(next(row for row in rows if row.startswith("RssAnon")).split()[1])


def run(name: str, folder: Path) -> dict[str, Any]:
    """One row."""
    from PIL import Image

    row = next(row for row in ROWS if row.name == name)
    photos, cameras = photographed(folder, row), flight(row)
    known = {thumb(np.asarray(Image.open(photo.path))): i for i, photo in enumerate(photos)}
    chunking = Chunking(size=row.size, shared=row.shared, loops=row.loops)
    model = Vggt(chunking=chunking, errors=row.errors, cameras=known, flight=cameras)
    with tempfile.TemporaryDirectory() as warm:  # libraries and the site are loaded, kernels compiled
        replace(model, asked=[])(photos[:2], silent, Path(warm))
    with tempfile.TemporaryDirectory() as scratch:
        memory, start = Memory(), time.perf_counter()
        with memory.watched():
            obs = model(photos, silent, Path(scratch))
        told = {"name": name, "photos": row.photos, "memory": memory.peak - memory.before}
        told |= {"seconds": time.perf_counter() - start, "predicted": sum(model.asked)}
        plan = chunking.plan(row.photos, row.size)
        told |= {"chunks": len(plan), "loops": obs.source["loops"], "drift": obs.source["drift"]}
        return told | scored(SITE, obs, cameras, owners(plan))


def main() -> None:
    """Run all rows, each in its own process, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--most", type=int, default=500, help="rows with more photos are left out")
    parser.add_argument("--json", type=Path, help="write the figures there")
    parser.add_argument("--keep", type=Path, help="folder of the rendered photos")
    parser.add_argument("--row", help="run this row only, print it as JSON")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as made:
        folder = given.keep or Path(made)
        folder.mkdir(parents=True, exist_ok=True)
        if given.row:
            print(json.dumps(run(given.row, folder)))
            return
        rows = []
        for row in ROWS:
            if row.photos <= given.most:
                command = [sys.executable, __file__, "--row", row.name, "--keep", str(folder)]
                said = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
                rows.append(json.loads(said.splitlines()[-1]))
                print(table(rows[-1:]), flush=True)
    print(table(rows))
    print(json.dumps(rows))
    if given.json:
        given.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
