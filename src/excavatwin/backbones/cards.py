"""The card of a backbone: what a user wants to know before choosing it. Printed by `excavatwin backbones`."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Literal


class Tried(StrEnum):
    """How far an adapter has been run by us."""

    BUILT_IN = "built in"
    """Part of ExcavaTwin; its accuracy is measured in benchmarks/."""
    REAL_CODE = "real code, random weights"
    """The model's own code ran through the adapter with small random weights; nobody has run it with real ones."""
    STAND_IN = "not yet run with weights"
    """Written against the documented outputs and tested with a stand-in that delivers them."""
    FILES = "files read"
    """Reads finished results; tested on files of that layout."""


@dataclass(frozen=True)
class Weights:
    """One set of weights that a backbone can use."""

    repo: str
    """Its name on the hub, ``owner/name``."""
    size: float
    """What a download takes [bytes]; NaN when we do not know."""
    licence: str
    """As the publisher states it."""
    commercial: bool
    """Whether that licence allows commercial use."""
    gated: bool = False
    """The publisher wants an account to accept terms first."""
    files: tuple[str, ...] = ("*.safetensors", "*.json", "*.txt", "*.model")
    """Which files of the repository are needed (patterns)."""
    metric: bool = False
    """Whether these weights deliver metres."""


@dataclass(frozen=True)
class Card:
    """Name, terms, needs and state of one backbone."""

    name: str
    """What the user types after ``--reconstructor`` or ``--segmenter``."""
    kind: Literal["reconstructor", "segmenter"]
    summary: str
    """One line: what it is, and from whom."""
    tried: Tried
    licence: str = "Apache-2.0"
    """Of its code (SPDX)."""
    commercial: bool = True
    """Whether the licence of its code allows use in a closed or commercial product as it is (AGPL: no)."""
    modules: tuple[str, ...] = ()
    """Top-level modules that must be importable."""
    install: str = ""
    """The exact line that installs them; empty when nothing is needed."""
    weights: tuple[Weights, ...] = ()
    """Sets that are known to fit, the default first; empty when it needs none."""
    weight_fields: tuple[str, ...] = ("weights",)
    """Fields that name weights, when it needs more than one set at a time."""
    argument: str = ""
    """Field that ``name:VALUE`` on the command line sets (weights, folder or file); empty when there is none."""
    metric: bool = False
    """Whether it delivers metres by itself (for weights see there)."""
    source: str = ""
    """Repository or paper."""
