"""From photos to observations through a feed-forward network: select, chunk, align, store, validate."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from excavatwin.scene.observations import Observations
from excavatwin.scene.photo import Photo
from excavatwin.scene.progress import Progress

if TYPE_CHECKING:
    from excavatwin.backbones.sequence.feed_forward import FeedForward


def reconstruct(model: FeedForward, photos: Sequence[Photo], progress: Progress, scratch: Path) -> Observations:
    """Observations of the photos, in one frame."""
    raise NotImplementedError
