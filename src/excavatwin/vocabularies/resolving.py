"""From a model's own class names to weights for the task classes, with the user's own changes; nothing is dropped."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from jaxtyping import Bool, Float32

from excavatwin.errors import InputError
from excavatwin.scene.taxonomy import ClassMapping, TaskClass, parse_class
from excavatwin.vocabularies.mapping_files import parse_target, read_vocabulary, shipped_vocabularies
from excavatwin.vocabularies.vocabulary import Vocabulary, canonical, whole

#: So many classes without a line of their own are named in a sentence; the mapping's file tells the rest.
LISTED = 30
#: Policy of a mapping of which the user wrote every line.
OWN = "own"


@dataclass(frozen=True)
class Resolved:
    """What a model's classes mean for the task."""

    names: tuple[str, ...]
    """The model's classes, in the order of its channels."""
    weights: Float32[np.ndarray, "V K"]
    """Weights of the classes for the K task classes; a row of zeros never votes. Rows sum to at most 1."""
    no_surface: Bool[np.ndarray, "V"]
    """Classes of sky and water."""
    mapping: str
    """Name of the class mapping, ``"ade20k-150"``."""
    policy: str
    """Its policy, with the user's changes: ``"diggable; gravel=other_terrain"``. Stands beside every figure."""
    otherwise: tuple[str, ...] = ()
    """Classes that the mapping has no line for and covers by its explicit ``otherwise``."""

    def evidence(self, p: Float32[np.ndarray, "H W V"]) -> Float32[np.ndarray, "H W K"]:
        """Evidence for the task classes from probabilities of the classes; their sum never exceeds that of p or 1."""
        merged = np.asarray(p, np.float32) @ self.weights
        return merged / np.maximum(merged.sum(-1, keepdims=True), 1)

    def surfaceless(self, p: Float32[np.ndarray, "H W V"]) -> Bool[np.ndarray, "H W"]:
        """Pixels that are sky or water: the probabilities of those classes exceed one half together."""
        return np.asarray(p, np.float32) @ self.no_surface.astype(np.float32) > 0.5

    @property
    def doubts(self) -> tuple[str, ...]:
        """The sentence, when classes were mapped that the mapping has no line for."""
        return (self.sentence(),) if self.otherwise else ()

    def sentence(self) -> str:
        """How the classes were mapped, for the run's record."""
        more = len(self.otherwise) - LISTED
        listed = ", ".join(self.otherwise[:LISTED]) + (f" and {more} more" if more > 0 else "")
        rest = f"; {len(self.otherwise)} by its 'otherwise': {listed}" if self.otherwise else ""
        return f"{len(self.names)} classes by the mapping {self.mapping} ({self.policy}){rest}."


def resolve(names: Sequence[str], mapping: str = "", remap: Mapping[str, str] = MappingProxyType({})) -> Resolved:
    """The weights of a model's classes for the task classes.

    Args:
        names: the model's classes, in the order of its channels.
        mapping: a shipped class mapping or a TOML file, with or without ``:policy``; ``""`` chooses the shipped one
            that has a line for every class (the one with exactly these classes, else the smallest), ``":policy"``
            likewise with another policy.
        remap: class -> task class (``parse_remap``); stands above the mapping.

    Raises:
        InputError: classes that are not mapped (all of them are listed), a remap of a class that the model does not
            have, a mapping that does not exist.
    """
    own = _own(names, remap)
    rest = [name for name in names if whole(name) not in own]
    vocabulary = _chosen(rest, own, mapping) if rest or mapping.strip(":") else None
    missing = vocabulary.foreign(rest) if vocabulary is not None else ()
    if vocabulary is not None and missing:
        raise InputError(_unmapped(missing, names, f"the class mapping {vocabulary.mapping.name} says nothing about"))
    weights = ClassMapping("remap", own).matrix([whole(name) for name in names if whole(name) in own])
    W = np.zeros((len(names), weights.shape[1]), np.float32)
    mine = np.array([whole(name) in own for name in names], bool)
    W[mine] = weights
    no_surface = np.zeros(len(names), bool)
    if vocabulary is not None and rest:
        W[~mine] = vocabulary.matrix(rest)
        no_surface[~mine] = vocabulary.surfaceless(rest)
    policy = OWN if vocabulary is None else vocabulary.policy
    return Resolved(
        names=tuple(names),
        weights=W,
        no_surface=no_surface,
        mapping=OWN if vocabulary is None else vocabulary.mapping.name,
        policy="; ".join((policy, *(f"{name}={target}" for name, target in sorted(remap.items())))),
        otherwise=() if vocabulary is None else vocabulary.unspoken(rest),
    )


