"""Before anything is computed: are the libraries and the weights of the chosen backbones here, and on which terms?"""

from __future__ import annotations

from collections.abc import Sequence

from excavatwin.backbones import extras, weights
from excavatwin.backbones.cards import Card
from excavatwin.backbones.protocols import Backbone
from excavatwin.backbones.weights import Consent


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
        wanted = [str(getattr(backbone, field, "")) for field in backbone.card.weight_fields]
        if backbone.card.weights:
            for one in wanted:
                weights.provide(backbone.card, one, consent)
        terms += [sentence for one in wanted for sentence in restrictions(backbone.card, one)]
    return list(dict.fromkeys(terms))


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
