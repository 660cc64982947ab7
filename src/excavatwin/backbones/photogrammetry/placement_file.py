"""A placement on disk: one ``placement.npz`` with the arrays and, as text inside it, everything else."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from excavatwin.backbones.photogrammetry.placement import PlacedCamera, Placement, SparsePoints
from excavatwin.errors import InputError
from excavatwin.scene.observations import Georeference, Unplaced

FILE = "placement.npz"
VERSION = 1


def save_placement(placement: Placement, folder: Path) -> Path:
    """Write ``placement.npz`` into an existing folder; gives its path."""
    points = placement.points
    told: dict[str, Any] = {
        "version": VERSION,
        "cameras": [
            {key: getattr(camera, key) for key in ("name", "width", "height", "n_points", "reprojection_error")}
            for camera in placement.cameras
        ],
        "unplaced": [asdict(item) for item in placement.unplaced],
        "georeference": asdict(placement.georeference) if placement.georeference else None,
        **{key: getattr(placement, key) for key in ("up_from", "up_doubt", "metres_per_unit", "calibration", "source")},
        "doubts": list(placement.doubts),
    }
    path = Path(folder) / FILE
    n = len(placement.cameras)
    np.savez_compressed(
        path,
        told=np.array(json.dumps(told)),
        K_photo=np.array([camera.K_photo for camera in placement.cameras]).reshape(n, 3, 3),
        T_R_cam=np.array([camera.T_R_cam for camera in placement.cameras]).reshape(n, 4, 4),
        distortion=np.array([camera.distortion for camera in placement.cameras]).reshape(n, 4),
        xyz=points.xyz,
        error=np.empty(0) if points.error is None else points.error,
        visible=np.concatenate([*points.visible, np.empty(0, np.int64)]).astype(np.int64),
        visible_counts=np.array([len(index) for index in points.visible], np.int64),
    )
    return path


def load_placement(folder: Path) -> Placement:
    """Read what ``save_placement`` wrote, bit by bit the same.

    Raises:
        InputError: the file is not a placement of this version.
    """
    with np.load(Path(folder) / FILE, allow_pickle=False) as file:
        told = json.loads(str(file["told"]))
        if told.get("version") != VERSION:
            raise InputError(
                f"{Path(folder) / FILE} has version {told.get('version')}, expected {VERSION}; place again."
            )
        arrays = {key: file[key] for key in file.files if key != "told"}
    lenses = zip(told.pop("cameras"), arrays["K_photo"], arrays["T_R_cam"], arrays["distortion"], strict=True)
    cameras = tuple(
        PlacedCamera(K_photo=K, T_R_cam=T, distortion=(d[0].item(), d[1].item(), d[2].item(), d[3].item()), **facts)
        for facts, K, T, d in lenses
    )
    visible = np.split(arrays["visible"], np.cumsum(arrays["visible_counts"]))[: len(cameras)]
    error = arrays["error"] if len(arrays["error"]) == len(arrays["xyz"]) else None
    place = told.pop("georeference")
    georeference = Georeference(place["epsg"], tuple(place["origin"]), place["residual"]) if place else None
    told.pop("version")
    return Placement(
        cameras=cameras,
        points=SparsePoints(arrays["xyz"], tuple(visible), error),
        unplaced=tuple(Unplaced(**item) for item in told.pop("unplaced")),
        georeference=georeference,
        doubts=tuple(told.pop("doubts")),
        **told,
    )
