"""State of every backbone on this machine: installed, weights here, terms, memory, and what to type next."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from excavatwin.backbones import catalogue, extras, weights
from excavatwin.backbones.cards import Card, Weights
from excavatwin.backbones.catalogue import Entry
from excavatwin.errors import InputError
from excavatwin.survey import memory

#: Lattice for which memory is told: VGGT's, for photos of 4:3.
_HEIGHT, _WIDTH = 392, 518


@dataclass(frozen=True)
class BackboneState:
    """One row of `excavatwin backbones`."""

    card: Card
    package: str
    """Who brings it."""
    missing: tuple[str, ...]
    """Modules that are not installed."""
    weights_here: bool | None
    """Whether the default weights are on this machine; None when it needs none."""
    memory: tuple[float, float] | None
    """Estimated peak memory for 10 and for 50 photos at once [bytes]; None where we have no figure."""

    @property
    def state(self) -> str:
        """``ready``, ``not installed`` or ``weights missing``."""
        if self.missing:
            return "not installed"
        return "weights missing" if self.weights_here is False else "ready"

    @property
    def terms(self) -> str:
        """Licence that matters: of the default weights where there are any and they are stricter than the code's."""
        if not self.card.commercial or not self.card.weights:
            return self.card.licence
        return self.card.weights[0].licence

    @property
    def restricted(self) -> bool:
        """Whether code or default weights restrict commercial use."""
        return not self.card.commercial or any(not one.commercial for one in self.card.weights[:1])

    @property
    def metric(self) -> str:
        """Whether its points are metres; empty for segmenters."""
        if self.card.kind == "segmenter":
            return ""
        by_weights = any(one.metric for one in self.card.weights[:1])
        return "yes" if self.card.metric or by_weights else "no"

    @property
    def next(self) -> str:
        """What to type next."""
        if self.missing:
            return self.card.install
        value = f":{self.card.argument.upper()}" if self.card.argument and not self.card.weights else ""
        command = f"excavatwin map photos/ -o site --{self.card.kind} {self.card.name}{value}"
        return f"{command} --download" if self.weights_here is False else command


def states(kind: catalogue.Kind) -> Iterator[BackboneState]:
    """All backbones of a kind, in the order of the catalogue."""
    for entry in catalogue.entries(kind):
        yield state_of(entry)


def state_of(entry: Entry) -> BackboneState:
    """One backbone; nothing of its library is imported."""
    card = entry.card()
    wanted = [str(getattr(entry.load(), field, "")) for field in card.weight_fields]
    here = all(weights.find(card, one) is not None for one in wanted) if card.weights else None
    return BackboneState(card, entry.package, extras.missing(card), here, _memory(entry))


def find_entry(name: str) -> Entry:
    """The backbone of that name, of whichever kind.

    Raises:
        InputError: there is none.
    """
    kinds: tuple[catalogue.Kind, ...] = ("reconstructor", "segmenter")
    every = {one.name: one for kind in kinds for one in catalogue.entries(kind)}
    if name in every:
        return every[name]
    import difflib

    near = difflib.get_close_matches(name, every, 1, 0.5)
    raise InputError(
        f"there is no backbone {name!r}; " + (f"did you mean {near[0]}?" if near else f"there are: {', '.join(every)}.")
    )


def sets(card: Card) -> list[tuple[Weights, bool]]:
    """Known weights, and whether they are on this machine."""
    return [(one, weights.find(card, one.repo) is not None) for one in card.weights]


def _memory(entry: Entry) -> tuple[float, float] | None:
    backbone: Any = entry.load()
    if entry.name == "photogrammetry":
        return memory.estimate(10), memory.estimate(50)
    from excavatwin.backbones.sequence.feed_forward import FeedForward

    if not issubclass(backbone, FeedForward):
        return None
    model: Any = backbone()
    return model.memory(10, _HEIGHT, _WIDTH), model.memory(50, _HEIGHT, _WIDTH)
