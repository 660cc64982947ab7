"""A small truth with the perfect map of it, for the tests of evaluation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from excavatwin.evaluation.objects import rectangle
from excavatwin.scene.elevation_map import ElevationMap, MapObject
from excavatwin.scene.grid import Grid
from excavatwin.scene.observations import Georeference
from excavatwin.scene.site import FusedPoints
from excavatwin.scene.taxonomy import TaskClass
from excavatwin.scene.truth import Truth, ViewTruth

PLACE = Georeference(32632, (691000.0, 5334000.0, 520.0), 0.02)


def an_object(x=0.0, y=0.0, length=2.0, width=1.0, height=1.5, yaw=20.0, number=1) -> MapObject:
    box = MapObject(
        number, TaskClass.OBSTACLE, (x, y, height / 2), (length, width, height), yaw, 0.0, height, 1.0, np.zeros((4, 2))
    )
    return replace(box, footprint=rectangle(box, np.zeros(3)))


def a_truth() -> Truth:
    grid = Grid(-4.0, 3.0, 0.1, 60, 80)
    x, y = np.meshgrid(grid.x, grid.y)
    height = (0.3 * x - 0.2 * y + 1).astype(np.float32)
    label = np.where(x < 0, 1, 2).astype(np.uint8)
    label[:6] = 3
    label[20:30, 30:50] = 5
    instance = np.where(label == 5, 1, 0).astype(np.uint8)
    pose = np.eye(4)
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0])
    pose[2, 3] = 11.0
    K = np.array([[100.0, 0, 40], [0, 100.0, 30], [0, 0, 1]])
    views = (ViewTruth("a.jpg", 80, 60, K, pose, label), ViewTruth("b.jpg", 80, 60, K, pose, label[::-1].copy()))
    return Truth(
        grid,
        height,
        height,
        label,
        instance,
        (an_object(), an_object(3, 2, 1, 1, 1, 0, 2)),
        ("skip", "crate"),
        views,
        PLACE,
    )


def a_map(truth: Truth) -> ElevationMap:
    """The perfect map of a truth, on the same grid."""
    shape = truth.grid.shape
    terrain = np.isin(truth.label, (1, 2))
    return ElevationMap(
        grid=truth.grid,
        elevation=np.where(terrain, truth.height, np.nan).astype(np.float32),
        elevation_std=np.zeros(shape, np.float32),
        label=truth.label.copy(),
        confidence=np.ones(shape, np.float32),
        observed=np.ones(shape, np.uint8),
        reason=np.zeros(shape, np.uint8),
        object_id=truth.instance.astype(np.int32),
        object_top=np.full(shape, np.nan, np.float32),
        object_base=np.full(shape, np.nan, np.float32),
        support=np.where(terrain, 1, 2).astype(np.uint8),
        objects=truth.objects,
        georeference=PLACE,
    )


def one_point() -> FusedPoints:
    return FusedPoints(
        xyz=np.zeros((1, 3), np.float32),
        label=np.ones(1, np.uint8),
        confidence=np.ones(1, np.float32),
        rgb=np.zeros((1, 3), np.uint8),
        object_id=np.zeros(1, np.int32),
        support=np.ones(1, np.uint8),
    )
