"""What is true about a recording that is no simulation: its cameras, labels, scanner heights and measured objects."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from excavatwin.datasets import task_labels
from excavatwin.evaluation.alignment import common_cameras
from excavatwin.evaluation.dimensions import MeasuredObject, camera_scale
from excavatwin.evaluation.reference import terrain_truth
from excavatwin.scene.elevation_map import MapObject
from excavatwin.scene.frames import umeyama
from excavatwin.scene.grid import Grid
from excavatwin.scene.recording import Frame, Recording
from excavatwin.scene.site import MappedView
from excavatwin.scene.taxonomy import NOT_OBSERVED
from excavatwin.scene.truth import Truth, ViewTruth

NOWHERE = Grid(0.0, 0.0, 1.0, 1, 1)
"""Grid of a truth without heights."""


def photos_of(site: Path) -> tuple[str, ...]:
    """Names of all photos that a SITE was made from, placed or not."""
    table = json.loads((site / "cameras.json").read_text("utf-8"))
    return tuple(camera["name"] for camera in table["cameras"])


def frames_by_photo(recording: Recording, photos: Iterable[str]) -> dict[str, Frame]:
    """Photo of a SITE -> frame of the recording: by file name, by its stem, or by the number of a video's frame."""
    frames = {frame.name: frame for frame in recording.frames}
    frames |= {frame.image.path.name: frame for frame in recording.frames if frame.image.path.stem != "video"}
    found = {}
    for photo in photos:
        number = re.search(r"_(\d+)$", Path(photo).stem)
        for name in (photo, Path(photo).stem, number[1] if number else None):
            if name in frames:
                found[photo] = frames[name]
                break
    return found


def recorded_truth(recording: Recording, frames: Mapping[str, Frame], policy: str | None = None) -> Truth:
    """Cameras and classes of the photos, and the scanner's heights where the recording holds them.

    Args:
        frames: by the names of the SITE's photos; the truth's views carry these names.
        policy: by which the recording's classes become task classes.

    Raises:
        InputError: the recording's vocabulary has no such policy.
    """
    nothing = np.full((1, 1), NOT_OBSERVED, np.uint8)
    views = tuple(
        _view(name, frame, task_labels(recording, frame, policy) if frame.label else nothing)
        for name, frame in frames.items()
    )
    if recording.elevation is None:
        heights = terrain_truth(NOWHERE, np.full(NOWHERE.shape, np.nan, np.float32), recording.georeference)
    else:
        reference = recording.elevation()
        heights = terrain_truth(reference.grid, reference.height, recording.georeference)
    return replace(heights, views=views)


def _view(name: str, frame: Frame, label: UInt8[np.ndarray, "H W"]) -> ViewTruth:
    width, height = frame.size or label.shape[::-1]
    nowhere = np.full((4, 4), np.nan)
    K = np.eye(3) if frame.K_cam is None else frame.K_cam
    return ViewTruth(name, width, height, K, nowhere if frame.T_W_cam is None else frame.T_W_cam, label)


def measured_objects(
    recording: Recording, views: Sequence[MappedView], truth: Truth, objects: Sequence[MapObject], sequence: str
) -> tuple[list[MeasuredObject], float]:
    """Objects of the map that are objects of the recording, with their sizes, and the scale of the cameras (P1).

    The similarity between the cameras carries the map's boxes into the recording's world; each known object takes the
    nearest box whose centre lies within its longest edge. Sizes are compared as longer, shorter horizontal edge and
    height, in the units of the map.

    Raises:
        InputError: fewer than three photos are in both.
    """
    pairs = common_cameras(views, truth)
    ours = np.array([a for a, _ in pairs], float).reshape(-1, 3)
    theirs = np.array([b for _, b in pairs], float).reshape(-1, 3)
    scale = camera_scale(ours, theirs)
    s, R, t = umeyama(ours, theirs, np.ones(len(ours)))
    centres = s * np.array([o.centre for o in objects], float).reshape(-1, 3) @ R.T + t
    found, free = [], set(range(len(objects)))
    for known in recording.objects:
        if known.T_W_object is None or not free:
            continue
        apart = {i: float(np.linalg.norm(centres[i] - known.T_W_object[:3, 3])) for i in free}
        nearest = min(apart, key=apart.__getitem__)
        if apart[nearest] <= max(known.size):
            free.discard(nearest)
            x, y, height = known.size
            true = (max(x, y), min(x, y), height)
            found.append(MeasuredObject(sequence, known.category, objects[nearest].size, true, recording.name))
    return found, scale
