"""Cases: observations with the truth that a study scores them by."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float64, UInt8

from excavatwin.geometry.scale import Reference
from excavatwin.scene.observations import Observations
from excavatwin.scene.taxonomy import NOT_OBSERVED, TASK_CLASSES, K
from excavatwin.scene.truth import Truth
from excavatwin.simulation import Camera, RenderedView, orbit, random_site, render_view, site_truth
from excavatwin.simulation.emulators import Exact, Mask2FormerLike, VggtLike, YoloeLike, emulate_views
from excavatwin.studies.references import reference_object

TUNING_SEEDS = tuple(range(100, 120))
"""Sites on which parameters were chosen."""
HELD_OUT_SEEDS = tuple(range(200, 220))
"""Sites that nobody looked at before the figures were taken."""
SEGMENTERS = {"yoloe": YoloeLike, "mask2former": Mask2FormerLike}
"""Emulated backbones by name."""
LATTICE = (518, 392)
"""Width and height on which VGGT sees a photo [px]."""
VIEWS = 12
"""Photos of a simulated site."""


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
    exact: Observations | None = None
    """The same evidence on true points under true cameras, frame M: for the oracle."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A random site and the true views of it."""

    cameras: tuple[Camera, ...]
    views: tuple[RenderedView, ...]
    labels: tuple[UInt8[np.ndarray, "H W"], ...]
    """True task classes that are scored."""
    truth: Truth


def scored_labels(view: RenderedView, extent: float) -> UInt8[np.ndarray, "H W"]:
    """True classes inside the square of edge ``extent`` about the origin; 255 elsewhere and in the sky."""
    with np.errstate(invalid="ignore"):
        inside = (np.abs(view.points[..., :2]) <= extent / 2).all(axis=-1)
    return np.where(inside & (view.label >= 1) & (view.label <= K), view.label, NOT_OBSERVED).astype(np.uint8)


@lru_cache(maxsize=1)
def simulated_scene(seed: int, views: int = VIEWS, width: int = LATTICE[0]) -> Scene:
    """A random site photographed on an orbit; the last one is kept, so that every backbone sees the same photos."""
    site = random_site(seed)
    cameras = orbit(views, width=width, aspect=LATTICE[1] / LATTICE[0], seed=seed)
    seen = tuple(render_view(site, camera, samples=1) for camera in cameras)  # colour guides the fusion
    return Scene(cameras, seen, tuple(scored_labels(view, site.extent) for view in seen), site_truth(site))


def simulated_case(
    seed: int, segmenter: str, views: int = VIEWS, geometry: VggtLike | None = None, width: int = LATTICE[0]
) -> Case:
    """A random site on an orbit, with VGGT-like geometry, an emulated segmenter and one reference object."""
    scene = simulated_scene(seed, views, width)
    seen = emulate_views(scene.views, scene.cameras, geometry or VggtLike(), SEGMENTERS[segmenter](), seed)
    observed = seen.observations
    number, references = reference_object(scene.views, [view.name for view in observed.views], scene.truth.objects)
    true = Exact()(scene.views, scene.cameras, seed)
    both = zip(true.views, observed.views, strict=True)
    exact = replace(true, views=tuple(replace(t, evidence=o.evidence, image=o.image) for t, o in both))
    return Case(
        f"site {seed}", observed, scene.labels, scene.truth, seen.T_M_R, references, number, exact
    )  # fmt: skip


def simulated_cases(seeds: Sequence[int], segmenter: str, views: int = VIEWS) -> Iterator[Case]:
    """One case a seed, made when it is asked for."""
    for seed in seeds:
        yield simulated_case(seed, segmenter, views)


def with_true_classes(case: Case) -> Observations:
    """The case's observations with the true class of every scored pixel as its only evidence: for the oracle."""
    evidence = [(label[..., None] == np.array(TASK_CLASSES)).astype(np.float32) for label in case.labels]
    both = zip(case.observations.views, evidence, strict=True)
    return replace(case.observations, views=tuple(replace(view, evidence=e) for view, e in both))
