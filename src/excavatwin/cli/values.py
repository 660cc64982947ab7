"""Parameter values from and to text."""

from __future__ import annotations

import enum
import json
import math
import os
import types
import typing
from collections.abc import Mapping, Sequence
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any

from excavatwin.cli.references import format_reference, is_reference, parse_reference
from excavatwin.errors import InputError

MOST_SEED = 2**62
"""What 64-bit random generators take, with room to count up."""


def convert(value: Any, kind: Any, path: tuple[str, ...]) -> Any:
    """A TOML value, or the text of a flag, as the type that a field asks for.

    Raises:
        InputError: it does not fit.
    """
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        return _convert_union(value, inner, path)
    if origin is typing.Annotated:
        return convert(value, inner[0], path)
    if origin is typing.Literal:
        if value in inner:
            return value
        raise _unfit(value, "one of " + ", ".join(map(str, inner)), path)
    if origin in (tuple, list, Sequence):
        return _convert_items(value, inner, path)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        if not isinstance(value, Mapping):
            raise _unfit(value, "a table of names and values", path)
        return {convert(k, inner[0], path): convert(v, inner[1], (*path, str(k))) for k, v in value.items()}
    if is_reference(kind):
        return parse_reference(str(value))
    return _convert_scalar(value, kind, path)


def _convert_union(value: Any, kinds: Sequence[Any], path: tuple[str, ...]) -> Any:
    if type(None) in kinds and (value is None or (isinstance(value, str) and value.lower() in ("none", ""))):
        return None
    errors = []
    for kind in (k for k in kinds if k is not type(None)):
        try:
            return convert(value, kind, path)
        except InputError as error:
            errors.append(error)
    raise errors[0]


def _convert_items(value: Any, inner: tuple[Any, ...], path: tuple[str, ...]) -> tuple[Any, ...]:
    items = [part for part in value.strip("[]() ").split(",") if part.strip()] if isinstance(value, str) else value
    if not isinstance(items, Sequence):
        items = [items]
    if inner and inner[-1] is not Ellipsis and len(inner) > 1:
        if len(items) != len(inner):
            raise _unfit(value, f"{len(inner)} values separated by commas", path)
        return tuple(convert(item, kind, path) for item, kind in zip(items, inner, strict=True))
    return tuple(convert(item, inner[0] if inner else str, path) for item in items)


def _convert_scalar(value: Any, kind: Any, path: tuple[str, ...]) -> Any:
    text = value.strip() if isinstance(value, str) else value
    if kind is bool:
        known = {
            "true": True,
            "yes": True,
            "on": True,
            "1": True,
            "false": False,
            "no": False,
            "off": False,
            "0": False,
        }
        if isinstance(value, bool):
            return value
        if isinstance(text, str) and text.lower() in known:
            return known[text.lower()]
        raise _unfit(value, "true or false", path)
    if kind in (int, float):
        try:
            number = kind(text) if not isinstance(value, bool) else None
        except (ValueError, TypeError):
            number = None
        if number is None or (kind is int and isinstance(value, float) and value != number):
            raise _unfit(value, "a whole number" if kind is int else "a number", path)
        return number
    if isinstance(kind, type) and issubclass(kind, enum.Enum):
        members = {member.name.lower(): member for member in kind}
        if str(text).lower() in members:
            return members[str(text).lower()]
        raise _unfit(value, "one of " + ", ".join(members), path)
    if kind is str or kind is Path:
        return kind(text)
    raise InputError(f"{'.'.join(path)} cannot be set from text; set it in Python.")


def _unfit(value: Any, wanted: str, path: tuple[str, ...]) -> InputError:
    return InputError(f"{'.'.join(path)} = {value!r} does not fit; give {wanted}.")


def toml_value(value: Any) -> str | None:
    """A parameter as TOML text; None has none."""
    if value is None:
        return None
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, enum.Enum):
        return json.dumps(value.name.lower())
    if is_dataclass(value) and not isinstance(value, type):  # a known length, or a twin
        return json.dumps(format_reference(value) if is_reference(type(value)) else type(value).__name__)
    if isinstance(value, float):
        return repr(value) if math.isfinite(value) else str(value)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {toml_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, tuple | list | frozenset):
        return "[" + ", ".join(str(toml_value(item)) for item in value) + "]"
    if isinstance(value, int):
        return str(value)
    return json.dumps(str(value), ensure_ascii=False)


def _key(name: Any) -> str:
    return name.name.lower() if isinstance(name, enum.Enum) else json.dumps(str(name))


def check_seed(flag: str, seed: int) -> None:
    """Refuse seeds that no random generator here takes.

    Raises:
        InputError: it is negative or has more than 62 bits.
    """
    if not 0 <= seed < MOST_SEED:
        raise InputError(f"{flag} is {seed}; expected a number from 0 on, such as 1.")


def check_folder(output: Path) -> None:
    """Refuse what cannot become the output folder before anything is computed.

    Raises:
        InputError: it is a file, lies in one, or cannot be written.
    """
    if output.exists() and not output.is_dir():
        raise InputError(f"{output} is a file, where a folder was to be written; give another name.")
    there = next(place for place in (output.absolute(), *output.absolute().parents) if place.exists())
    if not there.is_dir():
        raise InputError(f"{output} cannot be written: {there} is a file; give another name.")
    if not os.access(there, os.W_OK):
        raise InputError(f"{output} cannot be written: {there} is read-only for you; choose another place.")
