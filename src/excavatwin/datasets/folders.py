"""Finding the parts of a data set: its archives are often unpacked side by side, one folder deeper than expected."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path


def roots_below(folders: Sequence[Path], is_root: Callable[[Path], bool], depth: int = 2) -> tuple[Path, ...]:
    """Folders that satisfy ``is_root``, at most ``depth`` levels below the given ones; nothing inside a root."""
    found: list[Path] = []
    for folder in folders:
        level = [folder]
        for _ in range(depth + 1):
            found += [place for place in level if is_root(place)]
            level = [sub for place in level if place not in found for sub in subfolders(place)]
    return tuple(dict.fromkeys(found))


def subfolders(folder: Path) -> list[Path]:
    """Visible folders in a folder, sorted; none when it is no folder."""
    if not folder.is_dir():
        return []
    return sorted(sub for sub in folder.iterdir() if sub.is_dir() and not sub.name.startswith("."))


def files_in(folders: Iterable[Path], *suffixes: str) -> list[Path]:
    """Visible files of those suffixes in the folders that exist, sorted by name; the first of a name wins."""
    found: dict[str, Path] = {}
    for folder in folders:
        if folder.is_dir():
            for file in folder.iterdir():
                if file.suffix.lower() in suffixes and not file.name.startswith(".") and file.is_file():
                    found.setdefault(file.name, file)
    return [found[name] for name in sorted(found)]


def first_file(places: Iterable[Path]) -> Path | None:
    """The first of the places that is a file."""
    return next((place for place in places if place.is_file()), None)
