"""What YOLOE is asked for, as embeddings: from words, from a file of embeddings, or from boxes in reference photos."""

from __future__ import annotations

import importlib
import tomllib
import warnings
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, UInt8

from excavatwin.backbones import lattices
from excavatwin.backbones.segmenters import sight, yoloe_network
from excavatwin.backbones.segmenters.prompts import KEYS, Prompts, votes_for
from excavatwin.errors import InputError, MissingExtraError

#: ``text_model`` of an architecture -> its file, as Ultralytics names it.
ENCODERS = {"mobileclip:blt": "mobileclip_blt.ts", "mobileclip2:b": "mobileclip2_b.ts"}
#: Where Ultralytics publishes them.
RELEASES = "https://github.com/ultralytics/assets/releases"


@lru_cache(maxsize=4)
def worded(network: Any, weights: Path, texts: tuple[str, ...], encoder: str, stamp: str) -> Any:
    """Embeddings (1, P, D) of words, by the text encoder that the network was trained with.

    Args:
        network: from ``yoloe_network.opened``.
        weights: its file or folder; the encoder is looked for beside it.
        texts: P prompts.
        encoder: path of the TorchScript file; empty to look beside the weights.
        stamp: fingerprint of the encoder, so that another file is read anew.

    Raises:
        InputError: the encoder is not here, or is not one.
        MissingExtraError: its tokenizer is not installed.
    """
    import torch

    named = ENCODERS.get(str(network.yaml.get("text_model", "mobileclip:blt")), "mobileclip_blt.ts")
    beside = (weights if weights.is_dir() else weights.parent) / named
    file = Path(encoder).expanduser() if encoder else beside
    if not file.is_file():
        raise InputError(
            f"text prompts need YOLOE's text encoder, but there is no {file}; download {named} from {RELEASES} "
            "and put it there (or give --yoloe.text-encoder PATH), or give --yoloe.embeddings FILE.npz that "
            "ultralytics' YOLOE.save_prompt_embeddings wrote for these prompts."
        )
    tokens = _tokens(texts)
    try:
        with warnings.catch_warnings():  # Ultralytics publishes the encoder in this form only, which torch deprecates
            warnings.filterwarnings("ignore", r"`torch\.jit", FutureWarning)
            features = torch.jit.load(str(file), map_location="cpu").eval()(tokens)
    except RuntimeError as error:
        raise InputError(f"{file} is not a TorchScript text encoder; download {named} from {RELEASES}.") from error
    head = yoloe_network.head(network)
    return head.get_tpe(features.detach().float()[None].to(next(network.parameters()).device))


def _tokens(texts: tuple[str, ...]) -> Any:
    """(P, 77) ids of CLIP's byte-pair vocabulary; open_clip ships that of OpenAI's CLIP, which is not on PyPI."""
    try:
        made = importlib.import_module("open_clip.tokenizer").SimpleTokenizer(context_length=77)
    except ImportError:
        raise MissingExtraError(
            'text prompts of yoloe need open_clip, which is not installed; run: pip install "excavatwin[yoloe]"'
        ) from None
    return made(list(texts))


def filed(network: Any, weights: Path, texts: tuple[str, ...], file: Path) -> Any:
    """Embeddings (1, P, D) of words from an .npz file of ``YOLOE.save_prompt_embeddings``; no text encoder is needed.

    Raises:
        InputError: not such a file, one for another network, or prompts that it does not hold.
    """
    import torch

    try:
        with np.load(file, allow_pickle=False) as arrays:
            found = np.asarray(arrays["embeddings"], np.float32)
            names = [str(name) for name in arrays["names"]]
            model = str(arrays["model"]) if "model" in arrays else ""
    except (OSError, ValueError, KeyError) as error:
        raise InputError(
            f"{file} is not a file of prompt embeddings ({error}); write one with ultralytics' "
            "YOLOE.save_prompt_embeddings."
        ) from None
    own = model_name(weights, network)
    if model and model != own:
        raise InputError(
            f"embeddings {file} were made for {model}, the weights are {own}; make them with these weights."
        )
    found = found.reshape(-1, found.shape[-1])
    size = yoloe_network.head(network).embed
    if found.shape != (len(names), size) or not np.isfinite(found).all():
        raise InputError(f"embeddings {file} are {found.shape} for {len(names)} names; expected finite (P, {size}).")
    rows = {name: row for row, name in enumerate(names)}
    absent = [text for text in texts if text not in rows]
    if absent:
        raise InputError(
            f"embeddings {file} lack the prompts {', '.join(map(repr, absent))}; make them anew, or edit the prompts."
        )
    chosen = found[[rows[text] for text in texts]]
    return torch.from_numpy(chosen)[None].to(next(network.parameters()).device)


