"""A tiny data set in the OCES-like layout, written by hand: two epochs of a flat yard with one box, seen from above."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from PIL import Image
from rasterio.transform import Affine

ORIGIN = (691000.0, 5334000.0, 520.0)
WIDTH, HEIGHT, F, ALTITUDE = 40, 30, 30.0, 12.0
GROUND = 0.4


def write_json(path: Path, content: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


def raster(path: Path, values: np.ndarray, **more: Any) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        with rasterio.open(
            path, "w", driver="GTiff", count=1, dtype="float32", height=values.shape[0], width=values.shape[1], **more
        ) as file:
            file.write(values.astype(np.float32), 1)


def write(root: Path, epochs: int = 2) -> Path:
    """The whole data set, with one sequence."""
    names = [f"epoch_{k:02d}" for k in range(epochs)]
    write_json(
        root / "dataset.json",
        {
            "format": "excavatwin-oces", "version": 1, "name": "yard", "policy": "diggable",
            "categories": ["excavator", "truck"], "sequences": ["site_007"],
        },
    )  # fmt: skip
    place = root / "site_007"
    write_json(
        place / "sequence.json",
        {
            "name": "site_007",
            "seed": 7,
            "flight": "hover",
            "epsg": 32632,
            "origin": ORIGIN,
            "epochs": names,
            "times": [f"2025-06-02T{9 + k:02d}:00:00" for k in range(epochs)],
        },
    )
    write_json(
        place / "change.json",
        [{"from": "epoch_00", "to": "epoch_01", "cut_m3": 4.0, "fill_m3": 5.0, "net_m3": 1.0}],
    )
    for name in names:
        epoch(place / name)
    return root


def epoch(place: Path) -> None:
    for part in ("images", "labels", "instances", "depth"):
        (place / part).mkdir(parents=True)
    K = [[F, 0, WIDTH / 2], [0, F, HEIGHT / 2], [0, 0, 1]]
    frames = []
    for k in range(3):
        T = np.diag([1.0, -1.0, -1.0, 1.0])  # straight down
        T[:3, 3] = (k - 1.0, 0.5, ALTITUDE)
        label = np.full((HEIGHT, WIDTH), 1, np.uint8)
        depth = np.full((HEIGHT, WIDTH), ALTITUDE - GROUND, np.float32)
        label[12:18, 16:24], depth[12:18, 16:24] = 4, ALTITUDE - GROUND - 2
        label[:2], depth[:2] = 255, np.nan
        stem = f"{k:06d}"
        Image.fromarray(np.full((HEIGHT, WIDTH, 3), 90, np.uint8)).save(place / "images" / f"{stem}.jpg")
        Image.fromarray(label).save(place / "labels" / f"{stem}.png")
        Image.fromarray((label == 4).astype(np.uint16) * 300).save(place / "instances" / f"{stem}.png")
        raster(place / "depth" / f"{stem}.tif", depth, nodata=np.nan)
        frames.append(
            {
                "name": f"{stem}.jpg",
                "width": WIDTH,
                "height": HEIGHT,
                "K": K,
                "T_map_cam": T.tolist(),
                "time_s": 5.0 * k,
            }
        )
    write_json(place / "cameras.json", {"frames": frames})
    height = np.full((40, 50), GROUND + ORIGIN[2])
    height[0, 0] = -9999
    west, north = ORIGIN[0] - 10, ORIGIN[1] + 8
    raster(
        place / "elevation.tif", height, nodata=-9999, crs="EPSG:32632", transform=Affine(0.4, 0, west, 0, -0.4, north)
    )
    box = {"object_id": 300, "name": "digger", "category": "excavator", "task_class": 4, "size": [4.0, 1.5, 2.0]}
    box |= {"centre": [0.5, 0.5, 1.4], "yaw": 30.0, "z_base": 0.4, "z_top": 2.4}
    write_json(place / "objects.json", [box])
    np.savez(place / "truth.npz", west=0.0)
