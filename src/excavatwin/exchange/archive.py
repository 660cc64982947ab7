"""The two shapes of an observations file: one ``.npz``, or a folder of one ``.npz`` per view with ``views.json``.

Here both become one list of raw records; nothing is judged yet but that they can be read and split into views.
"""

from __future__ import annotations

import json
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from excavatwin.errors import ObservationError

#: Keys with a leading axis over the views (none in the files of a folder).
PER_VIEW = ("points", "confidence", "evidence", "labels", "scores", "T_world_cam", "K", "names", "images")
#: Keys that hold once for all views.
SHARED = ("up", "metres_per_unit", "vocabulary", "class_mapping", "provenance")
#: The list of views in a folder.
VIEWS = "views.json"


@dataclass(frozen=True)
class Archive:
    """What the file says, unchecked."""

    views: list[dict[str, np.ndarray]]
    """Per view: key of ``PER_VIEW`` -> array without the leading axis."""
    shared: dict[str, Any]
    """Key of ``SHARED`` -> array or JSON value; ``provenance`` is parsed."""
    unread: tuple[str, ...] = ()
    """Keys that the file holds and the contract does not know: a misspelt one would else go unnoticed."""


def read_archive(path: Path) -> Archive:
    """Read an observations file or folder.

    Raises:
        ObservationError: there is none, it is damaged, keys are missing, or the arrays disagree on the number of views.
    """
    if path.is_dir():
        return _read_folder(path)
    if not path.exists():
        raise ObservationError(f"there is no observations file {path}; give an .npz, or a folder with {VIEWS}.")
    arrays, unread = _read_npz(path, (*PER_VIEW, *SHARED))
    _require(arrays, ("points", "confidence", "T_world_cam", "K"), path)
    if arrays["points"].ndim != 4:
        raise ObservationError(
            f"{path.name}: points has shape {arrays['points'].shape}; expected (S, H, W, 3), one point per pixel."
        )
    count = len(arrays["points"])
    for key in PER_VIEW:
        if key in arrays and (arrays[key].ndim == 0 or len(arrays[key]) != count):
            raise ObservationError(
                f"{path.name}: {key} has shape {arrays[key].shape} but points has {count} views; "
                "the first axis of both must count the views."
            )
    views = [{key: arrays[key][i] for key in PER_VIEW if key in arrays} for i in range(count)]
    shared = {key: arrays[key] for key in SHARED if key in arrays}
    if "provenance" in shared:
        shared["provenance"] = _parse(str(shared["provenance"]), path, "provenance")
    return Archive(views, shared, unread)


def _read_folder(folder: Path) -> Archive:
    index = folder / VIEWS
    if not index.is_file():
        raise ObservationError(
            f"{folder} has no {VIEWS}; a folder of observations lists its views there: "
            '{"views": [{"name": "a.jpg", "file": "a.npz"}, ...]}.'
        )
    table = _parse(index.read_text("utf-8", errors="replace"), index, "it")
    listed = table.get("views") if isinstance(table, dict) else None
    if not isinstance(listed, list):
        raise ObservationError(f"{index} has no list 'views'; give one entry with 'file' and 'name' for each view.")
    views = []
    unread = dict.fromkeys(key for key in table if key not in (*SHARED, "views"))
    for i, entry in enumerate(listed):
        file = entry.get("file") if isinstance(entry, dict) else None
        if not isinstance(file, str) or not (folder / file).is_file():
            raise ObservationError(f"{index}: view {i} names the file {file!r}, which is not in {folder}.")
        arrays, foreign = _read_npz(folder / file, PER_VIEW)
        unread.update(dict.fromkeys(foreign))
        _require(arrays, ("points", "confidence", "T_world_cam", "K"), folder / file)
        arrays["names"] = np.array(str(entry.get("name", Path(file).stem)))
        views.append(arrays)
    return Archive(views, {key: table[key] for key in SHARED if table.get(key) is not None}, tuple(unread))


def _read_npz(path: Path, keys: tuple[str, ...]) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """The arrays of ``keys`` that the file holds, and the names of what else it holds."""
    try:
        with path.open("rb") as file:  # opened here: numpy leaves a damaged file open
            archive = np.load(file, allow_pickle=False)
            if isinstance(archive, np.ndarray):
                raise ObservationError(f"{path.name} holds a single array; save an .npz with named arrays.")
            stored = list(archive.files)
            arrays = {key: archive[key] for key in keys if key in stored}
    except ObservationError:
        raise
    except ValueError as error:
        if "allow_pickle" not in str(error):
            raise ObservationError(f"{path} is not an .npz file, or it is damaged ({error}).") from None
        raise ObservationError(
            f"{path} holds Python objects, which are never unpickled; save names as a plain string array and "
            "views of different sizes as a folder."
        ) from None
    except (OSError, EOFError, KeyError, zipfile.BadZipFile) as error:
        raise ObservationError(f"{path} is not an .npz file, or it is damaged ({error}).") from None
    if "points" not in arrays:
        raise ObservationError(f"{path.name} has no 'points'; it has: {', '.join(stored) or 'nothing'}.")
    return arrays, tuple(key for key in stored if key not in keys)


def _require(arrays: dict[str, np.ndarray], keys: tuple[str, ...], path: Path) -> None:
    missing = [key for key in keys if key not in arrays]
    if not missing and not {"evidence", "labels"} & arrays.keys():
        missing = ["evidence' or 'labels"]
    if missing:
        raise ObservationError(
            f"{path.name} has no '{missing[0]}'; it has: {', '.join(arrays)}. "
            "Needed: points, confidence, T_world_cam, K, and evidence or labels."
        )


def _parse(text: str, path: Path, what: str) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise ObservationError(f"{path}: {what} is not valid JSON ({error}).") from None
