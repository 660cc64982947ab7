"""Class mappings as TOML files: the shipped ones in ``class_mappings/``, and a user's own of the same form."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from excavatwin.errors import InputError
from excavatwin.scene.taxonomy import ClassMapping, TaskClass, parse_class
from excavatwin.vocabularies.vocabulary import NOTHING, Colour, Vocabulary, canonical, whole

Weights = dict[TaskClass, float]


def shipped_vocabularies() -> tuple[str, ...]:
    """Names of the class mappings that come with ExcavaTwin."""
    folder = files("excavatwin.vocabularies") / "class_mappings"
    return tuple(sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml")))


def read_vocabulary(source: str | Path, policy: str | None = None) -> Vocabulary:
    """A shipped vocabulary by name, or a TOML file by path.

    The file has ``[classes]``, in the order of the ids, each ``name = "task_class"``, ``name = "nothing"`` (never
    votes) or ``name = { task_class = weight }`` with weights in [0, 1] and a sum of at most 1; optional are

    - ``name`` and ``policy`` (the name of this mapping), ``[policies.NAME]`` with the classes that another policy maps
      otherwise. The shipped ones have "diggable" (what a bucket can take is construction terrain) and "strict" (laid
      gravel and turf are not; rock is; debris is an obstacle);
    - ``ids``, when they do not count 0, 1, 2, ... (``[]``: there are none); ``[aliases]``, other names of the same
      classes;
    - ``vocabulary``, all names in the order of the ids, and ``otherwise``, what those are mapped to that ``[classes]``
      does not mention; without ``vocabulary``, ``otherwise`` holds for every other name there is;
    - ``no_surface``, names of sky and water; ``[colours]``, name = [red, green, blue] of painted label images.

    Args:
        source: name or path; ``"goose-64:strict"`` names the policy, too.
        policy: which policy; by default the one of ``[classes]``.

    Raises:
        InputError: no such vocabulary, file or policy, or the file breaks this form.
    """
    if isinstance(source, str) and ":" in source and not Path(source).exists():
        source, _, named = source.rpartition(":")
        if policy not in (None, named):
            raise InputError(f"class mapping {source} is asked for policy {named!r} and for {policy!r}; name one.")
        policy = named
    return _vocabulary(_table(source), str(source), policy)


def policies_of(source: str | Path) -> tuple[str, ...]:
    """Names of the policies of a vocabulary, its first one first.

    Raises:
        InputError: as ``read_vocabulary``.
    """
    table = _table(source)
    return str(table.get("policy", "own")), *table.get("policies", {})


def digest(source: str) -> str:
    """Changes when the content of a class mapping does; empty where none is named (``""``, ``":policy"``).

    Raises:
        InputError: no such vocabulary or file.
    """
    place = source if Path(source).exists() or ":" not in source else source.rpartition(":")[0]
    return hashlib.blake2b(_text(place).encode(), digest_size=6).hexdigest() if place else ""


def parse_target(target: object, name: str, where: str) -> Weights:
    """Task classes and weights of ``"task_class"``, ``"nothing"`` or ``{ task_class = weight }``.

    Args:
        target: what stands behind the class.
        name: the class, for messages.
        where: the file or option, for messages.

    Raises:
        InputError: it is none of these, or a weight is outside [0, 1], or the weights exceed 1 together.
    """
    if isinstance(target, str):
        return {} if target.strip().lower() in (NOTHING, "") else {parse_class(target): 1.0}
    if not isinstance(target, dict):
        raise InputError(f'{where}: {name!r} needs "task_class", "nothing" or {{ task_class = weight }}.')
    weights: Weights = {}
    for task_class, weight in target.items():
        if isinstance(weight, bool) or not isinstance(weight, (int, float)) or not 0 <= weight <= 1:
            raise InputError(f"{where}: the weight of {name!r} is {weight!r}; give a number in [0, 1].")
        weights[parse_class(task_class)] = float(weight)
    if sum(weights.values()) > 1 + 1e-6:
        raise InputError(f"{where}: the weights of {name!r} sum to {sum(weights.values()):g}; give at most 1 in all.")
    return weights


def _text(source: str | Path) -> str:
    if str(source) in shipped_vocabularies():
        return (files("excavatwin.vocabularies") / "class_mappings" / f"{source}.toml").read_text("utf-8")
    try:
        return Path(source).read_text("utf-8")
    except (OSError, UnicodeDecodeError):
        names = ", ".join(shipped_vocabularies())
        raise InputError(
            f"class mapping {str(source)!r} is neither a readable TOML file nor one of the shipped ones: {names}."
        ) from None


def _table(source: str | Path) -> dict[str, Any]:
    try:
        return tomllib.loads(_text(source))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"class mapping {source} is not valid TOML: {error}.") from None


def _vocabulary(table: dict[str, Any], source: str, policy: str | None) -> Vocabulary:
    where = f"class mapping {source}"
    first = str(table.get("policy", "own"))
    lines = _lines(table, where, first, policy)
    otherwise = parse_target(table["otherwise"], "otherwise", where) if "otherwise" in table else None
    names = [str(name) for name in table.get("vocabulary", table["classes"])]
    weights, unlisted = _spread(lines, names, otherwise, where)
    for alias, name in table.get("aliases", {}).items():
        weights.setdefault(whole(alias), weights[_known(str(name), weights, f"alias {alias!r} stands for", where)])
    return Vocabulary(
        ClassMapping(str(table.get("name", Path(source).stem)), weights),
        dict(zip(_ids(table.get("ids"), len(names), where), names, strict=False)),
        policy or first,
        frozenset(_known(str(name), weights, "no_surface names", where) for name in table.get("no_surface", [])),
        _colours(table.get("colours", {}), weights, where),
        otherwise,
        unlisted,
        tuple(names),
        closed=otherwise is None or "vocabulary" in table,
    )


def _lines(table: dict[str, Any], where: str, first: str, policy: str | None) -> dict[str, Weights]:
    """``[classes]`` by name, with what ``[policies.policy]`` maps otherwise."""
    classes = table.get("classes")
    if not isinstance(classes, dict) or not classes:
        raise InputError(f'{where} has no table [classes]; write one line per class: grass = "..." .')
    keys: set[str] = set()
    for name in classes:
        if whole(name) in keys:
            raise InputError(f"{where} names {name!r} twice (compared as {whole(name)!r}).")
        keys.add(whole(name))
    lines = {whole(name): parse_target(target, name, where) for name, target in classes.items()}
    if policy is None or policy == first:
        return lines
    policies = table.get("policies", {})
    changes = policies.get(policy) if isinstance(policies, dict) else None
    if not isinstance(changes, dict):
        raise InputError(f"{where} has no policy {policy!r}; it has: {', '.join((first, *policies))}.")
    for name, target in changes.items():
        if whole(name) not in lines:
            raise InputError(f"{where}: [policies.{policy}] maps {name!r}, which is not in [classes].")
        lines[whole(name)] = parse_target(target, name, where)
    return lines


def _spread(
    lines: Mapping[str, Weights], names: Sequence[str], otherwise: Weights | None, where: str
) -> tuple[dict[str, Weights], frozenset[str]]:
    """Weights of all names by whole and by first name, and the keys of those that have no line.

    A line holds for the name that is written the same, else for all whose first synonym it is. A first synonym that
    names of other weights share ("plant, works" and "plant, flora") is nobody's.
    """
    weights, silent = dict(lines), set()
    for name in names:
        line = lines.get(whole(name), lines.get(canonical(name), otherwise))
        if line is None:
            raise InputError(f"{where}: vocabulary has {name!r}, which [classes] does not map; map it, or to nothing.")
        if not {whole(name), canonical(name)} & lines.keys():
            silent.add(whole(name))
        weights[whole(name)] = line
    strange = lines.keys() - {whole(name) for name in names} - {canonical(name) for name in names}
    if strange:
        raise InputError(f"{where}: [classes] maps {min(strange)!r}, which is not in vocabulary.")
    sharing: dict[str, list[str]] = {}
    for key in weights:
        sharing.setdefault(canonical(key), []).append(key)
    for first, keys in sharing.items():
        if first not in weights and all(weights[key] == weights[keys[0]] for key in keys):
            weights[first] = weights[keys[0]]
            silent |= {first} if silent.issuperset(keys) else set()
    return weights, frozenset(silent)


def _known(name: str, weights: Mapping[str, Weights], what: str, where: str) -> str:
    key = next((key for key in (whole(name), canonical(name)) if key in weights), None)
    if key is None:
        raise InputError(f"{where}: {what} {name!r}, which is not in [classes].")
    return key


def _ids(ids: object, count: int, where: str) -> list[int]:
    found = list(range(count)) if ids is None else ids
    if found == []:
        return []
    if not isinstance(found, list) or len(found) != count or not all(type(i) is int and i >= 0 for i in found):
        raise InputError(
            f"{where} has {len(found) if isinstance(found, list) else 'no list of'} ids for {count} classes; give one "
            "whole number >= 0 for each, all different."
        )
    if len(set(found)) != count:
        raise InputError(f"{where} gives one id to two classes; give each class an id of its own.")
    return found


def _colours(table: Mapping[str, object], weights: Mapping[str, Weights], where: str) -> dict[str, Colour]:
    colours: dict[str, Colour] = {}
    votes: dict[tuple[int, ...], Weights] = {}
    for name, colour in table.items():
        if not isinstance(colour, list) or len(colour) != 3 or not all(type(c) is int and 0 <= c < 256 for c in colour):
            raise InputError(f"{where}: the colour of {name!r} is {colour!r}; give [red, green, blue] in 0..255.")
        key = _known(name, weights, "[colours] paints", where)
        if votes.setdefault(tuple(colour), weights[key]) != weights[key]:
            raise InputError(
                f"{where}: {name!r} has the colour {colour} of a class that votes otherwise; leave one out."
            )
        colours[key] = (colour[0], colour[1], colour[2])
    return colours
