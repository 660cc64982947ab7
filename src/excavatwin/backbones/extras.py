"""Optional libraries: asked for when a backbone is used, and never before."""

from __future__ import annotations

import importlib.util
from importlib.metadata import PackageNotFoundError, packages_distributions, version

from excavatwin.backbones.cards import Card
from excavatwin.errors import MissingExtraError


def missing(card: Card) -> tuple[str, ...]:
    """The modules of a backbone that are not installed (nothing is imported)."""
    return tuple(name for name in card.modules if not _found(name))


def need(card: Card) -> None:
    """Refuse to go on without the libraries of a backbone.

    Raises:
        MissingExtraError: one is not installed; the message gives the exact install line.
    """
    absent = missing(card)
    if absent:
        raise MissingExtraError(
            f"{card.kind} {card.name} needs {', '.join(absent)}, which {'is' if len(absent) == 1 else 'are'} not "
            f"installed; run: {card.install}"
        )


def versions(card: Card) -> str:
    """Installed versions of a backbone's libraries, ``"torch 2.14.1, transformers 5.23.0"``."""
    owners = packages_distributions()
    found = []
    for module in card.modules:
        for distribution in owners.get(module.partition(".")[0], [module])[:1]:
            try:
                found.append(f"{distribution} {version(distribution)}")
            except PackageNotFoundError:
                found.append(f"{distribution} of unknown version")
    return ", ".join(found)


def _found(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except (ImportError, ValueError):
        return False