def model_name(weights: Path, network: Any) -> str:
    """By which Ultralytics binds embeddings to a network: stem of its file, without -seg."""
    stem = weights.stem if weights.suffix == ".pt" else Path(str(network.yaml.get("yaml_file", weights.name))).stem
    return stem.removesuffix("-seg")


@lru_cache(maxsize=4)
def referenced(network: Any, file: Path, stamp: str, long_side: int) -> tuple[Prompts, Any]:
    """Prompts and embeddings (1, P, D) of boxes in reference photos: one for each class in each photo.

    The TOML file lists photos with boxes x0, y0, x1, y1 [px of the photo as displayed] by task class:

        [[reference]]
        image = "DJI_0042.JPG"            # relative to this file
        excavator = [[812, 430, 1460, 990]]
        obstacle = [[100, 650, 160, 720], [300, 610, 350, 690]]

    Args:
        network: from ``yoloe_network.opened``.
        file: the TOML file.
        stamp: fingerprint of it and its photos.
        long_side: of what the network sees [px].

    Raises:
        InputError: the file breaks this form, a photo cannot be read, a box lies outside or is too small to be seen.
    """
    import torch
    from ultralytics.data.augment import LoadVisualPrompt

    device = next(network.parameters()).device
    texts, votes, parts = [], [], []
    for path, marked in read_references(file):
        image = _image(path)
        fit = sight.letterbox((image.shape[1], image.shape[0]), long_side, 32)
        boxes = [sight.to_input(some, fit) for some in marked.values()]
        owner = np.repeat(np.arange(len(marked)), [len(some) for some in boxes])
        masks = LoadVisualPrompt().get_visuals(owner, fit.shape, np.concatenate(boxes).astype(np.float32))
        for key, mask, some in zip(marked, masks, marked.values(), strict=True):
            if not mask.any() or (some < 0).any() or (some[:, 2:] > [image.shape[1], image.shape[0]]).any():
                raise InputError(
                    f"references {file}: boxes of {key} lie outside {path.name} or are too small to be seen."
                )
            texts.append(f"{key} in {path.name}")
            votes.append(votes_for(key))
        pixels = lattices.normalised(sight.shown(image, fit, 114, smooth=False))
        parts.append(network(torch.from_numpy(pixels)[None].to(device), vpe=masks[None].to(device), return_vpe=True))
    return Prompts(f"references {file.name}", tuple(texts), np.stack(votes)), torch.cat(parts, 1)


def read_references(file: Path) -> list[tuple[Path, dict[str, Float64[np.ndarray, "n 4"]]]]:
    """Photos with boxes by task class, see ``referenced``."""
    form = '[[reference]] with image = "FILE" and e.g. excavator = [[x0, y0, x1, y1]]'
    try:
        table = tomllib.loads(file.read_text("utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"references {file} cannot be read ({error}); write a TOML file of {form}.") from None
    found = []
    for entry in table.get("reference", []):
        marked = {}
        for key, value in entry.items():
            if key == "image":
                continue
            if key not in KEYS:
                raise InputError(f"references {file}: {key!r} is not a task class; there are: {', '.join(KEYS)}.")
            marked[key] = _boxes(value, key, file)
        if not isinstance(entry.get("image"), str) or not marked:
            raise InputError(f"references {file}: each entry needs a photo and boxes; write {form}.")
        found.append((file.parent / entry["image"], marked))
    if not found:
        raise InputError(f"references {file} hold no photo; write {form}.")
    return found


def _boxes(value: Any, key: str, file: Path) -> Float64[np.ndarray, "n 4"]:
    try:
        boxes = np.array(value, float)
    except (TypeError, ValueError):
        boxes = np.empty(0)
    if boxes.ndim != 2 or boxes.shape[1] != 4 or not len(boxes) or not (boxes[:, :2] < boxes[:, 2:]).all():
        raise InputError(f"references {file}: {key} must be a list of boxes [x0, y0, x1, y1] with x0 < x1 and y0 < y1.")
    return boxes


def _image(path: Path) -> UInt8[np.ndarray, "H W 3"]:
    from PIL import Image, ImageOps

    try:
        with Image.open(path) as image:
            return np.array(ImageOps.exif_transpose(image).convert("RGB"))
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError(f"reference photo {path} cannot be read ({error}); give another.") from None
