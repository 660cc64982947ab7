"""The plan of a run: every stage with its parameters. The object *is* the configuration."""

from __future__ import annotations

from dataclasses import dataclass, field

from excavatwin.backbones.appearance import Appearance
from excavatwin.backbones.photogrammetry import Photogrammetry
from excavatwin.capture import VideoSampling
from excavatwin.mapper import Mapper


@dataclass(frozen=True)
class Plan:
    """From photos to the map: where the photos stand and what they see, what the pixels are, and the method."""

    video: VideoSampling = field(default_factory=VideoSampling)
    """How photos are chosen from a video; a folder of photos is taken as it is."""
    photogrammetry: Photogrammetry = field(default_factory=Photogrammetry)
    """Reconstructor: camera poses, then dense depth for every photo."""
    appearance: Appearance = field(default_factory=Appearance)
    """Segmenter: evidence for the task classes from colour and texture."""
    mapper: Mapper = field(default_factory=Mapper)
    """The method: geometry, semantics and projection to the grid."""
