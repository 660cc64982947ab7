"""Fingerprints: what makes a cached result valid. Equal fingerprints, equal results."""

from __future__ import annotations

import enum
import hashlib
import importlib.util
import json
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from excavatwin.errors import InputError
from excavatwin.scene.progress import Progress, silent

_CHUNK = 1 << 22


def plain(value: Any) -> Any:
    """A stage, or any value inside it, as JSON types; a dataclass names its class, so that twins differ.

    Raises:
        TypeError: a parameter is of a kind that has no canonical text.
    """
    if is_dataclass(value) and not isinstance(value, type):
        return {"stage": type(value).__qualname__} | {f.name: plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, enum.Enum):
        return value.name.lower()
    if isinstance(value, dict) or hasattr(value, "items"):
        return {str(plain(k)): plain(v) for k, v in value.items()}
    if isinstance(value, tuple | list | frozenset | set):
        items = [plain(item) for item in value]
        return sorted(items, key=repr) if isinstance(value, frozenset | set) else items
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    if value is None or isinstance(value, str | bool | int | float):
        return value
    raise TypeError(f"a parameter of type {type(value).__name__} has no canonical text")


def key(*parts: Any) -> str:
    """20 hex digits that depend on every part."""
    text = json.dumps([plain(part) for part in parts], sort_keys=True, separators=(",", ":"))
    return hashlib.blake2b(text.encode(), digest_size=10).hexdigest()


def of_files(paths: Sequence[Path], progress: Progress = silent) -> dict[str, str]:
    """Name -> digest of the content of each file.

    Raises:
        InputError: a file cannot be read.
    """
    digests: dict[str, str] = {}
    for done, path in enumerate(paths):
        progress("read", done, len(paths))
        digest = hashlib.blake2b(digest_size=16)
        try:
            with path.open("rb") as file:
                while chunk := file.read(_CHUNK):
                    digest.update(chunk)
        except OSError as error:
            raise InputError(f"{path} cannot be read ({error.strerror}); check the file and its permissions.") from None
        digests[path.name] = digest.hexdigest()
    progress("read", len(paths), len(paths))
    return digests


def of_array(array: np.ndarray) -> str:
    """Digest of an array's shape, type and bytes."""
    digest = hashlib.blake2b(f"{array.shape}{array.dtype}".encode(), digest_size=16)
    digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def of_code(*modules: str) -> str:
    """Digest of the source in the folders of modules: a changed algorithm must not answer from an old cache.

    The version alone would do for releases; this holds for everyone who works on the code as well. Of a module that
    is no part of a package only its own file counts.
    """
    digest = hashlib.blake2b(digest_size=10)
    for module in modules:
        try:
            spec = importlib.util.find_spec(module)
        except ValueError:  # a class of the script that runs
            spec = None
        if spec is None or spec.origin is None:
            continue  # a stage given from outside the package; its parameters still count
        origin = Path(spec.origin)
        alone = "." not in module and origin.name != "__init__.py"  # beside it lie all that is installed
        for path in [origin] if alone else sorted(origin.parent.rglob("*.py")):
            digest.update(path.name.encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()
