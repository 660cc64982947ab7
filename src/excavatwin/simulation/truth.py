"""The truth of a simulated site, and the file that keeps it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from excavatwin.kernels.ray_tracing import rasters
from excavatwin.scene.grid import Grid
from excavatwin.scene.observations import Georeference
from excavatwin.scene.truth import Truth, ViewTruth
from excavatwin.simulation.camera import Camera
from excavatwin.simulation.render import geometry, render_view
from excavatwin.simulation.site import DigSite, contents


def site_truth(
    site: DigSite,
    cameras: Sequence[tuple[str, Camera]] = (),
    cell: float = 0.05,
    long_side: int = 640,
    georeference: Georeference | None = None,
) -> Truth:
    """Everything that is true about a site, on a grid of ``cell`` metres over its extent.

    Args:
        cameras: names and cameras of the photos; their class images are kept on a lattice of ``long_side`` pixels.
    """
    count = int(round(site.extent / cell))
    grid = Grid(-site.extent / 2, site.extent / 2, cell, count, count)
    ground, bodies = geometry(site)
    inside = contents(site)
    height, surface, label, instance = rasters(ground, bodies, inside.ground.label, grid.x, grid.y)
    views = tuple(
        ViewTruth(
            name,
            camera.width,
            camera.height,
            camera.K_cam,
            camera.T_M_cam,
            render_view(site, camera.resized(long_side), samples=0).label,
        )
        for name, camera in cameras
    )
    names = tuple(place.name for place in site.placements)
    return Truth(grid, height, surface, label, instance, inside.objects, names, views, georeference)


def save_truth(truth: Truth, path: Path) -> None:
    """Write a truth as ``.npz``; heights are rounded to a tenth of a millimetre. ``evaluation.load_truth`` reads it."""
    place = truth.georeference
    np.savez_compressed(
        path,
        west=truth.grid.west,
        north=truth.grid.north,
        cell=truth.grid.cell,
        epsg=place.epsg if place else 0,
        origin=np.array(place.origin if place else (0, 0, 0), np.float64),
        height=np.round(truth.height, 4),
        surface=np.round(truth.surface, 2),
        label=truth.label,
        instance=truth.instance,
        object_id=np.array([o.object_id for o in truth.objects], np.int32),
        object_name=np.array(truth.names, str),
        object_class=np.array([o.task_class for o in truth.objects], np.uint8),
        object_centre=np.array([o.centre for o in truth.objects], np.float64).reshape(-1, 3),
        object_size=np.array([o.size for o in truth.objects], np.float64).reshape(-1, 3),
        object_yaw=np.array([o.yaw for o in truth.objects], np.float64),
        object_z_base=np.array([o.z_base for o in truth.objects], np.float64),
        object_z_top=np.array([o.z_top for o in truth.objects], np.float64),
        object_footprint=np.array([o.footprint for o in truth.objects], np.float64).reshape(-1, 4, 2),
        view_name=np.array([view.name for view in truth.views], str),
        view_size=np.array([(view.width, view.height) for view in truth.views], np.int32).reshape(-1, 2),
        view_K=np.array([view.K_cam for view in truth.views], np.float64).reshape(-1, 3, 3),
        view_T_map_cam=np.array([view.T_M_cam for view in truth.views], np.float64).reshape(-1, 4, 4),
        view_label=np.array([view.label for view in truth.views], np.uint8),
    )
