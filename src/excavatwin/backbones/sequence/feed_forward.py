"""What all feed-forward reconstructors share: parameters, and the way from photos to observations."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from excavatwin.backbones.cards import Card
from excavatwin.backbones.device import Device
from excavatwin.backbones.lattices import Mode
from excavatwin.backbones.sequence.chunking import Chunking
from excavatwin.backbones.sequence.network import Network
from excavatwin.backbones.sequence.selection import Selection
from excavatwin.scene.observations import Observations
from excavatwin.scene.photo import Photo
from excavatwin.scene.progress import Progress


@dataclass(frozen=True)
class FeedForward(ABC):
    """Base of the adapters: a subclass says how its network is opened and how much memory it takes."""

    card: ClassVar[Card]
    confidence: ClassVar[str]
    """Kind of the confidence, for provenance: ``1 + exp``, ``sigmoid``, ..."""
    patch: ClassVar[int] = 14
    """Sides of the lattice are multiples of this [px]."""

    weights: str = ""
    """Name on the hub, or path of a file or folder; empty for the first set on the card."""
    lattice: int = 518
    """Longer side of the lattice [px]."""
    mode: Mode = "crop"
    """How photos of another shape come onto the lattice."""
    device: Device = field(default_factory=Device)
    """What the network runs on."""
    selection: Selection = field(default_factory=Selection)
    """Which photos are used."""
    chunking: Chunking = field(default_factory=Chunking)
    """How many photos the network sees at once, and how the pieces are put together."""

    @abstractmethod
    def open(self) -> Network:
        """Load the network onto the device.

        Raises:
            MissingExtraError: its library is not installed.
            InputError: its weights are not here.
        """

    @abstractmethod
    def memory(self, images: int, height: int, width: int) -> float:
        """Estimated peak memory of the network on its device for so many images at once [bytes]."""

    def identity(self) -> str:
        """Versions of the libraries, and which weights are used."""
        from excavatwin.backbones.extras import versions
        from excavatwin.backbones.weights import fingerprint

        return f"{versions(self.card)}; {fingerprint(self.card, self.weights)}"

    def __call__(self, photos: Sequence[Photo], progress: Progress, scratch: Path) -> Observations:
        """Observations without evidence; views may be memory-mapped files in ``scratch``."""
        from excavatwin.backbones.sequence.drive import reconstruct

        return reconstruct(self, photos, progress, scratch)
