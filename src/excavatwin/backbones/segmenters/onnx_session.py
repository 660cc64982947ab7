"""An ONNX model opened with onnxruntime, and what its output says about the classes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from excavatwin.backbones.segmenters.onnx_description import Description, Layout
from excavatwin.errors import InputError

_NUMBERS = ("tensor(float)", "tensor(float16)", "tensor(uint8)")


@dataclass(frozen=True)
class Session:
    """A model, ready to be asked."""

    runtime: Any
    """``onnxruntime.InferenceSession``."""
    input: str
    """Name of its input."""
    kind: str
    """Number type of the input."""
    declared: tuple[int | None, int | None]
    """(H, W) that it takes, None where it takes any [px]."""
    output: str
    """Name of the output that is used."""
    provider: str
    """What it really runs on."""


@lru_cache(maxsize=2)
def opened(model: Path, stamp: str, device: str) -> Any:
    """The runtime's session; the last two stay in memory.

    Args:
        model: the file.
        stamp: fingerprint of the file, so that a changed one is read again.
        device: ``auto`` (CUDA where onnxruntime has it), ``cpu`` or ``cuda``.

    Raises:
        InputError: no ONNX model, or no such device.
    """
    import onnxruntime

    there = onnxruntime.get_available_providers()
    if device == "cuda" and "CUDAExecutionProvider" not in there:
        raise InputError(
            f"onnxruntime {onnxruntime.__version__} has no CUDA; install onnxruntime-gpu, or give --onnx.device cpu."
        )
    cuda = ["CUDAExecutionProvider"] if device != "cpu" and "CUDAExecutionProvider" in there else []
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    try:
        session = onnxruntime.InferenceSession(str(model), options, providers=[*cuda, "CPUExecutionProvider"])
    except Exception as error:  # the library raises a dozen kinds
        reason = next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)
        raise InputError(f"{model} cannot be opened as an ONNX model ({reason}); export it again.") from None
    if device == "cuda" and session.get_providers()[0] != "CUDAExecutionProvider":
        raise InputError(
            "onnxruntime could not start CUDA and would run on the CPU; mend CUDA, or give --onnx.device cpu."
        )
    return session


def checked(runtime: Any, description: Description) -> Session:
    """The session with its input and output, as the description says.

    Raises:
        InputError: the description does not fit what the model declares.
    """
    model = description.model.name
    one = _named(runtime.get_inputs(), description.input, "input", model)
    shape = [size if isinstance(size, int) else None for size in one.shape]
    if one.type not in _NUMBERS or len(shape) != 4:
        raise InputError(
            f"{model} declares the input {one.name} {one.shape} {one.type}; expected 4 axes of float or uint8."
        )
    if shape[0] not in (None, 1):
        raise InputError(f"{model} takes batches of {shape[0]} pictures; export it with a batch of 1 or of any size.")
    first, last = shape[1] in (None, 3), shape[3] in (None, 3)
    if not (first if description.layout == "NCHW" else last):
        other: Layout = "NHWC" if description.layout == "NCHW" else "NCHW"
        hint = f'write layout = "{other}"' if (last if other == "NHWC" else first) else "it needs 3 colour channels"
        raise InputError(
            f"{model} declares the input {one.shape}, which is not {description.layout}; {hint} in its TOML."
        )
    declared = (shape[2], shape[3]) if description.layout == "NCHW" else (shape[1], shape[2])
    output = _named(runtime.get_outputs(), description.output, "output", model)
    return Session(runtime, one.name, one.type, declared, output.name, runtime.get_providers()[0])


def _named(there: list[Any], wanted: str, what: str, model: str) -> Any:
    listed = ", ".join(f"{one.name} {one.shape}" for one in there)
    if wanted:
        found = next((one for one in there if one.name == wanted), None)
        if found is None:
            raise InputError(f"{model} has no {what} {wanted!r}; it has: {listed}.")
        return found
    if len(there) != 1:
        raise InputError(f'{model} has {len(there)} {what}s; write {what} = "NAME" of one of: {listed}.')
    return there[0]


def probabilities(raw: np.ndarray, description: Description) -> Float32[np.ndarray, "h w V"]:
    """Probabilities of the classes on the grid of the model's output.

    Raises:
        InputError: shape or values are not what the description says; the message names the likely mistake.
    """
    model, V = description.model.name, len(description.classes)
    if not np.isfinite(raw).all():
        raise InputError(
            f"{model} gives values that are not finite; check its export, and scale, mean and std in its TOML."
        )
    if description.kind == "labels":
        return _of_labels(raw, description)
    p = _channels_last(raw, description).astype(np.float32)
    low, high = float(p.min()), float(p.max())
    sums = p.sum(-1)
    if description.kind == "probabilities":
        if low < -1e-3 or sums.max() > 1 + 1e-2:
            raise InputError(
                f"{model} gives values of {low:.3g} to {high:.3g} with sums up to {sums.max():.3g}, not probabilities; "
                'write kind = "logits" (or "sigmoid") in its TOML.'
            )
        return np.clip(p, 0, 1)
    if V > 1 and low >= 0 and np.abs(sums - 1).max() < 1e-3:
        raise InputError(f'the values of {model} are probabilities already; write kind = "probabilities" in its TOML.')
    if description.kind == "sigmoid":
        each = 1 / (1 + np.exp(-np.clip(p, -60, 60)))
        return np.asarray(each / np.maximum(each.sum(-1, keepdims=True), 1), np.float32)
    if V == 1:
        raise InputError(
            f'one channel of logits is always certain by softmax; write kind = "sigmoid" in the TOML of {model}.'
        )
    p = np.exp(p - p.max(-1, keepdims=True))
    return np.asarray(p / p.sum(-1, keepdims=True), np.float32)


def _channels_last(raw: np.ndarray, description: Description) -> np.ndarray:
    model, V = description.model.name, len(description.classes)
    if raw.ndim == 4 and raw.shape[0] == 1:
        raw = raw[0]
    if raw.ndim != 3:
        raise InputError(f"{model} gives an output {raw.shape}; expected (1, classes, H, W) or (1, H, W, classes).")
    layout = description.output_layout or description.layout
    axis, other = (0, 2) if layout == "NCHW" else (2, 0)
    if raw.shape[axis] == V:
        return raw.transpose(1, 2, 0) if layout == "NCHW" else raw
    if raw.shape[other] == V:
        turned = "NHWC" if layout == "NCHW" else "NCHW"
        raise InputError(f'{model} has its {V} classes on another axis; write output_layout = "{turned}" in its TOML.')
    more = "; is there a background class? Name it, too" if raw.shape[axis] == V + 1 else ""
    raise InputError(f"{model} gives {raw.shape[axis]} channels, but its TOML names {V} classes{more}.")


def _of_labels(raw: np.ndarray, description: Description) -> Float32[np.ndarray, "h w V"]:
    """One-hot, so that borders between labels are shared when the grid is resampled; 255 is void."""
    model = description.model.name
    label = np.squeeze(raw)
    if label.ndim != 2:
        raise InputError(f'{model} gives an output {raw.shape}, no label image; write kind = "logits" in its TOML.')
    if np.any(label != np.round(label)):
        raise InputError(f'{model} gives broken numbers, no labels; write kind = "sigmoid" or "logits" in its TOML.')
    label = label.astype(np.int64)
    strange = np.setdiff1d(label, [*description.ids, 255])
    if len(strange):
        ids = np.asarray(description.ids)
        from_one = strange.tolist() == [ids.max() + 1] and ids.min() == 0 and not (label == 0).any()
        hint = "; its labels count from 1: name a first class 'void' and map it to nothing" if from_one else ""
        raise InputError(f"{model} gives the label {strange[0]}, which none of the {len(ids)} classes has{hint}.")
    return (label[..., None] == np.asarray(description.ids)).astype(np.float32)
