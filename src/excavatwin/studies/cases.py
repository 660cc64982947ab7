"""Cases: observations with the truth that a study scores them by."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, UInt8

from excavatwin.geometry.scale import Reference
from excavatwin.scene.observations import Observations
from excavatwin.scene.taxonomy import NOT_OBSERVED, K
from excavatwin.scene.truth import Truth
from excavatwin.simulation import RenderedView, orbit, random_site, site_truth
from excavatwin.simulation.emulators import Mask2FormerLike, VggtLike, YoloeLike, emulate

TUNING_SEEDS = tuple(range(100, 112))
"""Sites on which parameters were chosen."""
HELD_OUT_SEEDS = tuple(range(200, 212))
"""Sites that nobody looked at before the figures were taken."""
SEGMENTERS = {"yoloe": YoloeLike, "mask2former": Mask2FormerLike}


@dataclass(frozen=True, eq=False)
class Case:
    """One scene as the frozen models see it, and what is true about it."""

    name: str
    observations: Observations
    labels: tuple[UInt8[np.ndarray, "H W"], ...]
    """True task class of every pixel of every view; 255 where it is not scored."""
    truth: Truth | None = None
    """Rasters and objects, frame M."""
    T_M_R: Float64[np.ndarray, "4 4"] | None = None
    """True similarity from the reconstruction to frame M."""
    references: tuple[Reference, ...] = ()
    """Known lengths on one object, which gives the scale and is never scored."""
    reference_object: int = 0
    """Id of that object; 0 = none."""


def scored_labels(view: RenderedView, extent: float) -> UInt8[np.ndarray, "H W"]:
    """True classes inside the square of edge ``extent`` about the origin; 255 elsewhere and in the sky."""
    with np.errstate(invalid="ignore"):
        inside = (np.abs(view.points[..., :2]) <= extent / 2).all(axis=-1)
    return np.where(inside & (view.label >= 1) & (view.label <= K), view.label, NOT_OBSERVED).astype(np.uint8)


def simulated_case(seed: int, segmenter: str, views: int = 12, geometry: VggtLike | None = None) -> Case:
    """A random site on an orbit, with VGGT-like geometry and an emulated segmenter."""
    site = random_site(seed)
    cameras = orbit(views, width=518, aspect=392 / 518, seed=seed)
    seen = emulate(site, cameras, geometry or VggtLike(), SEGMENTERS[segmenter](), seed)
    labels = tuple(scored_labels(view, site.extent) for view in seen.views)
    return Case(f"site {seed}", seen.observations, labels, site_truth(site), seen.T_M_R)


def simulated_cases(seeds: Sequence[int], segmenter: str, views: int = 12) -> Iterator[Case]:
    """One case a seed, made when it is asked for."""
    for seed in seeds:
        yield simulated_case(seed, segmenter, views)
