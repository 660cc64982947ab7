"""JSON of other programs: read, or refused in one sentence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from excavatwin.errors import InputError


def read_json(path: Path) -> Any:
    """Content of a JSON file.

    Raises:
        InputError: it is missing or damaged.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}); give the whole folder.") from error
    except ValueError as error:
        raise InputError(f"{path} is damaged: it is no JSON ({error}); write it again.") from error


def number(record: dict[str, Any], key: str, where: str, default: float | None = None) -> float:
    """A number of a record.

    Raises:
        InputError: it is missing without a default, or no number.
    """
    value = record.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{where} has no number {key!r} (found {value!r}).")
    return float(value)
