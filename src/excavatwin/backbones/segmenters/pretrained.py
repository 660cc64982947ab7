"""Networks of Hugging Face's transformers: opened once from weights on this machine, and kept for the next picture."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from excavatwin.backbones.segmenters.preparation import read_json
from excavatwin.errors import InputError


@dataclass(frozen=True)
class Opened:
    """A network on its device, ready to be asked."""

    model: Any
    """The ``torch.nn.Module``, in evaluation mode and float32."""
    missing: frozenset[str]
    """Buffers that the weights do not carry."""


@lru_cache(maxsize=2)
def opened(kind: str, folder: Path, state: str, device: str) -> Opened:
    """The network of a class of transformers; the last two that were asked for stay in memory.

    Args:
        kind: class of transformers.
        folder: of the weights.
        state: fingerprint of the weights, so that changed files are read again.
        device: of torch.

    Raises:
        InputError: the weights are damaged, or of another network.
    """
    import torch
    import transformers

    with _quiet():
        try:
            model, told = getattr(transformers, kind).from_pretrained(
                folder, local_files_only=True, output_loading_info=True, dtype=torch.float32
            )
        except Exception as error:  # the library raises a dozen kinds
            raise InputError(
                f"the weights in {folder} cannot be read as {kind} ({first_line(error)}); fetch them again, or give "
                "others."
            ) from error
    missing = frozenset(told["missing_keys"])
    absent = sorted(missing & {name for name, _ in model.named_parameters()})
    absent += sorted(map(str, told["mismatched_keys"]))
    if absent:
        raise InputError(
            f"the weights in {folder} lack {len(absent)} of the parameters of {kind}, such as {absent[0]}: they are of "
            "another network; fetch them again, or give others."
        )
    return Opened(model.eval().requires_grad_(False).to(device), missing)


def configuration(folder: Path, kinds: Mapping[str, str], name: str) -> dict[str, Any]:
    """``config.json`` beside the weights, of one of the model types that a segmenter knows.

    Args:
        folder: of the weights.
        kinds: model type -> class of transformers.
        name: of the segmenter.

    Raises:
        InputError: there is none, or it is of another kind of network.
    """
    config = read_json(folder / "config.json")
    if config is None:
        raise InputError(f"{folder} has no config.json; give a folder as the hub has it, with config.json and weights.")
    found = str(config.get("model_type", ""))
    if found not in kinds:
        raise InputError(
            f"the weights in {folder} are of the model type {found!r}, but {name} needs {' or '.join(kinds)}; "
            "give other weights, or choose the segmenter that they belong to."
        )
    return config


def class_names(config: Mapping[str, Any]) -> tuple[str, ...]:
    """The classes by id from ``id2label``; empty when the weights do not name them (``LABEL_0``, ...)."""
    labels = config.get("id2label") or {}
    names = tuple(str(labels[key]) for key in sorted(labels, key=int))
    return () if all(re.fullmatch(r"LABEL_\d+", name) for name in names) else names


def first_line(error: BaseException) -> str:
    """What an error of a library says, in one line."""
    return next((line.strip().rstrip(".") for line in str(error).splitlines() if line.strip()), type(error).__name__)


@contextmanager
def _quiet() -> Iterator[None]:
    """Without the library's progress bars and reports: what matters in them is checked above."""
    from transformers.utils import logging

    level, bars = logging.get_verbosity(), logging.is_progress_bar_enabled()
    logging.set_verbosity_error()
    logging.disable_progress_bar()
    try:
        yield
    finally:
        logging.set_verbosity(level)
        if bars:
            logging.enable_progress_bar()
