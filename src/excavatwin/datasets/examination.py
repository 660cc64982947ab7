"""Look into the files of a data set: do they decode, do sizes fit, are ids known? A sample, or all on demand."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from excavatwin.datasets.task_labels import task_labels
from excavatwin.errors import InputError
from excavatwin.scene.progress import Progress, silent
from excavatwin.scene.recording import Dataset, Frame, Recording

#: Recordings, and frames and scans of each, that are read when not all are.
RECORDINGS, ITEMS = 12, 3

Item = TypeVar("Item")


@dataclass(frozen=True)
class Examination:
    """What reading a data set's files brought up."""

    recordings: int
    """Recordings that were read."""
    files: int
    """Arrays that were read."""
    problems: tuple[str, ...]
    """Files that cannot be used, one sentence each."""
    doubts: tuple[str, ...]
    """What the recordings themselves want said."""


def examine(dataset: Dataset, everything: bool = False, progress: Progress = silent) -> Examination:
    """Read a sample of the files of a data set, or all of them.

    Args:
        everything: read every array of every recording.
        progress: told about ``"read recordings"``.
    """
    names = dataset.names if everything else spread(dataset.names, RECORDINGS)
    files = 0
    problems: list[str] = []
    doubts: list[str] = []
    for done, name in enumerate(names):
        progress("read recordings", done, len(names))
        try:
            recording = dataset.recording(name)
        except InputError as error:
            problems.append(str(error))
            continue
        doubts += recording.doubts
        for problem in _looked_into(recording, everything):
            files += 1
            problems += [problem] if problem else []
    progress("read recordings", len(names), len(names))
    return Examination(len(names), files, tuple(problems), tuple(doubts))


def spread(items: Sequence[Item], most: int) -> tuple[Item, ...]:
    """At most ``most`` items, evenly from first to last."""
    if len(items) <= most:
        return tuple(items)
    return tuple(items[i] for i in np.linspace(0, len(items) - 1, most).round().astype(int))


def _looked_into(recording: Recording, everything: bool) -> Iterator[str]:
    """One text for every array that was read: what is wrong with it, or nothing."""
    for frame in recording.frames if everything else spread(recording.frames, ITEMS):
        yield from _frame(recording, frame)
    for scan in recording.scans if everything else spread(recording.scans, ITEMS):
        try:
            empty = not len(scan.cloud().xyz)
        except InputError as error:
            yield str(error)
        else:
            yield f"{scan.cloud.path} holds no return." if empty else ""
    if recording.elevation:
        try:
            known = bool(np.isfinite(recording.elevation().height).any())
        except InputError as error:
            yield str(error)
        else:
            yield "" if known else f"{recording.elevation.path} holds no height."


def _frame(recording: Recording, frame: Frame) -> Iterator[str]:
    shapes: dict[str, tuple[int, ...]] = {}
    readers = {
        "photo": frame.image,
        "labels": (lambda: task_labels(recording, frame)) if frame.label and recording.vocabulary else None,
        "instances": frame.instance,
        "depth": frame.depth,
    }
    for part, read in readers.items():
        if read is None:
            continue
        try:
            shapes[part] = read().shape[:2]
        except InputError as error:
            yield str(error)
        else:
            fits = shapes[part] == shapes.get("photo", shapes[part])
            yield (
                ""
                if fits
                else (
                    f"{recording.name}/{frame.name}: {part} are {shapes[part][1]} x {shapes[part][0]}, "
                    f"its photo is {shapes['photo'][1]} x {shapes['photo'][0]}."
                )
            )
    if frame.size and shapes.get("photo", frame.size[::-1]) != frame.size[::-1]:
        seen = f"{shapes['photo'][1]} x {shapes['photo'][0]}"
        yield f"{recording.name}/{frame.name} is {seen}, but is said to be {frame.size[0]} x {frame.size[1]}."
