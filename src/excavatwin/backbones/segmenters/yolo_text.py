"""Outlines as YOLO text: one file per photo, one line per instance, ``class x y x y ... [confidence]`` as shares."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from excavatwin.backbones.segmenters.labelled import Instance, Labelled, of_instances, polygon_area, polygon_mask
from excavatwin.errors import InputError


@dataclass(frozen=True)
class YoloText:
    """Text files of a folder."""

    files: dict[str, Path]
    """Photo's stem (case-folded) -> file."""
    names: tuple[str, ...]
    """Classes in the order of their numbers."""
    offset: int = 0
    """Added to the class numbers."""

    def of(self, photo: str, size: tuple[int, int]) -> Labelled | None:
        """Labels of a photo.

        Raises:
            InputError: a line is no outline; the message names file and line.
        """
        path = self.files.get(Path(photo).stem.casefold())
        if path is None:
            return None
        lines = path.read_text("utf-8").splitlines()
        found = [self._instance(line, f"{path}, line {n}", size) for n, line in enumerate(lines, 1) if line.strip()]
        return of_instances(found, size)

    def _instance(self, line: str, where: str, size: tuple[int, int]) -> Instance:
        try:
            values = [float(word) for word in line.split()]
        except ValueError:
            raise InputError(f"{where}: {line!r} is not numbers; expected: class x y x y ... .") from None
        if len(values) in (5, 6):
            raise InputError(f"{where} has {len(values)} numbers: a box, no outline; export segments instead of boxes.")
        score = values.pop() if len(values) % 2 == 0 else 1.0
        place = int(values[0]) + self.offset
        if values[0] != int(values[0]) or not 0 <= place < len(self.names):
            hint = "; its classes seem to count from 1: give --masks.offset -1" if place == len(self.names) else ""
            raise InputError(
                f"{where} has the class {values[0]:g}, but there are {len(self.names)} (0 to "
                f"{len(self.names) - 1}){hint}."
            )
        corners = np.array(values[1:]).reshape(-1, 2)
        if len(corners) < 3 or not 0 <= score <= 1:
            raise InputError(
                f"{where} has {len(corners)} corners and the score {score:g}; expected at least 3, and 0..1."
            )
        if corners.min() < -0.01 or corners.max() > 1.01:
            raise InputError(f"{where} has a coordinate of {corners.max():g}; YOLO text holds shares 0..1, not pixels.")
        corners = corners * size
        return Instance(place, score, polygon_area(corners), lambda: polygon_mask(corners, *size))


def yaml_names(text: str) -> tuple[str, ...]:
    """``names`` of a data.yaml: ``[a, b]``, ``- a`` or ``0: a``; empty when there are none."""
    match = re.search(r"^names\s*:[ \t]*(.*(?:\n(?:[ \t]+|-).*)*)", text, re.MULTILINE)
    if match is None:
        return ()
    body = match.group(1).strip()
    if body.startswith(("[", "{")):
        body = "\n".join(re.split(r",(?=(?:[^'\"]*['\"][^'\"]*['\"])*[^'\"]*$)", body.strip("[]{} \n")))
    found: dict[int, str] = {}
    for line in body.splitlines():
        line = re.sub(r"(^|\s)#.*$", "", line).strip()
        if not line:
            continue
        number, colon, name = line.removeprefix("- ").partition(":")
        place = int(number) if colon and number.strip().isdigit() else len(found)
        found[place] = (name if colon and number.strip().isdigit() else line.removeprefix("- ")).strip().strip("'\"")
    return tuple(found[place] for place in sorted(found)) if sorted(found) == list(range(len(found))) else ()
