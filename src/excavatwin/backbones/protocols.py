"""What every backbone is to the rest of ExcavaTwin: two protocols of a few lines, and the nouns they speak in.

A plugin's class needs nothing else; see docs/backbones.md for a worked example.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float32, UInt8

from excavatwin.backbones.cards import Card
from excavatwin.scene.observations import Lattice, Observations
from excavatwin.scene.photo import Photo
from excavatwin.scene.progress import Progress


@dataclass(frozen=True)
class Picture:
    """One view as a segmenter is given it."""

    image: UInt8[np.ndarray, "H W 3"]
    """RGB (sRGB) on the lattice of the view: evidence is wanted for exactly these pixels."""
    name: str = ""
    """File name of the photo."""
    lattice: Lattice | None = None
    """Where the lattice lies in the photo; None when the image *is* the photo."""
    path: Path | None = None
    """The photo itself, for segmenters that look at it more closely or have results of their own for it."""


@dataclass(frozen=True)
class Segmentation:
    """What a segmenter says about one picture."""

    evidence: Float32[np.ndarray, "H W K"]
    """o_s: evidence for the task classes 1..5, each in [0, 1], their sum at most 1; what is missing is doubt."""
    no_surface: Bool[np.ndarray, "H W"]
    """Sky or water: no solid surface can be reconstructed here, whatever a matcher finds."""
    doubts: tuple[str, ...] = ()
    """What the user should know, without the photo's name: equal sentences of several photos are counted."""


class Backbone(Protocol):
    """What reconstructors and segmenters have in common: a frozen dataclass of parameters with a card."""

    card: ClassVar[Card]
    """Name, licence, weights, what to install: what `excavatwin backbones` prints."""

    def identity(self) -> str:
        """What decides the result besides the parameters: versions of libraries, the revision of the weights."""
        ...


@runtime_checkable
class Segmenter(Backbone, Protocol):
    """Per-pixel evidence for the task classes, one picture at a time."""

    def __call__(self, picture: Picture) -> Segmentation:
        """Evidence on the pixels of the picture."""
        ...


@runtime_checkable
class Reconstructor(Backbone, Protocol):
    """Photos to world points: for every view a point map, its confidence, pose and intrinsics."""

    def __call__(self, photos: Sequence[Photo], progress: Progress, scratch: Path) -> Observations:
        """Observations without evidence (all zero), on lattices that say where they lie in their photos.

        Args:
            photos: at least one, in the order in which they were taken.
            progress: told how far the work is.
            scratch: an existing empty folder that outlives the observations: views of long sequences may be
                memory-mapped files in it.
        """
        ...


@runtime_checkable
class StagedReconstructor(Protocol):
    """A reconstructor in two steps, each of which is kept: new parameters of the second do not repeat the first."""

    @property
    def placing(self) -> Any:
        """Parameters on which the first step depends."""
        ...

    def place(self, photos: Sequence[Photo], progress: Progress) -> Any:
        """Poses, lens, vertical and scale."""
        ...

    def densify(self, placement: Any, photos: Sequence[Photo], progress: Progress) -> Observations:
        """A world point for every pixel."""
        ...

    def save_placement(self, placement: Any, folder: Path) -> object:
        """Write the result of the first step into an existing folder."""
        ...

    def load_placement(self, folder: Path) -> Any:
        """Read what ``save_placement`` wrote."""
        ...
