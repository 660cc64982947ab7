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
            found += [place for place in level if _allowed(is_root, place)]
            level = [sub for place in level if place not in found for sub in subfolders(place)]
    return tuple(dict.fromkeys(found))


def subfolders(folder: Path) -> list[Path]:
    """Visible folders in a folder, sorted; none when it is no folder, or one that may not be read."""
    return sorted(sub for sub in _visible(folder) if _allowed(Path.is_dir, sub))


def files_in(folders: Iterable[Path], *suffixes: str) -> list[Path]:
    """Visible files of those suffixes in the folders that exist, sorted by name; the first of a name wins."""
    found: dict[str, Path] = {}
    for folder in folders:
        for file in _visible(folder):
            if file.suffix.lower() in suffixes and _allowed(Path.is_file, file):
                found.setdefault(file.name, file)
    return [found[name] for name in sorted(found)]


def first_file(places: Iterable[Path]) -> Path | None:
    """The first of the places that is a file."""
    return next((place for place in places if place.is_file()), None)


def _visible(folder: Path) -> list[Path]:
    try:
        return [entry for entry in folder.iterdir() if not entry.name.startswith(".")]
    except OSError:
        return []


def _allowed(question: Callable[[Path], bool], path: Path) -> bool:
    """The answer to a question about a path; no where nobody may look."""
    try:
        return question(path)
    except OSError:
        return False
