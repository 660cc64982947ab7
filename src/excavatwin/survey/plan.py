"""The plan of a run: every stage with its parameters. The object *is* the configuration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from excavatwin.backbones.appearance import Appearance
from excavatwin.backbones.merging import Merging
from excavatwin.backbones.photogrammetry import Photogrammetry
from excavatwin.backbones.protocols import Reconstructor, Segmenter
from excavatwin.capture import VideoSampling
from excavatwin.mapper import Mapper


@dataclass(frozen=True)
class Plan:
    """From photos to the map: where the photos stand and what they see, what the pixels are, and the method."""

    video: VideoSampling = field(default_factory=VideoSampling)
    """How photos are chosen from a video; a folder of photos is taken as it is."""
    reconstructor: Reconstructor = field(default_factory=Photogrammetry)
    """Camera poses and a world point for every pixel."""
    segmenters: Mapping[str, Segmenter] = field(default_factory=lambda: {"appearance": Appearance()})
    """Evidence for the task classes, by the name under which each one's parameters are set."""
    merging: Merging = field(default_factory=Merging)
    """How the evidence of several segmenters becomes one."""
    mapper: Mapper = field(default_factory=Mapper)
    """The method: geometry, semantics and projection to the grid."""
