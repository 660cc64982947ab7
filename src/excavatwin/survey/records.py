"""How stage results lie in the cache: photos as JSON, observations as one ``.npz`` a view, long ones memory-mapped."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from excavatwin.backbones.protocols import Segmentation
from excavatwin.capture import Capture
from excavatwin.scene.observations import Georeference, Lattice, Observations, Unplaced, View
from excavatwin.scene.photo import Gimbal, GpsFix, Photo
from excavatwin.scene.taxonomy import K

#: Layers of long sequences that stay on disk: one file each, since every mapped file keeps a descriptor open.
_LAYERS: dict[str, Any] = {"points": np.float32, "confidence": np.float32, "image": np.uint8}


def write_capture(found: Capture, folder: Path) -> None:
    """``capture.json``; a photo inside ``folder`` is written relative to it (the folder is renamed later)."""
    rows = []
    for photo in found.photos:
        inside = photo.path.is_relative_to(folder)
        rows.append(asdict(photo) | {"path": str(photo.path.relative_to(folder) if inside else photo.path.resolve())})
    content = {"photos": rows, "skipped": [asdict(one) for one in found.skipped]}
    (folder / "capture.json").write_text(json.dumps(content))


def read_capture(folder: Path) -> Capture:
    """What ``write_capture`` wrote; fails when a photo is not there any more."""
    content = json.loads((folder / "capture.json").read_text())
    photos = []
    for row in content["photos"]:
        row["path"] = (folder / row["path"]).resolve(strict=True)
        row["gps"] = GpsFix(**row["gps"]) if row["gps"] else None
        row["gimbal"] = Gimbal(**row["gimbal"]) if row["gimbal"] else None
        photos.append(Photo(**row))
    return Capture(tuple(photos), tuple(Unplaced(**one) for one in content["skipped"]))


def write_observations(obs: Observations, folder: Path) -> None:
    """``observations.json`` and ``0000.npz``, ... Evidence that is all zero (before segmentation) costs nothing."""
    meta: dict[str, Any] = {
        "names": [view.name for view in obs.views],
        "up": None if obs.up is None else np.asarray(obs.up, float).tolist(),
        "metres_per_unit": obs.metres_per_unit,
        "georeference": asdict(obs.georeference) if obs.georeference else None,
        "unplaced": [asdict(one) for one in obs.unplaced],
        "doubts": list(obs.doubts),
        "source": dict(obs.source),
    }
    mapped: dict[str, list[list[int]]] = {name: [] for name in _LAYERS}
    for index, view in enumerate(obs.views):
        arrays: dict[str, Any] = {}
        for name in _LAYERS:
            layer = getattr(view, name)
            if isinstance(layer, np.memmap):
                with (folder / f"{name}.bin").open("ab") as file:
                    file.write(np.ascontiguousarray(layer, _LAYERS[name]).data)
            elif layer is not None:
                arrays[name] = layer
            mapped[name].append(list(layer.shape) if isinstance(layer, np.memmap) else [])
        arrays |= {"T_R_cam": view.T_R_cam, "K_cam": view.K_cam}
        if view.evidence.any():
            arrays["evidence"] = view.evidence
        if view.lattice is not None:
            lattice = view.lattice
            arrays |= {"affine": lattice.affine, "K_photo": lattice.K_photo}
            arrays |= {"distortion": np.array(lattice.distortion), "size": np.array([lattice.width, lattice.height])}
        np.savez(folder / f"{index:04d}.npz", **arrays)
    (folder / "observations.json").write_text(json.dumps(meta | {"mapped": mapped}))


def read_observations(folder: Path) -> Observations:
    """What ``write_observations`` wrote, bit by bit."""
    meta = json.loads((folder / "observations.json").read_text())
    georeference = meta["georeference"]
    if georeference:
        georeference = Georeference(**georeference | {"origin": tuple(georeference["origin"])})
    layers = {name: _mapped(folder / f"{name}.bin", dtype, meta["mapped"][name]) for name, dtype in _LAYERS.items()}
    views = []
    for index, name in enumerate(meta["names"]):
        on_disk = {key: parts[index] for key, parts in layers.items() if parts[index] is not None}
        views.append(_read_view(folder / f"{index:04d}.npz", name, on_disk))
    return Observations(
        views=tuple(views),
        up=None if meta["up"] is None else np.array(meta["up"]),
        metres_per_unit=meta["metres_per_unit"],
        georeference=georeference,
        unplaced=tuple(Unplaced(**one) for one in meta["unplaced"]),
        doubts=tuple(meta["doubts"]),
        source=meta["source"],
    )


def _mapped(path: Path, dtype: Any, shapes: list[list[int]]) -> list[np.ndarray | None]:
    """The parts of a file that belong to each view; None for views that keep this layer elsewhere."""
    if not any(shapes):
        return [None] * len(shapes)
    whole = np.memmap(path, dtype, "r")
    parts: list[np.ndarray | None] = []
    start = 0
    for shape in shapes:
        stop = start + math.prod(shape) if shape else start
        parts.append(whole[start:stop].reshape(shape) if shape else None)
        start = stop
    if start != len(whole):
        raise ValueError(f"{path.name} holds {len(whole)} values where {start} were written")
    return parts


def _read_view(path: Path, name: str, mapped: Mapping[str, Any]) -> View:
    with path.open("rb") as raw, np.load(raw) as file:  # numpy leaks the handle of a broken archive
        a = {key: file[key] for key in file.files} | dict(mapped)
    lattice = None
    if "affine" in a:
        k1, k2, p1, p2 = (float(value) for value in a["distortion"])
        width, height = (int(value) for value in a["size"])
        lattice = Lattice(width, height, a["affine"], a["K_photo"], (k1, k2, p1, p2))
    shape = a["points"].shape[:2]
    return View(
        name=name,
        points=a["points"],
        confidence=a["confidence"],
        evidence=a["evidence"] if "evidence" in a else np.zeros((*shape, K), np.float32),
        T_R_cam=a["T_R_cam"],
        K_cam=a["K_cam"],
        image=a.get("image"),
        lattice=lattice,
    )


def write_segmentation(seen: Segmentation, folder: Path) -> None:
    """One photo's semantic evidence and the pixels that show no surface at all."""
    np.savez(folder / "segmentation.npz", evidence=seen.evidence, no_surface=np.packbits(seen.no_surface))
    (folder / "doubts.json").write_text(json.dumps(seen.doubts))


def read_segmentation(folder: Path) -> Segmentation:
    """What ``write_segmentation`` wrote."""
    with (folder / "segmentation.npz").open("rb") as raw, np.load(raw) as file:
        evidence, packed = file["evidence"], file["no_surface"]
    bits = np.unpackbits(packed, count=evidence.shape[0] * evidence.shape[1])
    doubts = json.loads((folder / "doubts.json").read_text())
    return Segmentation(evidence, bits.reshape(evidence.shape[:2]).astype(bool), tuple(doubts))
