"""Saving observations so that nothing is lost: loading gives back the same bits."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from excavatwin.errors import InputError
from excavatwin.exchange.archive import VIEWS
from excavatwin.exchange.provenance import write_provenance
from excavatwin.scene.observations import Observations, View
from excavatwin.scene.staging import whole_file, whole_folder

#: Key of the contract -> dtype and the array of a view. Images are written when every view (of a file) has one.
_ARRAYS: dict[str, tuple[str, Callable[[View], Any]]] = {
    "points": ("<f4", lambda view: view.points),
    "confidence": ("<f4", lambda view: view.confidence),
    "evidence": ("<f4", lambda view: view.evidence),
    "T_world_cam": ("<f8", lambda view: view.T_R_cam),
    "K": ("<f8", lambda view: view.K_cam),
    "images": ("|u1", lambda view: view.image),
}


def save_observations(observations: Observations, path: str | Path) -> None:
    """Write observations, uncompressed and lossless, whole or not at all.

    A name that ends in ``.npz`` gives one file (all views of one size, all or none with an image); any other name a
    folder of one ``.npz`` per view with ``views.json``.

    Raises:
        InputError: one file was asked for but the views differ in size, or only some have an image.
        OutputError: full disk, read-only target, or a folder that holds something else.
    """
    path = Path(path)
    if path.suffix.lower() == ".npz":
        _save_file(observations, path)
    else:
        _save_folder(observations, path)


def _save_file(observations: Observations, path: Path) -> None:
    views = observations.views
    shapes = {view.shape for view in views}
    if len(shapes) != 1 or len({view.image is None for view in views}) != 1:
        what = f"{len(shapes)} different sizes" if len(shapes) != 1 else "images for some only"
        raise InputError(
            f"the {len(views)} views have {what} and do not fit one .npz; give a folder (a name without .npz)."
        )
    shared: dict[str, np.ndarray] = {
        "names": np.array([view.name for view in views]),
        "provenance": np.array(json.dumps(write_provenance(observations))),
    }
    if observations.up is not None:
        shared["up"] = np.asarray(observations.up, np.float64)
    if observations.metres_per_unit is not None:
        shared["metres_per_unit"] = np.array(observations.metres_per_unit, np.float64)
    with whole_file(path) as file:
        _write_npz(file, views, shared, stacked=True)


def _save_folder(observations: Observations, folder: Path) -> None:
    listed = [{"name": view.name, "file": f"{i:04d}.npz"} for i, view in enumerate(observations.views)]
    table: dict[str, Any] = {"views": listed, "provenance": write_provenance(observations)}
    if observations.up is not None:
        table["up"] = [float(v) for v in observations.up]
    if observations.metres_per_unit is not None:
        table["metres_per_unit"] = float(observations.metres_per_unit)
    with whole_folder(folder, VIEWS, stale=lambda name: name.endswith(".npz") or name == VIEWS) as staged:
        for entry, view in zip(listed, observations.views, strict=True):
            with (staged / entry["file"]).open("wb") as file:
                _write_npz(file, [view], {}, stacked=False)
        (staged / VIEWS).write_text(json.dumps(table, indent=1), "utf-8")


def _write_npz(file: BinaryIO, views: Sequence[View], shared: dict[str, np.ndarray], stacked: bool) -> None:
    """An uncompressed ``.npz``, view after view: nothing is stacked in memory."""
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        for key, (dtype, of) in _ARRAYS.items():
            if of(views[0]) is None:
                continue
            shape = np.shape(of(views[0]))
            with archive.open(_entry(key), "w", force_zip64=True) as member:
                header = {"descr": dtype, "fortran_order": False, "shape": (len(views), *shape) if stacked else shape}
                np.lib.format.write_array_header_1_0(member, header)
                for view in views:
                    member.write(np.ascontiguousarray(of(view), dtype).data.cast("B"))
        for key, array in shared.items():
            with archive.open(_entry(key), "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)


def _entry(key: str) -> zipfile.ZipInfo:
    """A member with a fixed date: equal observations give equal bytes."""
    return zipfile.ZipInfo(f"{key}.npy", (1980, 1, 1, 0, 0, 0))
