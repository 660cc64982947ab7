"""Networks and tokenizers of text-prompted segmenters from a folder: loaded once, complete, never downloaded."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

from excavatwin.backbones import weights
from excavatwin.backbones.cards import Card
from excavatwin.backbones.segmenters.pretrained import first_line, opened
from excavatwin.errors import InputError


def folder_of(card: Card, wanted: str, field: str = "weights") -> Path:
    """The folder of a network's weights, with its configuration.

    Args:
        card: of the backbone; one of its sets may be named by ``wanted``.
        wanted: name on the hub, or path; empty for the first set.
        field: parameter of the backbone in which the user gives the path.

    Raises:
        InputError: the weights are not here, or the path is not a folder with a configuration.
    """
    found = weights.need(card, wanted) if field == "weights" else weights.find(card, wanted)
    if found is None:
        one = weights.described(weights.chosen(card, wanted))
        repo = weights.chosen(card, wanted).repo
        raise InputError(
            f"{card.name} also needs weights for its masks ({one}), which are not on this machine; run: "
            f"hf download {repo}, or give --{card.name}.{field.replace('_', '-')} PATH."
        )
    if not (found / "config.json").is_file():
        raise InputError(
            f"weights of {card.name}: {found} holds no config.json; give the folder that the hub's files lie in."
        )
    return found


def network(kind: str, folder: Path, stamp: str, device: Any) -> Any:
    """A network in evaluation mode on its device, float32; kept by ``pretrained.opened``.

    Args:
        kind: class of ``transformers``, ``"Sam3Model"``.
        folder: with config.json and the weights.
        stamp: fingerprint of the folder's content, so that changed weights are loaded anew.
        device: ``torch.device``.

    Raises:
        InputError: the weights are damaged, or do not fill this network: the rest would be random.
    """
    found = opened(kind, folder, stamp, str(device))
    if found.missing:
        absent = sorted(found.missing)
        raise InputError(
            f"the weights in {folder} lack {len(absent)} of the buffers of {kind}, such as {absent[0]}; give weights "
            "of this kind of network."
        )
    return found.model


@lru_cache(maxsize=3)
def tokenizer(folder: Path, stamp: str) -> Any:
    """The tokenizer that lies beside the weights.

    Raises:
        InputError: there is none.
    """
    from transformers import AutoTokenizer

    if not any((folder / name).is_file() for name in ("tokenizer.json", "vocab.json", "vocab.txt")):
        # transformers would go on with an empty vocabulary, and every prompt would mean the same
        raise InputError(f"{folder} holds no tokenizer; download it again, with its *.json and *.txt files.")
    try:
        return AutoTokenizer.from_pretrained(folder, local_files_only=True)
    except Exception as error:  # whatever the library raises, there is no tokenizer
        raise InputError(
            f"{folder} holds a tokenizer that cannot be read ({first_line(error)}); download it again."
        ) from error
