"""Emulators of frozen models, seeded: geometry like VGGT's, evidence like YOLOE's and Mask2Former's."""

from __future__ import annotations

from excavatwin.simulation.emulators.alignment import true_similarity
from excavatwin.simulation.emulators.dense import Mask2FormerLike
from excavatwin.simulation.emulators.emulation import Emulated, emulate, emulate_views
from excavatwin.simulation.emulators.geometry import Exact, VggtLike
from excavatwin.simulation.emulators.sparse import YoloeLike

__all__ = [
    "Emulated",
    "Exact",
    "Mask2FormerLike",
    "VggtLike",
    "YoloeLike",
    "emulate",
    "emulate_views",
    "true_similarity",
]
