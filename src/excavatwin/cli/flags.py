"""Stage flags: ``--mapper.decision.tau 0.4`` becomes ``{"mapper": {"decision": {"tau": "0.4"}}}``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from excavatwin.errors import InputError

_DOTTED = re.compile(r"--([A-Za-z_][\w-]*(?:\.[A-Za-z_][\w-]*)+)(?:=(.*))?", re.DOTALL)


def split_stage_flags(argv: Sequence[str]) -> tuple[list[str], dict[str, Any]]:
    """Take the dotted flags out of a command line.

    Returns:
        The rest of the command line, and the nested parameters (values still text).

    Raises:
        InputError: a flag has no value.
    """
    rest: list[str] = []
    nested: dict[str, Any] = {}
    tokens = iter(argv)
    for token in tokens:
        if token == "--":
            rest += [token, *tokens]
            break
        match = _DOTTED.fullmatch(token)
        if match is None:
            rest.append(token)
            continue
        name, value = match.groups()
        if value is None:
            value = next(tokens, None)
        if value is None or value.startswith("--"):
            raise InputError(f"--{name} needs a value; `excavatwin config` shows what each parameter means.")
        *above, last = name.replace("-", "_").split(".")
        table = nested
        for part in above:
            table = table.setdefault(part, {})
            if not isinstance(table, dict):
                raise InputError(f"--{name} sets a parameter inside a parameter; `excavatwin config` lists them all.")
        table[last] = value
    return rest, nested


def merge(first: dict[str, Any], second: dict[str, Any]) -> dict[str, Any]:
    """Both, table by table; where both set a parameter, ``second`` wins."""
    merged = dict(first)
    for name, value in second.items():
        old = merged.get(name)
        merged[name] = merge(old, value) if isinstance(old, dict) and isinstance(value, dict) else value
    return merged
