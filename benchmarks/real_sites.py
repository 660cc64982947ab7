"""Real photos, no truth: placed photos, coverage of the ground that three photos or more see, time and memory.

    python benchmarks/real_sites.py [--data FOLDER] [--out FOLDER] [NAME ...]

FOLDER holds the shared data sets (default: the folder ``shared/data`` beside the clone, or $EXCAVATWIN_DATA). Every set
is mapped from scratch with the defaults in a process of its own. Ground is "seen" by a photo when the surface of the
map (carried on over gaps) projects into it; what every photo sees only from too far away or too flatly for the map does
not count. Occlusion is ignored, so the coverage stated is a lower bound. Forest and water count as ground, too.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import xarray

from excavatwin.backbones.photogrammetry import Photogrammetry
from excavatwin.geometry.envelope import fill_ground
from excavatwin.mapping.raster import Raster
from excavatwin.scene.frames import project

EXCAVATION = [f"IMG_{n}.jpg" for n in (*range(9400, 9408), *range(9414, 9431))]
SETS = {
    "caliterra-23": ("caliterra_site", EXCAVATION),
    "caliterra-75": ("caliterra_site", None),
    "brighton": ("brighton_beach", None),
    "lewis": ("lewis_oblique", None),
    "sandpile": ("sandpile_oppaiyama", None),
}


def coverage(site: Path, views: int = 3) -> float:
    """Share of the cells seen by ``views`` photos or more that the map observes."""
    with xarray.open_dataset(site / "map.nc") as m:
        H, observed = m.elevation.values.astype(np.float64), m.observed.values.astype(bool)
        x, y = m.x.values, m.y.values
    photos = [photo for photo in json.loads((site / "cameras.json").read_text())["cameras"] if photo["placed"]]
    pad = 40  # ground around the map counts, too
    step = float(abs(x[1] - x[0]))
    H, observed = np.pad(H, pad, constant_values=np.nan), np.pad(observed, pad)
    ground = fill_ground(H.astype(np.float32), np.isfinite(H))
    column, row = np.arange(H.shape[1]) - pad, np.arange(H.shape[0]) - pad
    X, Y = np.meshgrid(x[0] + step * column, y[0] - step * row)
    p = np.stack([X, Y, ground], axis=-1).reshape(-1, 3)
    seen, finest = np.zeros(len(p), int), np.full(len(p), np.inf)
    for photo in photos:
        K, T = np.array(photo["K"]), np.array(photo["T_map_cam"])
        uv, z = project(K, T, p)
        inside = (z > 0) & (uv > 0).all(axis=1) & (uv[:, 0] < photo["width"]) & (uv[:, 1] < photo["height"])
        ray = T[:3, 3] - p
        length = np.linalg.norm(ray, axis=1)
        lattice = max(photo["width"], photo["height"]) / Photogrammetry().lattice
        extent = lattice * length / K[0, 0] * length / np.maximum(np.abs(ray[:, 2]), 1e-6)
        seen += inside
        finest = np.minimum(finest, np.where(inside, extent, np.inf))
    wanted = (seen >= views) & (finest <= Raster().max_extent * step)
    return float(observed.ravel()[wanted].mean())


def main() -> None:
    """Map the sets and print one row each, as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = os.environ.get("EXCAVATWIN_DATA", Path(__file__).resolve().parents[2] / "shared" / "data")
    parser.add_argument("--data", type=Path, default=Path(default))
    parser.add_argument("--out", type=Path)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(SETS)}")
    options = parser.parse_args()
    out = options.out or Path(tempfile.mkdtemp(prefix="excavatwin-real-"))
    print("| set | placed | covered (3+ photos) | seconds | peak memory | objects |\n|---|---|---|---|---|---|")
    for name in options.names or SETS:
        folder, wanted = SETS[name]
        photos = out / f"{name}-photos"
        photos.mkdir(parents=True, exist_ok=True)
        for file in sorted((options.data / folder / "images").iterdir()):
            if wanted is None or file.name in wanted:
                (photos / file.name).unlink(missing_ok=True)
                (photos / file.name).symlink_to(file)
        command = [sys.executable, "-m", "excavatwin", "map", str(photos), "-o", str(out / name), "--fresh"]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        run = json.loads((out / name / "run.json").read_text())
        n = len(json.loads((out / name / "objects.geojson").read_text())["features"])
        print(
            f"| {name} | {run['photos']['placed']} of {run['photos']['found']} | {coverage(out / name):.1%} "
            f"| {run['seconds']:.0f} | {run['peak_memory_bytes'] / 1e9:.2f} GB | {n} |",
            flush=True,
        )
    print(f"\nresults in {out}")


if __name__ == "__main__":
    main()
