"""Weights of reconstruction networks, from a file or a folder into a model: complete, or refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from excavatwin.backbones.cards import Card
from excavatwin.backbones.device import Device
from excavatwin.errors import InputError

_SUFFIXES = (".safetensors", ".pt", ".pth", ".bin")


def checkpoint(place: Path, card: Card) -> Path:
    """The file that holds the tensors.

    Args:
        place: the file itself, or a folder as the hub keeps it.

    Raises:
        InputError: the folder holds none, or several and none of them is ``model.*``.
    """
    if place.is_file():
        return place
    for suffix in _SUFFIXES:
        there = sorted(place.glob(f"*{suffix}"))
        named = [file for file in there if file.stem == "model"] or there
        if len(named) == 1:
            return named[0]
        if named:
            names = ", ".join(file.name for file in named)
            raise InputError(f"weights of {card.name}: {place} holds several ({names}); give one of these files.")
    raise InputError(
        f"weights of {card.name}: {place} holds no {', '.join('*' + suffix for suffix in _SUFFIXES)}; give the folder "
        "or file with the tensors."
    )


def settings(place: Path) -> dict[str, Any]:
    """What ``config.json`` beside the tensors says; empty when there is none."""
    file = (place if place.is_dir() else place.parent) / "config.json"
    if not file.is_file():
        return {}
    try:
        found = json.loads(file.read_text())
    except ValueError as error:
        raise InputError(f"{file} is no JSON ({error}); download the weights again.") from None
    return found if isinstance(found, dict) else {}


def build(kind: Callable[..., Any], chosen: dict[str, Any], card: Card) -> Any:
    """A model with the settings of its weights.

    Raises:
        InputError: the installed code does not know these settings.
    """
    try:
        return kind(**chosen)
    except TypeError as error:
        raise InputError(
            f"the installed code of {card.name} does not take the settings of these weights ({error}); update it: "
            f"{card.install}"
        ) from error


def tensors(file: Path, card: Card) -> dict[str, Any]:
    """The tensors of a checkpoint, in main memory. Executes nothing that the file may hold.

    Raises:
        InputError: it cannot be read.
    """
    import torch

    try:
        if file.suffix == ".safetensors":
            from safetensors.torch import load_file

            return load_file(file)
        found = torch.load(file, map_location="cpu", weights_only=True)
    except Exception as error:  # pickle, zip and safetensors each raise their own kinds
        if isinstance(error, MemoryError):
            raise
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"weights of {card.name}: {file} cannot be read ({reason}); download them again.") from None
    for wrapper in ("model", "state_dict"):
        if isinstance(found, dict) and isinstance(found.get(wrapper), dict):
            found = found[wrapper]
    return found


def fill(model: Any, state: dict[str, Any], file: Path, card: Card) -> None:
    """Put the tensors into the model. What the model does not have (a head that was left out) is skipped.

    Raises:
        InputError: one of the model's tensors is missing or of another shape, so these are another model's weights.
    """
    try:
        absent = list(model.load_state_dict(state, strict=False).missing_keys)
    except RuntimeError as error:
        lines = [line.strip() for line in str(error).splitlines() if "size mismatch" in line]
        if not lines:
            raise
        raise InputError(
            f"weights of {card.name}: {file} belongs to another model ({lines[0]}); give weights of {card.name}."
        ) from None
    held = model.state_dict()
    # Checkpoints keep one name of a tensor that a model holds under several.
    given = {held[name].data_ptr() for name in state if name in held}
    absent = [name for name in absent if held[name].data_ptr() not in given]
    if absent:
        raise InputError(
            f"weights of {card.name}: {file} lacks {len(absent)} of the network's tensors, such as {absent[0]}; it "
            f"belongs to another model or is incomplete: give weights of {card.name}."
        )


def ready(model: Any, device: Device) -> Any:
    """The model on its device, frozen."""
    return model.eval().requires_grad_(False).to(device.torch())
