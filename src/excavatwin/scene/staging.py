"""Whole or not at all: a file or a folder appears under its name only when its last byte is on the disk.

Knows no format. The content is written beside its target (same file system), flushed, then renamed into place.
"""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

from excavatwin.errors import OutputError


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """A binary file that takes the place of ``path`` when the block ends well; otherwise ``path`` is untouched.

    Raises:
        OutputError: full disk, read-only target, missing permission.
    """
    target = Path(os.path.realpath(path))
    with _explained(path), _parents(target):
        if target.is_dir():
            raise OutputError(f"{path} is a folder, where a file was to be written; give another name.")
        staged = _sibling(target)
        try:
            with staged.open("xb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            os.replace(staged, target)
            _sync_folder(target.parent)
        finally:
            staged.unlink(missing_ok=True)


@contextlib.contextmanager
def whole_folder(folder: Path, mark: str, stale: Callable[[str], bool]) -> Iterator[Path]:
    """An empty folder that takes the place of ``folder`` when the block ends well; otherwise all stays as it was.

    ``mark`` is the file that every folder of ours holds: an existing folder is replaced only if it has one (or is
    empty but for hidden entries). Entries of the old folder that are not ``stale`` (by name) are the user's own:
    they move into the new one.

    Raises:
        OutputError: full disk, read-only target, missing permission, or ``folder`` holds something that is not ours.
    """
    target = Path(os.path.realpath(folder))
    with _explained(folder), _parents(target):
        _refuse_foreign(target, folder, mark)
        staged = _sibling(target)
        try:
            staged.mkdir()
            yield staged
            for file in staged.rglob("*"):
                _sync_folder(file) if file.is_dir() else _sync_file(file)
            _swap(staged, target, stale)
            _sync_folder(target.parent)
        finally:
            shutil.rmtree(staged, ignore_errors=True)


def _refuse_foreign(target: Path, folder: Path, mark: str) -> None:
    if target.exists() and not target.is_dir():
        raise OutputError(f"{folder} is a file, where a folder was to be written; give another name.")
    if os.path.ismount(target):
        raise OutputError(f"{folder} is a mount point, which cannot be swapped as a whole; give a folder inside it.")
    if not target.exists() or (target / mark).is_file():
        return
    visible = [child.name for child in target.iterdir() if not child.name.startswith(".")]
    if visible:
        raise OutputError(
            f"{folder} already holds something else ({sorted(visible)[0]}, no {mark}) and will not be overwritten; "
            "give a new folder, or empty this one."
        )


def _swap(staged: Path, target: Path, stale: Callable[[str], bool]) -> None:
    """Two renames; the second is taken back with the first if it fails. The old folder goes last."""
    if not target.exists():
        staged.rename(target)
        return
    previous = _sibling(target)
    target.rename(previous)
    try:
        staged.rename(target)
    except BaseException:
        previous.rename(target)
        raise
    for child in previous.iterdir():
        if not stale(child.name) and not (target / child.name).exists():
            child.rename(target / child.name)
    shutil.rmtree(previous, ignore_errors=True)


def _sibling(target: Path) -> Path:
    """A fresh hidden name beside ``target``."""
    return target.with_name(f".{target.name}.{secrets.token_hex(4)}.part")


@contextlib.contextmanager
def _parents(target: Path) -> Iterator[None]:
    """Create the parent folders of ``target``; take them away again when the block fails."""
    missing = [p for p in target.parents if not p.exists()]
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        yield
    except BaseException:
        with contextlib.suppress(OSError):
            for parent in missing:
                parent.rmdir()
        raise


@contextlib.contextmanager
def _explained(target: Path) -> Iterator[None]:
    """Turn the refusal of a file system into one sentence."""
    try:
        yield
    except OutputError:
        raise
    except OSError as error:
        why = refusal(error, "another place")
        raise OutputError(f"{target} could not be written: {why}; what was there before is untouched.") from error


def refusal(error: OSError, elsewhere: str) -> str:
    """Why a file system refused to write, and what to do: free space, or choose ``elsewhere``."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return f"the disk is full; free some space or choose {elsewhere}"
    if error.errno in (errno.EROFS, errno.EACCES, errno.EPERM):
        return f"it is read-only for you; choose {elsewhere}"
    return f"{error.strerror or error}; choose {elsewhere}"


def _sync_file(path: Path) -> None:
    with path.open("rb") as file:
        os.fsync(file.fileno())


def _sync_folder(path: Path) -> None:
    """Make the names in a folder durable, where the system can (not on Windows)."""
    with contextlib.suppress(OSError):
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
