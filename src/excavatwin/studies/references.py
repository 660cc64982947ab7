"""The paper's scale: one reference object of known dimension, measured in photos. It is never scored."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int64

from excavatwin.geometry.scale import Reference
from excavatwin.scene.elevation_map import MapObject
from excavatwin.scene.taxonomy import TaskClass
from excavatwin.simulation import RenderedView

MARGIN = 2
"""How far from its outline an object is touched [px]: at depth edges nobody's points are to be trusted."""
PHOTOS = 3
"""Photos in which the object is measured."""
LEAST = 60
"""Pixels inside the margin with which a photo shows an object well enough."""
DIRECTIONS = 24
"""Directions along which the two ends are looked for."""


def reference_object(
    views: Sequence[RenderedView], names: Sequence[str], objects: Sequence[MapObject]
) -> tuple[int, tuple[Reference, ...]]:
    """The object that gives the scale, and its known length in up to three photos; (0, ()) where none is seen well.

    Of the objects that are no excavator and well seen in most photos, the one with the longest length between two of
    its points that a photo shows; in the photos that show it largest. The length is the true distance of the two.

    Args:
        views: the true views.
        names: of the photos.
        objects: of the site.
    """
    best: tuple[float, int, tuple[Reference, ...]] = (0.0, 0, ())
    for one in objects:
        if one.task_class == TaskClass.EXCAVATOR:
            continue
        inside = [interior(view.instance == one.object_id) for view in views]
        size = np.array([mask.sum() for mask in inside])
        photos = [int(s) for s in np.argsort(-size, kind="stable")[:PHOTOS] if size[s] >= LEAST]
        if len(photos) < min(PHOTOS, len(views)):
            continue
        found = tuple(longest(names[s], views[s], inside[s]) for s in photos)
        length = float(np.median([reference.metres for reference in found]))
        if length > best[0]:
            best = (length, one.object_id, found)
    return best[1], best[2]


def interior(mask: Bool[np.ndarray, "H W"]) -> Bool[np.ndarray, "H W"]:
    """Pixels farther than the margin from everything that is not in the mask, and from the picture's edge."""
    from scipy.ndimage import binary_erosion

    eroded: Bool[np.ndarray, "H W"] = binary_erosion(mask, np.ones((3, 3), bool), MARGIN)
    return eroded


def longest(name: str, view: RenderedView, mask: Bool[np.ndarray, "H W"]) -> Reference:
    """The two pixels of a mask whose true points are farthest apart, and that distance."""
    row, col = np.nonzero(mask & np.isfinite(view.points).all(axis=-1))
    xyz = view.points[row, col].astype(np.float64)
    i, j = ends(xyz)
    metres = float(np.linalg.norm(xyz[i] - xyz[j]))
    return Reference(name, (col[i] + 0.5, row[i] + 0.5), (col[j] + 0.5, row[j] + 0.5), metres)


def ends(xyz: Float[np.ndarray, "n 3"]) -> tuple[int, int]:
    """The two points farthest apart, among those that are outermost along one of many directions."""
    k = np.arange(DIRECTIONS**2) + 0.5  # a spiral over the sphere, even in area
    polar, azimuth = np.arccos(1 - 2 * k / len(k)), np.pi * (1 + 5**0.5) * k
    way = np.stack([np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)])
    outermost: Int64[np.ndarray, "m"] = np.unique((xyz @ way).argmax(axis=0))
    apart = np.linalg.norm(xyz[outermost, None] - xyz[None, outermost], axis=-1)
    i, j = np.unravel_index(int(apart.argmax()), apart.shape)
    return int(outermost[i]), int(outermost[j])
