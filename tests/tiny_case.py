"""The tiny site (tests/tiny_site.py) as a case of a study, with its exact truth; and the files of it."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

import tiny_site
from excavatwin.exchange import save_observations
from excavatwin.scene.elevation_map import MapObject
from excavatwin.scene.grid import Grid
from excavatwin.scene.observations import Observations
from excavatwin.scene.taxonomy import NOT_OBSERVED, TaskClass
from excavatwin.scene.truth import Truth, ViewTruth
from excavatwin.simulation import save_truth
from excavatwin.studies.cases import Case

VIEWS, WIDTH = 5, 80


@lru_cache(maxsize=1)
def exact() -> Observations:
    """True points with their true classes."""
    return tiny_site.observations(VIEWS, WIDTH, tiny_site.Emulation(noise=0, silent=0, wrong=0))


def tiny_case(noise: float = 0.02, silent: float = 0.2, wrong: float = 0.25, seed: int = 0) -> Case:
    """Observations that err, and what is true about every pixel.

    Args:
        noise: standard deviation of every coordinate of a point [m].
        silent: share of pixels without evidence.
        wrong: share of pixels with another class.
    """
    rng = np.random.default_rng(seed)
    labels, views = [], []
    for view in exact().views:
        seen = view.evidence.any(axis=-1)
        labels.append(np.where(seen, view.evidence.argmax(axis=-1) + 1, NOT_OBSERVED).astype(np.uint8))
        drawn = rng.integers(1, 6, seen.shape)
        named = np.where(rng.random(seen.shape) < wrong, drawn, labels[-1])
        evidence = 0.9 * (named[..., None] == np.arange(1, 6)) * (seen & (rng.random(seen.shape) >= silent))[..., None]
        points = view.points + rng.normal(0, noise, view.points.shape)
        views.append(replace(view, points=points.astype(np.float32), evidence=evidence.astype(np.float32), image=None))
    both = zip(exact().views, views, strict=True)
    true = replace(exact(), views=tuple(replace(e, evidence=o.evidence, image=None) for e, o in both))
    observed, truth = replace(exact(), views=tuple(views)), tiny_truth(views, labels)
    return Case("tiny", observed, tuple(labels), truth, np.eye(4), exact=true)


def tiny_truth(views, labels) -> Truth:
    """Rasters of 10 cm, the machine and the block as objects, and the photos' classes."""
    n = int(2 * tiny_site.HALF / 0.1)
    grid = Grid(-tiny_site.HALF, tiny_site.HALF, 0.1, n, n)
    x, y = np.meshgrid(grid.x, grid.y)
    top, label = tiny_site.surface(x, y)
    boxes = ((tiny_site.MACHINE, TaskClass.EXCAVATOR), (tiny_site.BLOCK, TaskClass.OBSTACLE))
    instance = np.zeros(grid.shape, np.uint8)
    objects = []
    for number, ((x0, x1, y0, y1, h), k) in enumerate(boxes, 1):
        instance[(x > x0) & (x < x1) & (y > y0) & (y < y1)] = number
        z = float(tiny_site.plain((x0 + x1) / 2, (y0 + y1) / 2))
        corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
        centre, size = ((x0 + x1) / 2, (y0 + y1) / 2, z + h / 2), (x1 - x0, y1 - y0, h)
        objects.append(MapObject(number, k, centre, size, 0.0, z, z + h, 1.0, corners))
    photos = tuple(
        ViewTruth(view.name, view.shape[1], view.shape[0], view.K_cam, view.T_R_cam, true)
        for view, true in zip(views, labels, strict=True)
    )
    height = tiny_site.terrain(x, y).astype(np.float32)
    return Truth(
        grid, height, top.astype(np.float32), label.astype(np.uint8), instance, tuple(objects), ("machine", "block"),
        photos,
    )  # fmt: skip


def write_tiny_case(folder: Path) -> tuple[Path, Path]:
    """``observations.npz`` and ``truth.npz``."""
    case = tiny_case()
    observations, truth = folder / "observations.npz", folder / "truth.npz"
    save_observations(case.observations, observations)
    save_truth(case.truth, truth)
    return observations, truth
