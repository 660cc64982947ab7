"""Objects of the map: occupancy, vertical extent and oriented boxes of excavators and obstacles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32

from excavatwin.mapping.boxes import convex_hull, smallest_rectangle
from excavatwin.mapping.raster import Cells
from excavatwin.scene.elevation_map import MapObject
from excavatwin.scene.labels import Labels
from excavatwin.scene.support import LocalGeometry, Terrain
from excavatwin.scene.taxonomy import OBJECT_CLASSES, TaskClass
from excavatwin.scene.voxels import Voxels
from excavatwin.topology import radius_clusters


@dataclass(frozen=True)
class Occupied:
    """Object rasters and the list of objects."""

    object_id: Int32[np.ndarray, "Y X"]
    top: Float32[np.ndarray, "Y X"]
    base: Float32[np.ndarray, "Y X"]
    objects: tuple[MapObject, ...]
    of_voxel: Int32[np.ndarray, "J"]
    """Object of every voxel, 0 = none."""


@dataclass(frozen=True)
class Occupancy:
    """Connected components of the voxels that were decided to be excavator or obstacle."""

    radius: float = 2.5
    """Linkage distance [voxels]."""
    min_voxels: int = 12
    """Smallest object."""
    min_height: float = 2.5
    """Least height above the terrain [voxels]."""
    trim: float = 0.01
    """Share of an object's voxels that may lie outside its box on every side: flying points at depth edges."""

    def __call__(
        self, cells: Cells, voxels: Voxels, local: LocalGeometry, labels: Labels, terrain: Terrain
    ) -> Occupied:
        """Objects numbered from 1, largest first."""
        rows = np.flatnonzero(np.isin(labels.label, OBJECT_CLASSES) & ~terrain.member & local.inlier)
        kind = labels.label[rows].astype(np.int32)
        cluster, size = radius_clusters(voxels.centre[rows], self.radius * voxels.size, kind)
        top = np.full(len(size), -np.inf)
        np.maximum.at(top, cluster, terrain.height[rows])
        keep = (size >= self.min_voxels) & (top >= self.min_height * voxels.size)
        order = np.argsort(-size, kind="stable")
        number = np.zeros(len(size), np.int32)
        number[order[keep[order]]] = np.arange(1, keep.sum() + 1)
        of_voxel = np.zeros(len(voxels), np.int32)
        of_voxel[rows] = number[cluster] if len(size) else 0
        objects = tuple(self.box(int(i), of_voxel == i, voxels, labels, terrain) for i in range(1, int(keep.sum()) + 1))
        object_id, highest, lowest = self.rasterize(cells, voxels, of_voxel)
        return Occupied(object_id, highest, lowest, objects, of_voxel)

    def box(
        self, object_id: int, member: Bool[np.ndarray, "J"], voxels: Voxels, labels: Labels, terrain: Terrain
    ) -> MapObject:
        """Oriented box of one object: footprint of least area, from the terrain below it to its top."""
        xyz = voxels.centre[member].astype(np.float64)
        footprint = self.trimmed(xyz[:, :2])
        hull = convex_hull(footprint)
        rectangle = smallest_rectangle(hull)
        z_top = float(np.quantile(xyz[:, 2], 1 - self.trim))
        z_base = float(np.median(xyz[:, 2] - terrain.height[member]))
        return MapObject(
            object_id=object_id,
            task_class=TaskClass(int(labels.label[member][0])),
            centre=(float(rectangle.centre[0]), float(rectangle.centre[1]), (z_base + z_top) / 2),
            size=(rectangle.length, rectangle.width, z_top - z_base),
            yaw=rectangle.yaw,
            z_base=z_base,
            z_top=z_top,
            confidence=float(labels.confidence[member].mean()),
            footprint=hull,
        )

    def trimmed(self, xy: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "m 2"]:
        """The positions without the outermost share along each side of their smallest rectangle."""
        angle = np.radians(smallest_rectangle(convex_hull(xy)).yaw)
        axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        local = xy @ axes.T
        low, high = np.quantile(local, [self.trim, 1 - self.trim], axis=0)
        inside = ((local >= low) & (local <= high)).all(axis=1)
        return xy[inside] if inside.sum() >= 3 else xy

    def rasterize(
        self, cells: Cells, voxels: Voxels, of_voxel: Int32[np.ndarray, "J"]
    ) -> tuple[Int32[np.ndarray, "Y X"], Float32[np.ndarray, "Y X"], Float32[np.ndarray, "Y X"]]:
        """(object, highest, lowest point) of every cell; where objects overlap in plan, the highest one is named."""
        n_cells = cells.grid.rows * cells.grid.cols
        object_id = of_voxel[voxels.voxel]
        at = np.flatnonzero((object_id > 0) & (cells.of_sample >= 0))
        cell, z = cells.of_sample[at], voxels.xyz[at, 2]
        highest = np.full(n_cells, -np.inf, np.float32)
        lowest = np.full(n_cells, np.inf, np.float32)
        np.maximum.at(highest, cell, z)
        named = np.zeros(n_cells, np.int32)
        ascending = np.lexsort((-object_id[at], z))
        named[cell[ascending]] = object_id[at][ascending]  # the last write wins: the highest sample
        own = object_id[at] == named[cell]
        np.minimum.at(lowest, cell[own], z[own])
        empty = named == 0
        highest[empty] = lowest[empty] = np.nan
        shape = cells.grid.shape
        return named.reshape(shape), highest.reshape(shape), lowest.reshape(shape)
