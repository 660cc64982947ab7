"""Any semantic network that was exported to ONNX, described by a small TOML file."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Bool, Float32

from excavatwin.backbones import extras
from excavatwin.backbones.cards import Card, Tried
from excavatwin.backbones.lattices import Fit
from excavatwin.backbones.protocols import Picture, Segmentation
from excavatwin.backbones.segmenters import sight
from excavatwin.backbones.segmenters.onnx_description import Description, read_description
from excavatwin.backbones.segmenters.onnx_session import checked, opened, probabilities
from excavatwin.errors import InputError
from excavatwin.vocabularies import digest, resolve


@dataclass(frozen=True)
class Onnx:
    """An ONNX model that gives classes for pixels: logits, probabilities or labels, of any layout and input size.

    The TOML file names the model, its classes and how it wants its pictures (``onnx_description.Description`` has the
    keys); what it says is checked against what the model declares and delivers. Probabilities become evidence on the
    grid of the output, then they are read at the pixel centres of the picture.
    """

    card: ClassVar[Card] = Card(
        name="onnx",
        kind="segmenter",
        summary="any semantic network exported to ONNX, described by a small TOML file",
        tried=Tried.REAL_CODE,
        modules=("onnxruntime",),
        install='pip install "excavatwin[onnx]"',
        argument="source",
        source="https://onnxruntime.ai",
    )

    source: str = ""
    """Path of the TOML file."""
    mapping: str = ""
    """Class mapping, above the one of the TOML file; chosen by the names of the classes when neither says one."""
    remap: Mapping[str, str] = field(default_factory=dict)
    """Class -> task class, above the TOML file and the mapping."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """What it runs on; ``auto`` is CUDA where onnxruntime has it."""

    def identity(self) -> str:
        """Version of onnxruntime, the TOML file, which model file, and the class mapping's content."""
        description = self._description()
        text = hashlib.blake2b(Path(self.source).expanduser().read_bytes(), digest_size=10).hexdigest()
        meaning = digest(self.mapping or description.mapping)
        return f"{extras.versions(self.card)}; {text}; {_stamp(description.model)}; {meaning}"

    def __call__(self, picture: Picture) -> Segmentation:
        """Evidence on the pixels of the picture.

        Raises:
            MissingExtraError: onnxruntime is not installed.
            InputError: a wrong TOML file, model, image, or output; the message names the likely mistake.
        """
        size = sight.checked(picture.image, self.card.name)
        extras.need(self.card)
        description = self._description()
        resolved = resolve(
            description.classes, self.mapping or description.mapping, {**description.remap, **self.remap}
        )
        session = checked(opened(description.model, _stamp(description.model), self.device), description)
        fit = description.fit(size, session.declared)
        tensor = description.tensor(fit.image(picture.image, description.fill), session.kind)
        p = probabilities(session.runtime.run([session.output], {session.input: tensor})[0], description)
        evidence = _back(resolved.evidence(p), fit)
        silent = _back(p @ resolved.no_surface.astype(np.float32)[:, None], fit)[..., 0] > 0.5
        seen = _seen(fit)
        evidence[silent | ~seen] = 0
        return Segmentation(evidence, silent & seen, (*resolved.doubts, *self._doubts(session.provider, seen)))

    def _doubts(self, provider: str, seen: Bool[np.ndarray, "H W"]) -> list[str]:
        told = []
        if not seen.all():
            told.append(f"its network sees {seen.mean():.0%} of the photo, the rest is cropped and has no evidence.")
        if self.device == "auto" and provider == "CPUExecutionProvider" and _has_cuda():
            told.append("CUDA could not be started; it ran on the CPU.")
        return told

    def _description(self) -> Description:
        if not self.source:
            raise InputError(
                "segmenter onnx needs the TOML file that describes the model; give --segmenter onnx:FILE.toml."
            )
        return read_description(Path(self.source).expanduser())


def _back(grid: Float32[np.ndarray, "h w n"], fit: Fit) -> Float32[np.ndarray, "H W n"]:
    return np.stack([sight.returned(grid[..., n], fit) for n in range(grid.shape[-1])], -1)


def _seen(fit: Fit) -> Bool[np.ndarray, "H W"]:
    """Pixels of the picture whose centres lie on the network's input."""
    (width, height), (x0, y0) = fit.size, fit.offset
    x = (np.arange(width) + 0.5) * (fit.resized[0] / width) + x0
    y = (np.arange(height) + 0.5) * (fit.resized[1] / height) + y0
    return ((y > 0) & (y < fit.shape[0]))[:, None] & ((x > 0) & (x < fit.shape[1]))


def _stamp(model: Path) -> str:
    """Which model file: name, size and time, of files with weights beside it, too."""
    files = sorted(file for file in model.parent.glob(f"{model.stem}*") if file.is_file() and file.suffix != ".toml")
    return "; ".join(f"{file.name} {file.stat().st_size} {file.stat().st_mtime_ns}" for file in files)


def _has_cuda() -> bool:
    import onnxruntime

    return "CUDAExecutionProvider" in onnxruntime.get_available_providers()
