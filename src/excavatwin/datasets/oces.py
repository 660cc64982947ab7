"""OCES-like data sets in our own layout (docs/oces-layout.md): sequences of epochs with truth for everything.

Each epoch is one recording, ``"<sequence>/epoch_00"``.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from excavatwin.datasets.folders import roots_below
from excavatwin.datasets.readers import (
    read_depth_metres,
    read_elevation,
    read_ids,
    read_json,
    read_laz,
    read_rgb,
    read_wide_ids,
)
from excavatwin.errors import InputError
from excavatwin.scene.observations import Georeference
from excavatwin.scene.recording import Dataset, Excluded, Frame, KnownObject, Recording, Scan, Stored, VolumeChange
from excavatwin.scene.taxonomy import TERRAIN_CLASSES, TaskClass, parse_class

FORMAT, VERSION = "excavatwin-oces", 1
#: Terrain seen through a camera may lie so far from the elevation reference [m], and pixels that must tell.
APART, ENOUGH = 0.3, 20
#: Files that an epoch is not itself without.
ESSENTIAL = ("cameras.json", "truth.npz", "objects.json")


def is_root(folder: Path) -> bool:
    """Whether a folder holds a ``dataset.json`` of this layout."""
    try:
        return f'"{FORMAT}"' in (folder / "dataset.json").read_text("utf-8", "replace")
    except OSError:
        return False


def find_roots(folders: Sequence[Path]) -> tuple[Path, ...]:
    """Roots below the folders."""
    return roots_below(folders, is_root)


def open_oces(folders: Sequence[Path]) -> Dataset:
    """One OCES-like data set.

    Raises:
        InputError: there is none, several, or one of a newer version; or it lacks all of its sequences.
    """
    roots = find_roots(folders)
    if len(roots) != 1:
        found = "no" if not roots else f"{len(roots)}"
        raise InputError(f"{folders[0]} holds {found} dataset.json of format {FORMAT!r}; give the folder of one.")
    root, about = roots[0], read_json(roots[0] / "dataset.json")
    if _get(about, "version", root / "dataset.json") != VERSION:
        raise InputError(f"{root} is of version {about['version']}; this reader knows version {VERSION}.")
    excluded: list[Excluded] = []
    epochs: dict[str, tuple[Path, dict[str, Any]]] = {}
    changes: list[VolumeChange] = []
    for sequence in _get(about, "sequences", root / "dataset.json"):
        place = root / sequence
        if not (place / "sequence.json").is_file():
            excluded.append(Excluded(sequence, "has no sequence.json: it was not finished or not copied"))
            continue
        told = read_json(place / "sequence.json")
        for epoch in _get(told, "epochs", place / "sequence.json"):
            lacking = [name for name in ESSENTIAL if not (place / epoch / name).is_file()]
            if lacking:
                excluded.append(Excluded(f"{sequence}/{epoch}", f"lacks {', '.join(lacking)}"))
                continue
            epochs[f"{sequence}/{epoch}"] = (place / epoch, told)
        changes += _changes(sequence, place / "change.json")
    if not epochs:
        raise InputError(f"{root} holds none of the epochs that its dataset.json names; copy the whole folder.")
    cameras = {name: read_json(place / "cameras.json") for name, (place, _) in epochs.items()}
    names = tuple(epochs)

    def opened(name: str) -> Recording:
        return _recording(name, *epochs[name], cameras[name])

    return Dataset(
        name="oces",
        folders=(root,),
        names=names,
        open=opened,
        counts={
            "sequences": len({name.split("/")[0] for name in epochs}),
            "epochs": len(epochs),
            "frames": sum(len(_get(c, "frames", epochs[name][0] / "cameras.json")) for name, c in cameras.items()),
            "changes": len(changes),
        },
        categories=tuple(about.get("categories", ())),
        changes=tuple(changes),
        vocabulary="task",
        excluded=tuple(excluded),
        checks=(_all_there(epochs, cameras), *_geometry_fits(opened(names[0]))),
    )


def _recording(name: str, place: Path, told: dict[str, Any], cameras: dict[str, Any]) -> Recording:
    georeference = _georeference(told)
    origin = georeference.origin if georeference else (0.0, 0.0, 0.0)
    elevation, lidar = place / "elevation.tif", place / "lidar.laz"
    return Recording(
        name,
        frames=tuple(_frame(place, entry) for entry in cameras["frames"]),
        scans=(Scan("lidar", Stored(lidar, partial(read_laz, origin=origin)), labelled=True),)
        if lidar.is_file()
        else (),
        vocabulary="task",
        photos=place / "images",
        objects=tuple(_object(entry, place / "objects.json") for entry in read_json(place / "objects.json")),
        elevation=Stored(elevation, partial(read_elevation, origin=origin)) if elevation.is_file() else None,
        truth=place / "truth.npz",
        georeference=georeference,
        platform=told.get("flight"),
        time=_time(told, place),
    )


def _time(told: dict[str, Any], place: Path) -> float | None:
    """When an epoch was recorded, from the ISO 8601 times of its sequence [s]."""
    by_epoch = dict(zip(told.get("epochs", ()), told.get("times", ()), strict=False))
    if place.name not in by_epoch:
        return None
    try:
        moment = datetime.fromisoformat(str(by_epoch[place.name]))
    except ValueError:
        raise InputError(
            f"{place.parent / 'sequence.json'} holds the time {by_epoch[place.name]!r}; expected ISO 8601."
        ) from None
    return moment.replace(tzinfo=moment.tzinfo or UTC).timestamp()


def _frame(place: Path, entry: dict[str, Any]) -> Frame:
    where = place / "cameras.json"
    name = str(_get(entry, "name", where))
    stem = Path(name).stem
    label, instance, depth = (
        place / "labels" / f"{stem}.png",
        place / "instances" / f"{stem}.png",
        place / "depth" / f"{stem}.tif",
    )
    return Frame(
        name=name,
        image=Stored(place / "images" / name, read_rgb),
        time=entry.get("time_s"),
        size=(int(_get(entry, "width", where)), int(_get(entry, "height", where))),
        K_cam=_matrix(entry, "K", 3, where),
        T_W_cam=_matrix(entry, "T_map_cam", 4, where),
        label=Stored(label, read_ids) if label.is_file() else None,
        instance=Stored(instance, read_wide_ids) if instance.is_file() else None,
        depth=Stored(depth, read_depth_metres) if depth.is_file() else None,
    )


def _object(entry: dict[str, Any], where: Path) -> KnownObject:
    length, width, height = (float(v) for v in _get(entry, "size", where))
    yaw = np.deg2rad(float(_get(entry, "yaw", where)))
    T_W_object = np.eye(4)
    T_W_object[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    T_W_object[:3, 3] = _get(entry, "centre", where)
    told = _get(entry, "task_class", where)
    return KnownObject(
        object_id=int(_get(entry, "object_id", where)),
        category=str(_get(entry, "category", where)),
        size=(length, width, height),
        T_W_object=T_W_object,
        task_class=parse_class(told) if isinstance(told, str) else TaskClass(int(told)),
        name=str(entry.get("name", "")),
        z_base=float(_get(entry, "z_base", where)),
        z_top=float(_get(entry, "z_top", where)),
    )


def _changes(sequence: str, file: Path) -> list[VolumeChange]:
    if not file.is_file():
        return []
    return [
        VolumeChange(
            f"{sequence}/{_get(entry, 'from', file)}",
            f"{sequence}/{_get(entry, 'to', file)}",
            *(float(_get(entry, key, file)) for key in ("cut_m3", "fill_m3", "net_m3")),
        )
        for entry in read_json(file)
    ]


def _georeference(told: dict[str, Any]) -> Georeference | None:
    epsg, origin = told.get("epsg"), told.get("origin")
    if not epsg or origin is None:
        return None
    return Georeference(int(epsg), (float(origin[0]), float(origin[1]), float(origin[2])), 0.0)


def _all_there(epochs: dict[str, tuple[Path, dict[str, Any]]], cameras: dict[str, Any]) -> str:
    """Whether every photo is there with its truth."""
    parts = {"images": "{name}", "labels": "{stem}.png", "instances": "{stem}.png", "depth": "{stem}.tif"}
    absent = {
        part: sum(
            not (place / part / form.format(name=entry["name"], stem=Path(entry["name"]).stem)).is_file()
            for name, (place, _) in epochs.items()
            for entry in cameras[name]["frames"]
        )
        for part, form in parts.items()
    }
    told = ", ".join(f"{count} of {part}" for part, count in absent.items() if count)
    return f"files that cameras.json names but are not there: {told}." if told else "every photo has its truth."


def _geometry_fits(recording: Recording) -> tuple[str, ...]:
    """Whether depth, camera and elevation reference of one epoch tell of the same terrain.

    Raises:
        InputError: terrain seen through a camera is not where the reference has it.
    """
    frame = recording.frames[len(recording.frames) // 2] if recording.frames else None
    if frame is None or not frame.label or not frame.depth or not recording.elevation:
        return ()
    seen = frame.world_points()[np.isin(frame.label(), TERRAIN_CLASSES)]
    reference = recording.elevation()
    index = reference.grid.flat_index(seen[:, :2])
    miss = np.abs(seen[index >= 0, 2] - reference.height.ravel()[index[index >= 0]])
    miss = miss[np.isfinite(miss)]
    median = float(np.median(miss)) if len(miss) >= ENOUGH else float("inf")
    if not median <= APART:
        found = f"a median of {median:.2f} m away from" if len(miss) >= ENOUGH else "nowhere near"
        raise InputError(
            f"{recording.name}: terrain seen in {frame.name} lies {found} elevation.tif; cameras (camera-to-map), "
            "depth and reference are of different frames or epochs."
        )
    return (f"{recording.name}: terrain seen in {frame.name} lies {100 * median:.1f} cm from elevation.tif (median).",)


def _matrix(entry: dict[str, Any], key: str, n: int, where: Path) -> Float64[np.ndarray, "n n"]:
    M = np.array(_get(entry, key, where), float)
    if M.shape != (n, n):
        raise InputError(f"{where}: {key} of {entry.get('name')} is {M.shape}; expected {n} x {n}.")
    return M


def _get(table: Any, key: str, where: Path) -> Any:
    if not isinstance(table, dict) or key not in table:
        raise InputError(f"{where} lacks {key!r}; see docs/oces-layout.md.")
    return table[key]
