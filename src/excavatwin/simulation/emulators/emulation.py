"""Emulated observations: what frozen models would deliver on photos of a simulated site."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from jaxtyping import Float32, Float64

from excavatwin.scene.observations import Observations
from excavatwin.simulation.camera import Camera
from excavatwin.simulation.emulators.alignment import true_similarity
from excavatwin.simulation.render import RenderedView, render_view
from excavatwin.simulation.site import DigSite


class GeometryModel(Protocol):
    """A multi-view reconstructor: ``Exact``, ``VggtLike``."""

    def __call__(self, views: Sequence[RenderedView], cameras: Sequence[Camera], seed: int) -> Observations:
        """Observations with zero evidence."""


class Segmenter(Protocol):
    """A single-view segmenter: ``YoloeLike``, ``Mask2FormerLike``."""

    def __call__(
        self, views: Sequence[RenderedView], cameras: Sequence[Camera], seed: int
    ) -> list[Float32[np.ndarray, "H W K"]]:
        """Evidence of every view, in [0, 1]; zero in the sky."""


@dataclass(frozen=True, eq=False)
class Emulated:
    """Observations of a site, and the truth that they are judged by."""

    observations: Observations
    views: tuple[RenderedView, ...]
    """The true views."""
    cameras: tuple[Camera, ...]
    """The true cameras, frame M."""
    T_M_R: Float64[np.ndarray, "4 4"]
    """The true similarity from the observations' frame into the map's [m per su]; for oracles only."""


def emulate(
    site: DigSite,
    cameras: Sequence[Camera],
    geometry: GeometryModel,
    segmenter: Segmenter,
    seed: int,
    samples: int = 1,
) -> Emulated:
    """Photograph a site and let emulated models loose on it.

    Args:
        site: the site.
        cameras: of the photos; the lattice of the observations is theirs.
        geometry: gives points, poses, confidence.
        segmenter: gives evidence.
        seed: of all errors; the same seed, site, cameras and ``samples`` give the same observations.
        samples: rays per pixel along each axis for the colours; 0 renders the truth only and leaves images out, which
            suits segmenters whose errors do not follow looks (``look=0``).
    """
    return emulate_views([render_view(site, camera, samples=samples) for camera in cameras], cameras, geometry,
                         segmenter, seed, coloured=samples > 0)  # fmt: skip


def emulate_views(
    views: Sequence[RenderedView],
    cameras: Sequence[Camera],
    geometry: GeometryModel,
    segmenter: Segmenter,
    seed: int,
    coloured: bool = True,
) -> Emulated:
    """As ``emulate``, from views that are rendered already: by ours or by any other renderer."""
    observations = geometry(views, cameras, seed)
    evidence = segmenter(views, cameras, seed)
    filled = tuple(
        replace(view, evidence=e, image=true.image if coloured else None)
        for view, e, true in zip(observations.views, evidence, views, strict=True)
    )
    source = {**observations.source, "segmenter": f"emulator: {segmenter!r}"}
    observations = replace(observations, views=filled, source=source)
    return Emulated(observations, tuple(views), tuple(cameras), true_similarity(observations, views))
