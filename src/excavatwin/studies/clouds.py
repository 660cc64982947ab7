"""Plain clouds whose ground is known: the ISPRS filter test, and simulated dig sites as a scanner would see them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64

from excavatwin.scene.taxonomy import TERRAIN_CLASSES
from excavatwin.simulation import orbit, random_site, render_view


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points, and which of them lie on the ground."""

    name: str
    xyz: Float64[np.ndarray, "N 3"]
    """East, north, up [m]."""
    ground: Bool[np.ndarray, "N"]


def isprs_clouds(folder: Path) -> Iterator[Cloud]:
    """Every sample of the ISPRS filter test below a folder (Sithole and Vosselman, 2004).

    Raises:
        InputError: there is none, or a sample is not what was published.
    """
    from excavatwin.datasets.isprs import open_isprs

    dataset = open_isprs([folder])
    for name in dataset.names:
        (scan,) = dataset.open(name).scans
        cloud = scan.cloud()
        yield Cloud(name, np.asarray(cloud.xyz, np.float64), np.asarray(cloud.ground, bool))


def simulated_cloud(
    seed: int,
    spacing: float = 0.1,
    noise: float = 0.02,
    low: float = 0.001,
    flying: float = 0.003,
    views: int = 10,
    width: int = 480,
) -> Cloud:
    """A random site with pits or trenches, heaps, machines and plants, as seen from a flight around it.

    Args:
        spacing: edge of the cubes of which each keeps one point [m].
        noise: standard deviation of every coordinate [m].
        low: share of points added 0.5 to 3 m below others, as multiple reflections do.
        flying: share of points added 0.3 to 3 m above others: birds, dust, mixed pixels.
        views: of the flight.
        width: of a view [px].
    """
    site, rng = random_site(seed), np.random.default_rng(seed)
    parts, labels = [], []
    for camera in orbit(views, width=width, seed=seed):
        view = render_view(site, camera, samples=0)
        with np.errstate(invalid="ignore"):
            inside = (np.abs(view.points[..., :2]) < site.extent / 2).all(axis=-1)
        parts.append(view.points[inside].astype(np.float64))
        labels.append(view.label[inside])
    xyz, label = np.concatenate(parts), np.concatenate(labels)
    order = rng.permutation(len(xyz))
    first = order[np.unique(np.floor(xyz[order] / spacing).astype(int), axis=0, return_index=True)[1]]
    xyz, ground = xyz[first] + rng.normal(0, noise, (len(first), 3)), np.isin(label[first], TERRAIN_CLASSES)
    below = xyz[rng.integers(len(xyz), size=round(low * len(xyz)))]
    above = xyz[rng.integers(len(xyz), size=round(flying * len(xyz)))]
    below = below - [0, 0, 1] * rng.uniform(0.5, 3, (len(below), 1))
    above = above + [0, 0, 1] * rng.uniform(0.3, 3, (len(above), 1)) + rng.normal(0, 0.1, above.shape)
    wrong = np.zeros(len(below) + len(above), bool)
    return Cloud(f"site {seed}", np.concatenate([xyz, below, above]), np.concatenate([ground, wrong]))


def simulated_clouds(seeds: Sequence[int]) -> Iterator[Cloud]:
    """One cloud a seed, made when it is asked for."""
    for seed in seeds:
        yield simulated_cloud(seed)
