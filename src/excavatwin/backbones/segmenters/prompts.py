"""Prompts: the words, by task class, that text-prompted segmenters look for; TOML files that users copy and edit."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import blake2b
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from excavatwin.errors import InputError
from excavatwin.scene.taxonomy import TASK_CLASSES, K, class_name

#: Channels of a vote: the K task classes in the order of their ids, then these two.
NO_SURFACE, NOTHING = K, K + 1
CHANNELS = K + 2

#: Key of a prompts file -> channel.
KEYS = {class_name(one): one - 1 for one in TASK_CLASSES} | {"no_surface": NO_SURFACE, "nothing": NOTHING}


@dataclass(frozen=True)
class Prompts:
    """What a network is asked for, and what each answer means."""

    name: str
    """Name of the set; it stands beside every figure that depends on it."""
    texts: tuple[str, ...]
    """The prompts, as the network is given them."""
    votes: Float32[np.ndarray, "P C"]
    """Weights of each prompt for the channels: task classes 1..5, no_surface, nothing."""

    def identity(self) -> str:
        """Changes when a prompt, a weight or the order changes."""
        digest = blake2b("\n".join(self.texts).encode() + self.votes.tobytes(), digest_size=6).hexdigest()
        return f"prompts {self.name} {digest}"


def shipped_prompts() -> tuple[str, ...]:
    """Names of the prompt sets that come with ExcavaTwin."""
    folder = files("excavatwin.vocabularies") / "prompts"
    return tuple(sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml")))


def prompts_text(source: str) -> str:
    """The TOML text of a set: what a user copies to make an own one.

    Args:
        source: name of a shipped set, or path of a file.

    Raises:
        InputError: neither of them.
    """
    if source in shipped_prompts():
        return (files("excavatwin.vocabularies") / "prompts" / f"{source}.toml").read_text("utf-8")
    try:
        return Path(source).expanduser().read_text("utf-8")
    except (OSError, UnicodeDecodeError):
        names = ", ".join(shipped_prompts())
        raise InputError(
            f"prompts {source!r} are neither a readable TOML file nor one of the shipped sets: {names}."
        ) from None


def read_prompts(source: str) -> Prompts:
    """The prompts of a shipped set, or of a TOML file of the same form (see ``excavation.toml``).

    Raises:
        InputError: no such set or file, no valid TOML, an unknown task class, an empty list, a prompt that occurs
            twice, a weight outside (0, 1].
    """
    try:
        table = tomllib.loads(prompts_text(source))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"prompts {source} are not valid TOML: {error}.") from None
    lists = table.get("prompts")
    if not isinstance(lists, dict) or not lists:
        raise InputError(f'prompts {source} have no table [prompts]; write e.g. excavator = ["excavator"] under it.')
    texts: list[str] = []
    votes: list[Float32[np.ndarray, "C"]] = []
    owners: dict[str, str] = {}
    for key, value in lists.items():
        if key not in KEYS:
            raise InputError(f"prompts {source}: {key!r} is not a task class; there are: {', '.join(KEYS)}.")
        for text, weight in _entries(key, value, source):
            plain = " ".join(text.lower().split())
            if plain in owners:
                raise InputError(f"prompts {source}: {text!r} stands for {owners[plain]} and for {key}; keep one.")
            owners[plain] = key
            texts.append(" ".join(text.split()))
            votes.append(votes_for(key, weight))
    return Prompts(str(table.get("name", Path(source).stem)), tuple(texts), np.stack(votes))


def votes_for(key: str, weight: float = 1.0) -> Float32[np.ndarray, "C"]:
    """The vote of a prompt for one channel, by its key (``excavator``, ``no_surface``, ...)."""
    votes = np.zeros(CHANNELS, np.float32)
    votes[KEYS[key]] = weight
    return votes


def _entries(key: str, value: Any, source: str) -> Iterator[tuple[str, float]]:
    """Prompts of one class with their weights, from a list or a table."""
    if not isinstance(value, list | dict) or not value:
        raise InputError(
            f'prompts {source}: {key} has no prompts; write {key} = ["word", "another word"] or remove it.'
        )
    weighted = value.items() if isinstance(value, dict) else ((text, 1.0) for text in value)
    for text, weight in weighted:
        if not isinstance(text, str) or not text.strip():
            raise InputError(f"prompts {source}: {key} contains {text!r}; a prompt is a word or a few in quotes.")
        if isinstance(weight, bool) or not isinstance(weight, int | float) or not 0 < weight <= 1:
            raise InputError(f"prompts {source}: the weight of {text!r} is {weight!r}; give a number in (0, 1].")
        yield text, float(weight)
