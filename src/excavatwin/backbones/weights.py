"""Weights of networks: found on this machine, or downloaded after the user agreed, never silently.

They are looked for where Hugging Face's libraries keep them (``HF_HOME``), or at the path that was given.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from excavatwin.backbones.cards import Card, Weights
from excavatwin.errors import InputError

_TENSORS = (".safetensors", ".pt", ".pth", ".bin", ".ckpt", ".npz", ".onnx")
_TEXT = (".json", ".txt", ".model", ".md", ".yaml", ".yml", "")
"""Endings of files that come with weights and are none."""

Consent = Callable[[str], bool]
"""Asked with one sentence that names what would be downloaded, its size and its licence."""


def refuse(question: str) -> bool:
    """The consent of somebody who was not asked."""
    return False


def chosen(card: Card, wanted: str) -> Weights:
    """The set that ``wanted`` names: one of the card's, or another repository of which we know nothing."""
    if not wanted:
        return card.weights[0]
    for one in card.weights:
        if wanted in (one.repo, one.repo.partition("/")[2]):
            return one
    return replace(card.weights[0], repo=wanted, size=math.nan, licence="unknown to us", commercial=False)


def is_path(wanted: str) -> bool:
    """Whether the user gave a place on disk rather than a name on the hub."""
    if not wanted:
        return False
    named = wanted.startswith((".", "/", "~")) or wanted.endswith(_TENSORS) or wanted.count("/") > 1
    return named or Path(wanted).exists()


def find(card: Card, wanted: str = "") -> Path | None:
    """Folder or file of the weights on this machine; None when they are not here. Never touches the network.

    Of several revisions in the hub's cache the one that it calls main, else the one that came last. One that lacks its
    tensors, because a download stopped or because somebody fetched only the configuration, is not there.

    Raises:
        InputError: a path was given and nothing is there.
    """
    if is_path(wanted):
        path = Path(wanted).expanduser()
        if not path.exists():
            raise InputError(f"weights of {card.name}: there is no {path}; give a file, a folder or a name on the hub.")
        return path
    snapshots = _cache() / f"models--{chosen(card, wanted).repo.replace('/', '--')}" / "snapshots"
    main = snapshots.parent / "refs" / "main"
    there = [one for one in snapshots.iterdir() if _whole(one)] if snapshots.is_dir() else []
    current = main.read_text().strip() if main.is_file() else ""
    return max(there, key=lambda one: (one.name == current, one.stat().st_mtime_ns, one.name), default=None)


def need(card: Card, wanted: str = "") -> Path:
    """The weights on this machine.

    Raises:
        InputError: they are not here; the message tells size, licence and both ways to get them.
    """
    found = find(card, wanted)
    if found is None:
        one = chosen(card, wanted)
        raise InputError(
            f"the weights of {card.name} ({described(one)}) are not on this machine; add --download to fetch them from "
            f"the hub, or give --{card.name}.weights PATH."
        )
    return found


def provide(card: Card, wanted: str, consent: Consent) -> Path:
    """The weights, downloaded when they are not here and the user agrees.

    Raises:
        InputError: they are not here and the user does not agree, or the download fails.
    """
    found = find(card, wanted)
    one = None if found is not None else chosen(card, wanted)
    if one is None or not consent(f"Download the weights of {card.name}: {described(one)}?"):
        return need(card, wanted)
    return download(one)


def download(one: Weights) -> Path:
    """Fetch a set from the hub into its cache.

    Raises:
        InputError: no network, no such repository, or terms that were not accepted there.
    """
    try:
        from huggingface_hub import snapshot_download
    except ImportError:
        from excavatwin.errors import MissingExtraError

        raise MissingExtraError("downloads need huggingface_hub; run: pip install huggingface-hub") from None
    try:
        return Path(snapshot_download(one.repo, allow_patterns=list(one.files)))
    except Exception as error:  # the library raises a dozen kinds, all of them say that nothing came
        reason = next((line for line in str(error).splitlines() if line.strip()), type(error).__name__)
        terms = "; accept the terms on its page first, and log in" if one.gated else ""
        raise InputError(f"{one.repo} could not be downloaded ({reason.strip()}){terms}.") from None


def described(one: Weights) -> str:
    """``"facebook/VGGT-1B, 5.0 GB, CC-BY-NC-4.0, which restricts commercial use"``."""
    size = "size unknown" if math.isnan(one.size) else f"{one.size / 1e9:.1f} GB"
    terms = "" if one.commercial else ", which restricts commercial use" if one.licence != "unknown to us" else ""
    return f"{one.repo}, {size}, licence {one.licence}{terms}"


def fingerprint(card: Card, wanted: str = "") -> str:
    """What tells one set of weights from another: revision in the hub's cache, or names, sizes and times of files."""
    found = find(card, wanted)
    if found is None:
        return "no weights"
    if not is_path(wanted):
        return f"{chosen(card, wanted).repo}@{found.name}"
    files = sorted(file for file in found.rglob("*") if file.is_file()) if found.is_dir() else [found]
    return "; ".join(f"{file.name} {file.stat().st_size} {file.stat().st_mtime_ns}" for file in files)


def _whole(snapshot: Path) -> bool:
    """Whether a revision in the cache has tensors, and all parts of them where they are cut into several files."""
    if not any(file.suffix.lower() not in _TEXT and file.is_file() for file in snapshot.rglob("*")):
        return False
    for index in snapshot.glob("*.safetensors.index.json"):
        try:
            parts = set(json.loads(index.read_text())["weight_map"].values())
        except (OSError, ValueError, KeyError, AttributeError):
            return False
        if not all((snapshot / part).is_file() for part in parts):
            return False
    return True


def _cache() -> Path:
    """The hub's cache folder, by the rules of ``huggingface_hub``."""
    home = os.environ.get("HF_HOME") or Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache") / "huggingface"
    return Path(os.environ.get("HF_HUB_CACHE") or Path(home) / "hub").expanduser()