def parse_remap(texts: str | Sequence[str]) -> dict[str, str]:
    """Class -> task class from ``"gravel=construction_terrain"``, one or several.

    Soft: ``"gravel=construction_terrain:0.5+other_terrain:0.5"``; a class that must not vote: ``"haze=nothing"``.

    Raises:
        InputError: a text breaks this form, names no task class, or two of them speak of one class.
    """
    remap: dict[str, str] = {}
    for text in [texts] if isinstance(texts, str) else texts:
        name, equals, target = text.rpartition("=")
        if not equals or not name.strip():
            raise InputError(f'--map {text!r} is not NAME=TASK_CLASS; write e.g. --map "gravel=construction_terrain".')
        _target(target, name)
        if any(whole(name) == whole(known) for known in remap):
            raise InputError(f"--map speaks of {name.strip()!r} twice; say once what it is.")
        remap[name.strip()] = target.strip()
    return remap


def _target(text: str, name: str) -> dict[TaskClass, float]:
    if ":" not in text and "+" not in text:
        return parse_target(text, name, "--map")
    weights: dict[str, float] = {}
    for part in text.split("+"):
        task_class, _, weight = part.partition(":")
        try:
            weights[parse_class(task_class).name] = float(weight)
        except ValueError as error:
            if isinstance(error, InputError):
                raise
            raise InputError(
                f"--map {name}={text}: {part.strip()!r} has no weight; write task_class:0.5+task_class:0.5."
            ) from None
    return parse_target(weights, name, "--map")


def _own(names: Sequence[str], remap: Mapping[str, str]) -> dict[str, dict[TaskClass, float]]:
    """Whole name -> weights of the classes that the user remapped, by whole or by first name."""
    own: dict[str, dict[TaskClass, float]] = {}
    strange = []
    for asked, target in remap.items():
        exact = [name for name in names if whole(name) == whole(asked)]
        meant = exact or [name for name in names if canonical(name) == whole(asked)]
        if not meant:
            strange.append(asked)
        own |= {whole(name): _target(target, asked) for name in meant}
    if not strange:
        return own
    near = {
        asked: difflib.get_close_matches(whole(asked), [whole(name) for name in names], 1, 0.6) for asked in strange
    }
    told = [f"{asked!r} (did you mean {near[asked][0]!r}?)" if near[asked] else repr(asked) for asked in strange]
    raise InputError(
        f"--map names {', '.join(told)}, which {'is' if len(told) == 1 else 'are'} not among the {len(names)} classes "
        f"of the model{'' if any(near.values()) else ': ' + ', '.join(names)}."
    )


def fitting(names: Sequence[str], own: Collection[str] = ()) -> tuple[str, ...]:
    """The shipped class mappings that have a line for every class; first those of exactly these, then the smallest.

    Args:
        names: the model's classes.
        own: more classes of the model, whose task class the user says.
    """
    known = [read_vocabulary(name) for name in shipped_vocabularies()]
    same = {one.mapping.name for one in known if _same(one, names, own)}
    fit = [one for one in known if one.mapping.name in same or not _without_line(one, names)]
    fit.sort(key=lambda one: (one.mapping.name not in same, len(one.classes), one.mapping.name))
    return tuple(one.mapping.name for one in fit)


def _chosen(names: Sequence[str], own: Collection[str], mapping: str) -> Vocabulary:
    """The mapping that was asked for, or the shipped one that fits best the classes that are not the user's own."""
    if mapping and not mapping.startswith(":"):
        return read_vocabulary(mapping)
    fit = fitting(names, own)
    if fit:
        return read_vocabulary(fit[0], mapping[1:] or None)
    known = [read_vocabulary(name) for name in shipped_vocabularies()]
    nearest = min(known, key=lambda one: (len(_without_line(one, names)), len(one.classes), one.mapping.name))
    hint = f"no shipped class mapping covers all classes; the nearest, {nearest.mapping.name}, has no line for"
    raise InputError(_unmapped(_without_line(nearest, names), (*names, *own), hint))


def _same(vocabulary: Vocabulary, names: Sequence[str], own: Collection[str]) -> bool:
    """Whether these and the user's own are exactly the classes of a vocabulary, in whatever order.

    A vocabulary that leaves classes outside its lines to ``otherwise`` is meant when they include nine lines in ten.
    """
    there = {vocabulary.key(name) for name in (*names, *own)}
    known = {vocabulary.key(name) for name in vocabulary.classes}
    enough = len(known) if vocabulary.closed else 0.9 * len(known)
    return vocabulary.covers(names) and len(known & there) >= enough


def _without_line(vocabulary: Vocabulary, names: Sequence[str]) -> list[str]:
    """Classes that are foreign to it or that only its ``otherwise`` covers, in their order."""
    without = {*vocabulary.foreign(names), *vocabulary.unspoken(names)}
    return [name for name in dict.fromkeys(names) if name in without]


def _unmapped(missing: Sequence[str], names: Sequence[str], hint: str) -> str:
    listed = ", ".join(repr(name) for name in missing)
    return (
        f'{hint} {len(missing)} of {len(names)}: {listed}; say for each what it is, --map "{missing[0]}=TASK_CLASS" '
        "(or =nothing if it must not vote), or give a class mapping of your own (TOML)."
    )
