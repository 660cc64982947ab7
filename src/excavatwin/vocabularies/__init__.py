"""Named vocabularies: the classes of a segmenter by id, and the task class that each one votes for.

The shipped ones are readable TOML files in ``class_mappings/``; a user's own file has the same form. Which task class a
class belongs to is a choice that scores depend on, so each choice is a named policy.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from excavatwin.errors import InputError
from excavatwin.scene.taxonomy import ClassMapping, TaskClass, parse_class

#: What a class of a vocabulary is mapped to when it must not vote (sky, void).
NOTHING = "nothing"


@dataclass(frozen=True)
class Vocabulary:
    """The classes of a segmenter and their mapping to task classes."""

    mapping: ClassMapping
    """Keys are canonical names (``canonical``), aliases included."""
    names: dict[int, str]
    """Class id of the label images -> name."""
    policy: str
    """Which of several defensible mappings this is; it stands beside every figure that depends on it."""

    def covers(self, names: Sequence[str]) -> bool:
        """Whether every name is mapped."""
        return all(canonical(name) in self.mapping.weights for name in names)

    def matrix(self, names: Sequence[str]) -> Float32[np.ndarray, "V K"]:
        """Weights of the named classes for the K task classes.

        Raises:
            InputError: a name is not mapped.
        """
        return self.mapping.matrix([canonical(name) for name in names])


def canonical(name: str) -> str:
    """The name by which classes are compared: first synonym, lower case, words parted by one space."""
    first = re.split(r"[,(;]", name)[0]
    return re.sub(r"[\s_]+", " ", first).strip().lower()


def shipped_vocabularies() -> tuple[str, ...]:
    """Names of the class mappings that come with ExcavaTwin."""
    folder = files("excavatwin.vocabularies") / "class_mappings"
    return tuple(sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml")))


def read_vocabulary(source: str | Path, policy: str | None = None) -> Vocabulary:
    """A shipped vocabulary by name, or a TOML file by path.

    The file has ``[classes]``, in the order of the ids, each ``name = "task_class"``, ``name = "nothing"`` (never
    votes) or ``name = { task_class = weight }`` with weights in [0, 1]; optional ``name``, ``policy`` (the name of
    this mapping), ``ids`` (when they do not count 0, 1, 2, ...), ``[aliases]``, and a table ``[policies.NAME]`` with
    the classes that another policy maps otherwise. The shipped ones have "diggable" (what a bucket can take is
    construction terrain) and "strict" (laid gravel and turf are not; rock is; debris is an obstacle).

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


def _table(source: str | Path) -> dict[str, Any]:
    if str(source) in shipped_vocabularies():
        text = (files("excavatwin.vocabularies") / "class_mappings" / f"{source}.toml").read_text("utf-8")
    else:
        try:
            text = Path(source).read_text("utf-8")
        except (OSError, UnicodeDecodeError):
            names = ", ".join(shipped_vocabularies())
            raise InputError(
                f"class mapping {str(source)!r} is neither a readable TOML file nor one of the shipped ones: {names}."
            ) from None
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"class mapping {source} is not valid TOML: {error}.") from None


def _vocabulary(table: dict[str, Any], source: str, policy: str | None) -> Vocabulary:
    classes = table.get("classes")
    if not isinstance(classes, dict) or not classes:
        raise InputError(f'class mapping {source} has no table [classes]; write one line per class: grass = "..." .')
    weights: dict[str, dict[TaskClass, float]] = {}
    for name, target in classes.items():
        if canonical(name) in weights:
            raise InputError(f"class mapping {source} names {name!r} twice (compared as {canonical(name)!r}).")
        weights[canonical(name)] = _weights(target, name, source)
    first = str(table.get("policy", "own"))
    weights |= _otherwise(table, source, first, policy, weights)
    for alias, name in table.get("aliases", {}).items():
        if canonical(str(name)) not in weights:
            raise InputError(f"class mapping {source}: alias {alias!r} stands for {name!r}, which is not in [classes].")
        weights.setdefault(canonical(alias), weights[canonical(str(name))])
    ids = table.get("ids", list(range(len(classes))))
    if len(ids) != len(classes) or len(set(ids)) != len(ids) or not all(isinstance(i, int) and i >= 0 for i in ids):
        raise InputError(
            f"class mapping {source} has {len(ids)} ids for {len(classes)} classes; "
            "give one whole number >= 0 for each, all different."
        )
    name = str(table.get("name", Path(source).stem))
    return Vocabulary(ClassMapping(name, weights), dict(zip(ids, classes, strict=True)), policy or first)


def _otherwise(
    table: dict[str, Any], source: str, first: str, policy: str | None, classes: Collection[str]
) -> dict[str, dict[TaskClass, float]]:
    """What ``[policies.policy]`` maps otherwise than ``[classes]``; nothing for the first policy."""
    policies = table.get("policies", {})
    if policy is None or policy == first:
        return {}
    changes = policies.get(policy) if isinstance(policies, dict) else None
    if not isinstance(changes, dict):
        raise InputError(f"class mapping {source} has no policy {policy!r}; it has: {', '.join((first, *policies))}.")
    strange = next((name for name in changes if canonical(name) not in classes), None)
    if strange is not None:
        raise InputError(f"class mapping {source}: [policies.{policy}] maps {strange!r}, which is not in [classes].")
    return {canonical(name): _weights(target, name, source) for name, target in changes.items()}


def _weights(target: object, name: str, source: str) -> dict[TaskClass, float]:
    if isinstance(target, str):
        return {} if target.strip().lower() in (NOTHING, "") else {parse_class(target): 1.0}
    if not isinstance(target, dict):
        raise InputError(
            f'class mapping {source}: {name!r} needs "task_class", "nothing" or {{ task_class = weight }}.'
        )
    weights: dict[TaskClass, float] = {}
    for task_class, weight in target.items():
        if isinstance(weight, bool) or not isinstance(weight, (int, float)) or not 0 <= weight <= 1:
            raise InputError(f"class mapping {source}: the weight of {name!r} is {weight!r}; give a number in [0, 1].")
        weights[parse_class(task_class)] = float(weight)
    return weights
