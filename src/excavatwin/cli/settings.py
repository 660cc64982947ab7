"""Stage parameters from text: the stages are the configuration; flags and TOML only replace their fields."""

from __future__ import annotations

import difflib
import itertools
import textwrap
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

from excavatwin.backbones.parameters import meanings_of
from excavatwin.cli.values import convert, toml_value
from excavatwin.errors import InputError


@dataclass(frozen=True)
class Parameter:
    """One field of one stage."""

    path: tuple[str, ...]
    """Names from the plan down, ``("mapper", "decision", "tau")``."""
    value: Any
    kind: Any
    """The annotation of the field, resolved."""
    meaning: str
    """The docstring under the field."""


def is_stage(value: Any) -> bool:
    """Whether a field holds a stage (with parameters of its own) rather than a value."""
    return is_dataclass(value) and not isinstance(value, type)


def parameters(stage: Any, path: tuple[str, ...] = ()) -> Iterator[Parameter]:
    """Every parameter of a stage and of the stages inside it, in the order of their definition."""
    kinds, meanings = typing.get_type_hints(type(stage)), field_meanings(type(stage))
    nested = []
    for field in fields(stage):
        value = getattr(stage, field.name)
        if is_stage(value) and type(value) is twins(kinds[field.name])[0]:
            nested.append((value, (*path, field.name)))
        elif field.init:
            yield Parameter((*path, field.name), value, kinds[field.name], meanings.get(field.name, ""))
    for value, below in nested:  # TOML: plain keys come before tables
        yield from parameters(value, below)


def field_meanings(stage: type) -> dict[str, str]:
    """Field name -> the docstring under it."""
    found: dict[str, str] = {}
    for cls in reversed(stage.__mro__[:-1]):
        found |= meanings_of(cls)
    return found


def configure(stage: Any, changes: Mapping[str, Any], path: tuple[str, ...] = ()) -> Any:
    """The stage with some parameters replaced.

    Args:
        stage: any stage, or a plan of stages.
        changes: nested names -> values, as TOML gives them or as the text of a flag.
        path: where ``stage`` lies, for messages.

    Raises:
        InputError: a name is unknown or a value does not fit; the message says what would.
    """
    names = [field.name for field in fields(stage) if field.init]
    kinds = typing.get_type_hints(type(stage))
    new: dict[str, Any] = {}
    for name, value in changes.items():
        here = (*path, name)
        if name not in names:
            raise InputError(_unknown(stage, here, names))
        old = getattr(stage, name)
        if is_stage(old):
            new[name] = configure(old, value, here) if isinstance(value, Mapping) else _twin(value, kinds[name], here)
        elif isinstance(old, Mapping) and isinstance(value, Mapping):
            new[name] = dict(old) | convert(value, kinds[name], here)
        else:
            new[name] = convert(value, kinds[name], here)
    try:
        return replace(stage, **new)
    except InputError:
        raise
    except (ValueError, TypeError) as error:
        raise InputError(f"{'.'.join(path)}: {error}") from None


def twins(kind: Any) -> tuple[type, ...]:
    """The stages that may stand in a field: the method's own first, then its twins for ablation."""
    inner = typing.get_args(kind) if typing.get_origin(kind) in (typing.Union, types.UnionType) else (kind,)
    return tuple(inner)


def _twin(name: Any, kind: Any, path: tuple[str, ...]) -> Any:
    known = {stage.__name__.lower(): stage for stage in twins(kind)}
    if str(name).lower() in known:
        return known[str(name).lower()]()
    names = " or ".join(stage.__name__ for stage in twins(kind))
    raise InputError(f"{'.'.join(path)} = {name!r} does not fit; it is a stage: {names}, or set its parameters.")


def _unknown(stage: Any, path: tuple[str, ...], names: Sequence[str]) -> str:
    *above, name = path
    near = difflib.get_close_matches(name, names, 1, 0.6)
    guesses = [".".join([*above, near[0]])] if near else []
    if not guesses:  # right name, wrong place
        everywhere = [".".join([*above, *p.path]) for p in parameters(stage)]
        guesses = [full for full in everywhere if full.split(".")[-1] == name][:1]
    hint = f"did you mean {guesses[0]}?" if guesses else f"here there are: {', '.join(names) or 'none'}."
    return f"there is no parameter {'.'.join(path)}; {hint}"


def to_toml(rooms: Mapping[str, Any]) -> str:
    """Stages by name as TOML with the meaning above each parameter; ``configure`` takes the tables back."""
    lines: list[str] = []
    table: tuple[str, ...] = ()
    for parameter in itertools.chain.from_iterable(parameters(stage, (name,)) for name, stage in rooms.items()):
        if parameter.path[:-1] != table:
            table = parameter.path[:-1]
            lines += ["", f"[{'.'.join(table)}]"]
        lines += textwrap.wrap(parameter.meaning, 100, initial_indent="# ", subsequent_indent="# ")
        text = toml_value(parameter.value)
        lines.append(f"{parameter.path[-1]} = {text}" if text is not None else f"# {parameter.path[-1]} = (unset)")
    return "\n".join(lines).strip() + "\n"
