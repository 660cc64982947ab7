"""Read the truth of a site from ``truth.npz``, as ``simulation.save_truth`` writes it (layout: sample/README.md)."""

from __future__ import annotations

from pathlib import Path
from zipfile import BadZipFile, is_zipfile
from zlib import error as ZlibError

import numpy as np

from excavatwin.errors import InputError
from excavatwin.scene.elevation_map import MapObject
from excavatwin.scene.grid import Grid
from excavatwin.scene.observations import Georeference
from excavatwin.scene.taxonomy import TaskClass
from excavatwin.scene.truth import Truth, ViewTruth

REQUIRED = ("west", "north", "cell", "epsg", "origin", "height", "surface", "label", "instance")


def load_truth(path: str | Path) -> Truth:
    """The truth in a file.

    Raises:
        InputError: the file is missing, damaged, is no ``.npz``, or lacks an array.
    """
    if Path(path).is_file() and not is_zipfile(path):
        raise InputError(
            f"{path} cannot be read: it is no .npz file, or damaged; give the truth.npz of a simulated site."
        )
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except (BadZipFile, ZlibError) as error:
        raise InputError(f"{path} is damaged ({error}); copy or simulate it again.") from error
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path} cannot be read as a truth file ({error}); expected an .npz with {', '.join(REQUIRED)}."
        ) from error
    missing = [name for name in REQUIRED if name not in arrays]
    if missing:
        raise InputError(f"{path} lacks the array {missing[0]!r}; a truth file holds {', '.join(REQUIRED)}.")
    rows, cols = arrays["height"].shape
    grid = Grid(float(arrays["west"]), float(arrays["north"]), float(arrays["cell"]), rows, cols)
    epsg, origin = int(arrays["epsg"]), tuple(float(v) for v in arrays["origin"])
    return Truth(
        grid,
        arrays["height"].astype(np.float32),
        arrays["surface"].astype(np.float32),
        arrays["label"].astype(np.uint8),
        arrays["instance"].astype(np.uint8),
        _objects(arrays),
        tuple(str(name) for name in arrays.get("object_name", ())),
        _views(arrays),
        Georeference(epsg, (origin[0], origin[1], origin[2]), 0.0) if epsg else None,
    )


def _objects(a: dict[str, np.ndarray]) -> tuple[MapObject, ...]:
    return tuple(
        MapObject(
            object_id=int(a["object_id"][m]),
            task_class=TaskClass(int(a["object_class"][m])),
            centre=tuple(a["object_centre"][m].tolist()),
            size=tuple(a["object_size"][m].tolist()),
            yaw=float(a["object_yaw"][m]),
            z_base=float(a["object_z_base"][m]),
            z_top=float(a["object_z_top"][m]),
            confidence=1.0,
            footprint=a["object_footprint"][m],
        )
        for m in range(len(a.get("object_id", ())))
    )


def _views(a: dict[str, np.ndarray]) -> tuple[ViewTruth, ...]:
    return tuple(
        ViewTruth(
            str(a["view_name"][s]),
            int(a["view_size"][s, 0]),
            int(a["view_size"][s, 1]),
            a["view_K"][s],
            a["view_T_map_cam"][s],
            a["view_label"][s],
        )
        for s in range(len(a.get("view_name", ())))
    )
