"""Dense depth of every placed photo on the CPU: plane sweep, then what the views agree on.

Every photo is matched against a few others by sweeping horizontal planes (Collins, CVPR 1996; along directions of the
scene as in Gallup et al., CVPR 2007), the costs are aggregated semi-globally, and only depths that other views confirm
are kept. Measured choices: ``docs/decisions/dense-stereo.md``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from jaxtyping import Float32

from excavatwin.backbones.photogrammetry.consistency import agree, drop_speckles
from excavatwin.backbones.photogrammetry.placement import PosedImage, SparsePoints
from excavatwin.backbones.photogrammetry.sources import choose_sources, neighbours, pair_scores
from excavatwin.backbones.photogrammetry.sweep import grey_pyramid, plane_family, sweep_view
from excavatwin.scene.progress import Progress, silent

Result = TypeVar("Result")


@dataclass(frozen=True)
class Dense:
    """Parameters of dense matching. The defaults serve drone photos on a lattice of about 640 px."""

    sources: int = 5
    """Photos that each photo is matched against."""
    keep: int = 3
    """Of those, the best matches of each pixel and plane that count: a place hidden from some is seen by others."""
    angle_min: float = 3.0
    """Rays of a useful pair of photos meet under at least this angle [deg]."""
    angle_best: float = 14.0
    """Angle of the most useful pair [deg]."""
    angle_max: float = 35.0
    """Rays of a useful pair meet under at most this angle [deg]."""
    margin: float = 0.3
    """The heights searched exceed those of a photo's sparse points by this share of their range, on both sides."""
    grazing: float = 12.0
    """The planes are tilted towards cameras that see the ground under a smaller angle than this [deg]."""
    horizon: float = 5.0
    """Rays under a smaller angle against the planes than this get no depth [deg]."""
    steps: tuple[float, ...] = (0.5, 1.0, 1.0)
    """Spacing of the planes at full, half and quarter resolution [px of disparity there]."""
    margins: tuple[int, ...] = (3, 5)
    """Planes searched below and above the next coarser result, at full and half resolution."""
    widest: int = 40
    """At most so many planes are searched at a pixel next to a depth edge."""
    gamma_tone: float = 10.0
    """Grey difference at which a neighbour's weight in a matching window falls to 1/e."""
    gamma_space: float = 2.0
    """Distance at which a neighbour's weight in a matching window falls to 1/e [px]."""
    noise: float = 1.0
    """Image noise, standard deviation: windows with less contrast do not match [grey]."""
    P1: float = 5.0
    """Price of a depth change by one plane between neighbouring pixels [1/250 of 1 - ZNCC]."""
    P2: float = 80.0
    """Price of a larger change [1/250 of 1 - ZNCC]."""
    P2_least: float = 25.0
    """The same across an image edge."""
    contrast: float = 10.0
    """Image edge that halves P2 [grey]."""
    worst: float = 0.75
    """Pixels that match worse than this have no depth [1 - ZNCC]."""
    checks: int = 8
    """Photos that each depth map is checked against."""
    pixels: float = 1.0
    """A confirmed point returns to its pixel within this distance after its way through the other photo [px]."""
    relative: float = 0.01
    """A confirmed depth agrees within this share."""
    views: int = 2
    """Photos that must confirm a depth, in photos that look down."""
    views_oblique: int = 3
    """The same in photos whose optical axis is more than 30 degrees off the vertical."""
    surface_step: float = 0.015
    """Neighbouring pixels belong to one surface when their depths differ by less than this share."""
    surface_least: float = 8e-5
    """Surfaces smaller than this share of the image are dropped."""
    threads: int = 0
    """Photos worked on at the same time; 0 = number of processors. The result does not depend on it."""


def densify(
    images: Sequence[PosedImage], sparse: SparsePoints, parameters: Dense | None = None, progress: Progress = silent
) -> list[tuple[Float32[np.ndarray, "H W"], Float32[np.ndarray, "H W"]]]:
    """Depth of every pixel of every photo that other photos confirm.

    Args:
        images: undistorted photos with their cameras; sizes may differ.
        sparse: points of structure from motion in the upright frame R: they give the height range and the pairs.

    Returns:
        For each photo its depth along the optical axis [su], NaN where nothing trustworthy was found, and its support,
        the number of photos that confirm it. Photos without partners come back empty.
    """
    dense = parameters or Dense()
    scores = pair_scores(images, sparse, dense.angle_min, dense.angle_best, dense.angle_max)

    def match(r: int) -> Float32[np.ndarray, "H W"]:
        others = choose_sources(r, scores, images, dense.sources)
        family = plane_family(images[r], sparse.xyz[sparse.visible[r]], dense.margin, dense.grazing)
        if not others or family is None:
            return np.full(images[r].image.shape[:2], np.nan, np.float32)
        pyramids = [grey_pyramid(images[i], len(dense.steps)) for i in (r, *others)]
        depth, cost = sweep_view(images[r], [images[s] for s in others], pyramids, family, dense)
        return np.where(cost <= dense.worst, depth, np.nan).astype(np.float32)

    depths = _each(match, range(len(images)), dense.threads, "dense depth", progress)

    def confirm(r: int) -> tuple[Float32[np.ndarray, "H W"], Float32[np.ndarray, "H W"]]:
        others = neighbours(r, scores, dense.checks)
        votes, agreed = agree(r, others, images, depths, dense.pixels, dense.relative)
        oblique = images[r].T_R_cam[2, 2] > -np.cos(np.radians(30))
        needed = max(min(dense.views_oblique if oblique else dense.views, len(others)), 1)
        agreed[~(votes >= needed)] = np.nan
        agreed = drop_speckles(agreed, dense.surface_step, round(dense.surface_least * agreed.size))
        return agreed, np.where(np.isfinite(agreed), votes, 0).astype(np.float32)

    return _each(confirm, range(len(images)), dense.threads, "depth consistency", progress)


def _each(
    work: Callable[[int], Result], items: Iterable[int], threads: int, stage: str, progress: Progress
) -> list[Result]:
    """``work`` of every item, in order, several at a time: the kernels leave Python's lock."""
    import os
    from concurrent.futures import ThreadPoolExecutor

    todo = list(items)
    results: list[Result] = []
    progress(stage, 0, len(todo))
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    pool = ThreadPoolExecutor(threads or usable)
    try:
        for result in pool.map(work, todo):
            results.append(result)
            progress(stage, len(results), len(todo))
    finally:  # when interrupted, do not finish what nobody waits for
        pool.shutdown(wait=True, cancel_futures=True)
    return results
