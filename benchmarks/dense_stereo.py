"""Dense stereo against exact truth: time, cover and error on a rendered dig site, nadir and oblique.

    python benchmarks/dense_stereo.py [--width 640] [--views 12] [--runs 3]

Each flight is rendered once and matched ``runs`` times on one thread after a warm-up that compiles the kernels; times
are medians over the runs, of processor seconds per photo. Errors are of height, in ground sampling distances (GSD:
depth over focal length) of the pixel. "edge" is the median in the zone within 4 px of a depth edge of the truth, where
windows blur; "halo" is the share of that zone that is wrong by more than 8 GSD. "sky" is the share of the pixels
without any surface that got a depth.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from dense_scene import dig_site, photograph
from excavatwin.backbones.photogrammetry.dense import Dense, densify
from excavatwin.backbones.photogrammetry.sweep import rays


def edge_zone(depth: np.ndarray) -> np.ndarray:
    """Pixels within 4 px of a depth step of more than 0.6 m in the truth."""
    filled = np.nan_to_num(depth, nan=1e3)
    step = cv2.dilate(filled, np.ones((3, 3))) - cv2.erode(filled, np.ones((3, 3)))
    return cv2.dilate((step > 0.6).astype(np.uint8), np.ones((9, 9))) > 0


def measure(kind: str, width: int, views: int, runs: int) -> None:
    """Render one flight, match it, print its rows."""
    images, sparse, truth = photograph(dig_site(), kind, views, width)
    parameters = replace(Dense(), threads=1, views=1, views_oblique=1)
    densify(images[:3], replace(sparse, visible=sparse.visible[:3]), parameters)
    seconds = []
    for _ in range(runs):
        begin = time.process_time()
        result = densify(images, sparse, parameters)
        seconds.append((time.process_time() - begin) / views)
    rows = []
    for image, exact, (depth, support) in zip(images, truth, result, strict=True):
        slope = rays(image.K_cam, image.T_R_cam, depth.shape)[..., 2]
        error = np.abs(slope * (depth - exact)) / (exact / image.K_cam[0, 0])
        rows.append((error.ravel(), support.ravel(), edge_zone(exact).ravel(), np.isfinite(exact).ravel()))
    error, support, edge, real = (np.concatenate(column) for column in zip(*rows, strict=True))
    for votes in (1, 2, 3, 5):
        kept = (support >= votes) & np.isfinite(error) & real
        e, h = error[kept], error[kept & edge]
        sky = f"{(support[~real] >= votes).mean():6.1%}" if (~real).any() else "     -"
        print(
            f"{kind:8s} {np.median(seconds):6.2f} {votes:6d} {kept.sum() / real.sum():6.1%} {np.median(e):7.3f} "
            f"{np.quantile(e, 0.9):6.2f} {np.quantile(e, 0.99):6.1f} {np.median(h):7.3f} {(h > 8).mean():6.1%} {sky}"
        )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--width", type=int, default=640, help="of the photos [px]")
    parser.add_argument("--views", type=int, default=12, help="photos of each flight")
    parser.add_argument("--runs", type=int, default=3)
    options = parser.parse_args()
    print("flight    CPU-s  votes  cover  median    p90    p99    edge   halo    sky")
    for kind in ("nadir", "oblique"):
        measure(kind, options.width, options.views, options.runs)


if __name__ == "__main__":
    main()
