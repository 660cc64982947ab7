"""Before anything is computed: are the libraries and the weights of the chosen backbones here, and on which terms?"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from excavatwin.backbones import extras, weights
from excavatwin.backbones.cards import Card
from excavatwin.backbones.protocols import Backbone
from excavatwin.backbones.weights import Consent
from excavatwin.errors import InputError


def make_ready(backbones: Sequence[Backbone], consent: Consent) -> list[str]:
    """Check libraries and weights; fetch weights when the user agrees.

    Returns:
        One sentence for each backbone whose terms restrict what the map may be used for.

    Raises:
        MissingExtraError: a library is not installed.
        InputError: weights are not here and are not to be downloaded.
    """
    for backbone in backbones:
        extras.need(backbone.card)
    terms = []
    for backbone in backbones:
        _check_files(backbone)
        wanted = [str(getattr(backbone, field, "")) for field in backbone.card.weight_fields]
        if backbone.card.weights:
            for one in wanted:
                weights.provide(backbone.card, one, consent)
        terms += [sentence for one in wanted for sentence in restrictions(backbone.card, one)]
    return list(dict.fromkeys(terms))


def _check_files(backbone: Backbone) -> None:
    """Refuse a reader of files that was given none, or none that exist, before anything is computed."""
    card = backbone.card
    if card.argument != "source":
        return
    source = str(getattr(backbone, "source", ""))
    words = f"--{card.kind} {card.name}:PATH"
    if not source:
        raise InputError(f"{card.kind} {card.name} reads files of yours; say which: {words}.")
    if not Path(source).expanduser().exists():
        raise InputError(f"{card.kind} {card.name} reads {source}, which does not exist; give {words}.")


def restrictions(card: Card, wanted: str = "") -> list[str]:
    """What the licences of code and weights restrict, one sentence each; empty for permissive ones."""
    found = []
    if not card.commercial:
        found.append(f"{card.name}: its code is under {card.licence}; see to its terms before you ship with it.")
    if card.weights:
        one = weights.chosen(card, wanted)
        if weights.is_path(wanted):
            found.append(f"{card.name}: the terms of the weights in {wanted} are not known to us; see to them.")
        elif not one.commercial:
            found.append(f"{card.name}: its weights {one.repo} are under {one.licence}; see to its terms.")
    return found
