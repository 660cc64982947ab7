"""A vocabulary: the classes that a segmenter or a data set knows, and the task class that each of them votes for."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float32

from excavatwin.scene.taxonomy import ClassMapping, TaskClass

#: What a class of a vocabulary is mapped to when it must not vote (sky, void).
NOTHING = "nothing"

Colour = tuple[int, int, int]
"""sRGB, 0..255 each."""


@dataclass(frozen=True)
class Vocabulary:
    """The classes of a segmenter and their mapping to task classes."""

    mapping: ClassMapping
    """Keys are whole names (``whole``) and canonical ones (``canonical``), aliases included."""
    names: dict[int, str]
    """Class id of the label images -> name; empty when the classes are known by name only."""
    policy: str
    """Which of several defensible mappings this is; it stands beside every figure that depends on it."""
    no_surface: frozenset[str] = frozenset()
    """Keys of sky and water: where they are, no solid surface can be reconstructed."""
    colours: Mapping[str, Colour] = field(default_factory=dict)
    """Key -> colour in label images that are painted instead of numbered; empty when there is no known palette."""
    otherwise: Mapping[TaskClass, float] | None = None
    """What every class without a line of its own is mapped to, by an explicit ``otherwise`` of the file."""
    unlisted: frozenset[str] = frozenset()
    """Keys of those classes of ``names`` to which ``otherwise`` applies."""
    classes: tuple[str, ...] = ()
    """All names, in the order of the file."""
    closed: bool = True
    """Whether classes outside ``names`` and the aliases are foreign; not so for a user's ``otherwise`` for all."""

    def key(self, name: str) -> str:
        """The key by which a class is found: its whole name where that is mapped, else the canonical one."""
        return whole(name) if whole(name) in self.mapping.weights else canonical(name)

    def covers(self, names: Sequence[str]) -> bool:
        """Whether every name is mapped."""
        return not self.foreign(names)

    def foreign(self, names: Sequence[str]) -> tuple[str, ...]:
        """The names that are not mapped, in their order."""
        if not self.closed:
            return ()
        return tuple(name for name in dict.fromkeys(names) if self.key(name) not in self.mapping.weights)

    def unspoken(self, names: Sequence[str]) -> tuple[str, ...]:
        """The names that are mapped by ``otherwise`` and not by a line of their own."""
        if self.otherwise is None:
            return ()
        keys = {name: self.key(name) for name in names}
        return tuple(n for n, key in keys.items() if key in self.unlisted or key not in self.mapping.weights)

    def matrix(self, names: Sequence[str]) -> Float32[np.ndarray, "V K"]:
        """Weights of the named classes for the K task classes.

        Raises:
            InputError: a name is not mapped.
        """
        mapping = self.mapping
        if not self.closed and self.otherwise is not None:
            rest = {self.key(name): self.otherwise for name in names if self.key(name) not in mapping.weights}
            mapping = ClassMapping(mapping.name, {**mapping.weights, **rest})
        return mapping.matrix([self.key(name) for name in names])

    def surfaceless(self, names: Sequence[str]) -> Bool[np.ndarray, "V"]:
        """Which of the named classes are sky or water."""
        return np.array([self.key(name) in self.no_surface for name in names], bool)


def whole(name: str) -> str:
    """A class name with all its synonyms: lower case, words parted by one space."""
    return re.sub(r"[\s_]+", " ", name).strip().lower()


def canonical(name: str) -> str:
    """The name by which classes are compared: first synonym, lower case, words parted by one space."""
    return whole(re.split(r"[,(;/]", name)[0])
