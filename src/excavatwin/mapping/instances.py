"""Instances: which voxels of excavators and obstacles form one body."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32, Int64

from excavatwin.scene.labels import Labels
from excavatwin.scene.support import LocalGeometry, Terrain
from excavatwin.scene.taxonomy import OBJECT_CLASSES, TaskClass
from excavatwin.scene.voxels import Voxels
from excavatwin.topology import radius_clusters


@dataclass(frozen=True)
class Instances:
    """Connected components of the voxels that were decided to be excavator or obstacle.

    Seen from above, the sides of a body are often missing: height differences count less than horizontal ones. A body
    is one thing: a fragment of the other class that touches a much larger body takes its class.
    """

    radius: float = 4.5
    """Linkage distance [voxels]."""
    vertical: float = 0.1
    """What a vertical distance counts in it."""
    min_voxels: int = 12
    """Smallest object."""
    min_height: float = 2.5
    """Least height above the terrain that an object must reach [voxels]."""
    machine: float = 1.0
    """Least extent of a machine in plan [m]: a smaller body of excavator voxels is an obstacle. Not used while the
    scale is unknown."""
    reach: float = 2.0
    """A smaller excavator body nearer than this to a machine, in plan, and at least half as high as ``machine``, is a
    part of it [m]: booms are too thin to be seen throughout. Not used while the scale is unknown."""
    fragment: float = 0.3
    """A touching component of the other class joins a body when it has less than this share of its voxels."""
    min_samples: int = 36
    """Least number of view samples of an object: the smallest must be found by three views or so, or it is a speck."""

    def __call__(
        self, voxels: Voxels, local: LocalGeometry, labels: Labels, terrain: Terrain, metric: bool
    ) -> tuple[Int32[np.ndarray, "J"], Labels]:
        """(object of every voxel from 1, largest first, 0 = none; labels with fragments joined to their bodies)."""
        rows = np.flatnonzero(np.isin(labels.label, OBJECT_CLASSES) & ~terrain.member & local.inlier)
        flattened = voxels.centre[rows] * np.array([1, 1, self.vertical], np.float32)
        radius = self.radius * voxels.size
        kind = labels.label[rows].astype(np.int32)
        cluster, size = radius_clusters(flattened, radius, kind)
        touching, _ = radius_clusters(flattened, radius)
        body = self.hosts(cluster, size, touching)[cluster]
        label = labels.label.copy()
        first = np.full(len(size), -1, np.int64)
        first[cluster[::-1]] = rows[::-1]
        label[rows] = labels.label[first[body]]
        if metric:
            level = voxels.centre[rows, :2]  # in plan: a person is as high as a machine is wide
            small = extents(level, body, len(size)) < self.machine
            part = label[rows] == TaskClass.EXCAVATOR
            body[part] = self.assembled(voxels.centre[rows[part]], body[part], small, terrain.height[rows[part]])
            small = extents(level, body, len(size)) < self.machine
            label[rows[small[body] & (label[rows] == TaskClass.EXCAVATOR)]] = TaskClass.OBSTACLE
        of_voxel = np.zeros(len(voxels), np.int32)
        samples = np.bincount(voxels.voxel, minlength=len(voxels))[rows]
        of_voxel[rows] = self.numbered(body, len(size), terrain.height[rows], voxels.size, samples)
        return of_voxel, replace(labels, label=label)

    def hosts(
        self, cluster: Int32[np.ndarray, "n"], size: Int64[np.ndarray, "c"], touching: Int32[np.ndarray, "n"]
    ) -> Int32[np.ndarray, "c"]:
        """Body that every component belongs to: the largest of its touching group, when it is a fragment of it."""
        group = np.zeros(len(size), np.int32)
        group[cluster] = touching
        largest = np.zeros(int(group.max(initial=-1)) + 1, np.int32)
        ascending = np.argsort(size, kind="stable")
        largest[group[ascending]] = ascending  # the last write wins: the largest
        host = largest[group] if len(size) else np.zeros(0, np.int32)
        own = np.arange(len(size), dtype=np.int32)
        return np.where(size < self.fragment * size[host], host, own).astype(np.int32)

    def assembled(
        self,
        xyz: Float32[np.ndarray, "n 3"],
        body: Int32[np.ndarray, "n"],
        small: Bool[np.ndarray, "c"],
        height: Float32[np.ndarray, "n"],
    ) -> Int32[np.ndarray, "n"]:
        """Body of every excavator voxel once the parts within reach of a machine, or of its parts, belong to it."""
        from scipy.spatial import cKDTree

        body = body.copy()
        high = np.full(len(small), -np.inf)
        np.maximum.at(high, body, height)
        fresh, loose = ~small[body], small[body] & (high[body] >= 0.5 * self.machine)
        while fresh.any() and loose.any():
            near, at = cKDTree(xyz[fresh, :2]).query(xyz[loose, :2], distance_upper_bound=self.reach)
            host = body[fresh]
            fresh = np.zeros(len(body), bool)
            for part in np.unique(body[loose][np.isfinite(near)]):
                own = body[loose] == part
                member = body == part
                body[member] = host[at[own][np.argmin(near[own])]]
                fresh |= member
                loose, near, at = loose & ~member, near[~own], at[~own]
        return body

    def numbered(
        self,
        body: Int32[np.ndarray, "n"],
        count: int,
        height: Float32[np.ndarray, "n"],
        voxel: float,
        samples: Int64[np.ndarray, "n"],
    ) -> Int32[np.ndarray, "n"]:
        """Object numbers of the bodies that are large and high enough, from 1 in order of size; 0 for the others."""
        size = np.bincount(body, minlength=count)
        top = np.full(count, -np.inf)
        np.maximum.at(top, body, height)
        seen = np.bincount(body, samples, minlength=count) >= self.min_samples
        keep = (size >= self.min_voxels) & seen & (top >= self.min_height * voxel)
        order = np.argsort(-size, kind="stable")
        number = np.zeros(count, np.int32)
        number[order[keep[order]]] = np.arange(1, keep.sum() + 1)
        return number[body] if count else np.zeros(0, np.int32)


def extents(xy: Float32[np.ndarray, "n 2"], cluster: Int32[np.ndarray, "n"], count: int) -> Float64[np.ndarray, "c"]:
    """Longer edge of the level, axis-parallel box of every cluster [m]."""
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, cluster, xy)
    np.maximum.at(high, cluster, xy)
    return (high - low).max(axis=1, initial=0)
