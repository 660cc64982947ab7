"""The stage cache of one SITE: entries appear whole or not at all, and a broken one is computed again."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

from excavatwin.errors import InputError, OutputError
from excavatwin.scene.staging import refusal

T = TypeVar("T")
_PART = ".part"
_KEEP = 2


def cache_folder(site: Path) -> Path:
    """The hidden sibling folder that holds the cache of a SITE folder."""
    site = Path(os.path.abspath(site))
    return site.parent / f".{site.name}.cache"


class StageCache:
    """Results of finished stages on disk: ``root/stage/key/`` holds what one stage left behind.

    An entry is written under a temporary name and renamed when it is complete, so a stopped run leaves no half
    entry. The two entries of a stage that were used last are kept: going back to the previous parameter is free.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self.notes: list[str] = []
        """One sentence for each entry that had to be thrown away."""
        self.hits: list[str] = []
        """Stages that were answered from the cache."""

    def path(self, stage: str, key: str) -> Path:
        """Where the entry lies, or would lie."""
        return self.root / stage / key

    def load(self, stage: str, key: str, read: Callable[[Path], T]) -> T | None:
        """The cached result, or None when there is none or it cannot be read back (then ``notes`` says so)."""
        entry = self.path(stage, key)
        if not entry.exists():
            return None
        try:
            result = read(entry)
        except Exception as error:  # whatever a broken file raises: the entry is worthless, the run is not
            self.notes.append(
                f"the cached result of stage '{stage}' could not be read back ({type(error).__name__}) "
                "and was computed again."
            )
            _remove(entry)
            return None
        with contextlib.suppress(OSError):
            os.utime(entry)  # used last
        self.hits.append(stage)
        return result

    def store(self, stage: str, key: str, write: Callable[[Path], object], *, keep: int | None = _KEEP) -> Path:
        """Let ``write`` fill a fresh folder and make it the entry; older entries of the stage beyond ``keep`` go.

        Raises:
            OutputError: the cache cannot be written; nothing half-written is left behind.
        """
        entry = self.path(stage, key)
        part = entry.with_name(f"{entry.name}{_PART}")
        try:
            with refused(self.root):
                _remove(part)
                part.mkdir(parents=True)
                write(part)
                _remove(entry)
                part.rename(entry)
        except BaseException:
            _remove(part)
            raise
        if keep is not None:
            self.prune(stage, keep)
        return entry

    def clear(self) -> None:
        """Forget everything."""
        for child in self.root.iterdir() if self.root.exists() else ():
            if child.is_dir():
                _remove(child)

    def sweep(self) -> None:
        """Remove what killed runs left half-written."""
        for part in self.root.rglob(f"*{_PART}"):
            _remove(part)

    def prune(self, stage: str, keep: int = _KEEP) -> None:
        """Keep the entries of a stage that were used last."""
        folder = self.root / stage
        entries = sorted(folder.iterdir(), key=lambda e: e.stat().st_mtime) if folder.exists() else []
        for entry in entries[: max(len(entries) - keep, 0)]:
            _remove(entry)


@contextlib.contextmanager
def opened(root: Path) -> Iterator[StageCache]:
    """The cache at ``root``, created when missing, for this process alone.

    Raises:
        OutputError: the folder cannot be created or written.
        InputError: another run is working with the same cache.
    """
    with refused(root):
        root.mkdir(parents=True, exist_ok=True)
        lock = (root / "lock").open("w")
    with lock:
        if os.name == "posix":
            import fcntl

            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                if error.errno not in (errno.EAGAIN, errno.EACCES):
                    raise  # pragma: no cover - a file system without locks
                raise InputError(
                    f"another run is working on {root.name.removeprefix('.').removesuffix('.cache')} right now; "
                    "wait for it, or choose another -o."
                ) from None
        cache = StageCache(root)
        cache.sweep()
        try:
            yield cache
        finally:
            if not any(path.is_file() for path in root.glob("*/**/*")):  # nothing came of it
                _remove(root)


@contextlib.contextmanager
def refused(target: Path) -> Iterator[None]:
    """Turn the refusal of a file system into one sentence.

    Raises:
        OutputError: full disk, read-only or missing permission.
    """
    try:
        yield
    except OutputError:
        raise
    except OSError as error:
        why = refusal(error, "another -o")
        raise OutputError(f"{target.parent} cannot be written: {why}; the same command resumes.") from error


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
