"""What can be refused before anything is computed."""

from __future__ import annotations

import difflib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from excavatwin.errors import InputError
from excavatwin.scene.photo import Photo
from excavatwin.survey.cache import refused

if TYPE_CHECKING:
    from excavatwin.geometry.scale import Reference


def check_target(folder: Path) -> None:
    """Refuse a target before anything is computed for it.

    Raises:
        InputError: the folder exists and is not an earlier SITE.
        OutputError: nothing can be created there.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file; -o names the folder that will hold the results.")
    foreign = [child.name for child in folder.iterdir() if not child.name.startswith(".")] if folder.is_dir() else []
    if foreign and not (folder / "run.json").exists():
        raise InputError(
            f"{folder} holds other files ({min(foreign)}) and no earlier map; choose an empty or a new folder for -o."
        )
    target = folder.absolute()
    existing = next(parent for parent in target.parents if parent.exists())
    with refused(target):
        probe = existing / f".{folder.name}.{os.getpid()}.probe"
        probe.touch()
        probe.unlink()


def check_references(references: Sequence[Reference], photos: Sequence[Photo]) -> None:
    """Refuse a reference length that lies in no photo before anything is computed with it.

    Raises:
        InputError: the photo is not among those found, or a pixel lies outside it.
    """
    by_name = {photo.name: photo for photo in photos}
    for reference in references:
        photo = by_name.get(reference.view)
        if photo is None:
            near = difflib.get_close_matches(reference.view, by_name, 1, 0.3)
            raise InputError(
                f"the reference length names the photo {reference.view!r}, which is not among the {len(photos)} photos"
                f"{f'; did you mean {near[0]!r}?' if near else '.'}"
            )
        for x, y in (reference.a, reference.b):
            if not (0 <= x <= photo.width and 0 <= y <= photo.height):
                raise InputError(
                    f"pixel {x:g},{y:g} of the reference length lies outside {photo.name} "
                    f"({photo.width} x {photo.height} px as displayed)."
                )
