"""Which data set lies in a folder."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from excavatwin.datasets import goose, isprs, objectron, oces, orfd, rellis
from excavatwin.datasets.catalogue import SOURCES
from excavatwin.errors import InputError
from excavatwin.scene.recording import Dataset

#: Environment variable of the folder that holds data sets by name.
ENVIRONMENT = "EXCAVATWIN_DATASETS"


@dataclass(frozen=True)
class _Layout:
    """How one data set is found and opened."""

    find: Callable[[Sequence[Path]], tuple[Path, ...]]
    open: Callable[[Sequence[Path]], Dataset]


LAYOUTS: dict[str, _Layout] = {
    "oces": _Layout(oces.find_roots, oces.open_oces),
    "rellis-3d": _Layout(rellis.find_roots, rellis.open_rellis),
    "goose": _Layout(goose.find_roots, goose.open_goose),
    "objectron": _Layout(objectron.find_roots, objectron.open_objectron),
    "orfd": _Layout(orfd.find_roots, orfd.open_orfd),
    "isprs": _Layout(isprs.find_roots, isprs.open_isprs),
}


def open_dataset(source: str | Path | Sequence[str | Path]) -> Dataset:
    """The data set in a folder, in several folders of its parts, or of a name (below ``EXCAVATWIN_DATASETS``).

    Raises:
        InputError: no such folder, no or several known layouts in it, or a self-check of the data set fails.
    """
    folders = _folders(source)
    found = recognise(folders)
    if not found:
        known = ", ".join(source.name for source in SOURCES)
        raise InputError(
            f"{folders[0]} has the layout of no known data set ({known}); "
            "`excavatwin datasets` says how each has to lie."
        )
    if len(found) > 1:
        told = ", ".join(f"{name} in {roots[0]}" for name, roots in found.items())
        raise InputError(f"{folders[0]} holds several data sets: {told}; give the folder of one.")
    return LAYOUTS[next(iter(found))].open(folders)


def recognise(folders: Sequence[Path]) -> dict[str, tuple[Path, ...]]:
    """Data sets in the folders or at most two levels below, with their roots."""
    found = {name: layout.find(folders) for name, layout in LAYOUTS.items()}
    return {name: roots for name, roots in found.items() if roots}


def dataset_folder(name: str) -> Path | None:
    """Folder of a data set below ``EXCAVATWIN_DATASETS``; None when the variable is not set."""
    root = os.environ.get(ENVIRONMENT)
    return Path(root) / name if root else None


def _folders(source: str | Path | Sequence[str | Path]) -> list[Path]:
    given = [source] if isinstance(source, str | Path) else list(source)
    if not given:
        raise InputError("no folder of a data set is given.")
    return [_folder(part) for part in given]


def _folder(source: str | Path) -> Path:
    path = Path(source)
    if path.is_dir():
        return path
    if path.exists():
        raise InputError(f"{path} is a file; give the folder of a data set.")
    if str(source) not in {known.name for known in SOURCES}:
        raise InputError(f"{path} does not exist; give a folder, or one of: {', '.join(s.name for s in SOURCES)}.")
    place = dataset_folder(str(source))
    if place is None:
        raise InputError(
            f"data set {source} is looked for below {ENVIRONMENT}, which is not set; set it or give a folder."
        )
    if not place.is_dir():
        raise InputError(f"{place} does not exist; `excavatwin datasets` says what to download and how it has to lie.")
    return place
