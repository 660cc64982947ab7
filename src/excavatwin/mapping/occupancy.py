"""Objects of the map: occupancy, vertical extent and oriented boxes of excavators and obstacles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32

from excavatwin.mapping.boxes import convex_hull, core, smallest_rectangle
from excavatwin.mapping.raster import Cells
from excavatwin.scene.elevation_map import MapObject
from excavatwin.scene.labels import Labels
from excavatwin.scene.support import Terrain
from excavatwin.scene.taxonomy import TaskClass
from excavatwin.scene.voxels import Voxels


@dataclass(frozen=True)
class Occupied:
    """Object rasters and the list of objects."""

    object_id: Int32[np.ndarray, "Y X"]
    top: Float32[np.ndarray, "Y X"]
    base: Float32[np.ndarray, "Y X"]
    objects: tuple[MapObject, ...]


@dataclass(frozen=True)
class Occupancy:
    """Rasters and oriented boxes of the object instances."""

    trim: float = 0.01
    """Share of an object's weight that may lie outside its box on every side: flying points at depth edges."""
    witnesses: float = 3.0
    """A voxel weighs its number of views, as a share of its best seen neighbour's, to this power: a halo clings to the
    depth edges of one view or two, beside the body that many find; a thin boom is the best seen around. 0 = all alike.
    """

    def __call__(
        self, cells: Cells, voxels: Voxels, labels: Labels, terrain: Terrain, instance: Int32[np.ndarray, "J"]
    ) -> Occupied:
        """Occupancy, vertical extent and boxes of the objects 1..M of ``instance``."""
        numbers = range(1, int(instance.max(initial=0)) + 1)
        weight = witnessed(voxels) ** self.witnesses
        objects = tuple(self.box(i, instance == i, voxels, labels, terrain, weight) for i in numbers)
        return Occupied(*self.rasterize(cells, voxels, instance), objects)

    def box(
        self,
        object_id: int,
        member: Bool[np.ndarray, "J"],
        voxels: Voxels,
        labels: Labels,
        terrain: Terrain,
        weight: Float64[np.ndarray, "J"],
    ) -> MapObject:
        """Oriented box of one object: least area where its views agree, from the terrain below it to its top."""
        xyz = voxels.centre[member].astype(np.float64)
        inside = core(xyz[:, :2], weight[member], self.trim)
        hull = convex_hull(xyz[inside, :2])
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


def witnessed(voxels: Voxels) -> Float64[np.ndarray, "J"]:
    """Number of views that found each voxel, as a share of that of the best seen voxel among its neighbours, 0..1."""
    views = np.bincount(voxels.voxel, minlength=len(voxels)).astype(np.float64)
    return views / np.maximum(views[voxels.neighbours].max(axis=1, initial=0), views)
