"""``cameras.json``: where each photo was taken from, or why that is not known."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from excavatwin.export.placement import frame_sentence, origin_of
from excavatwin.scene.elevation_map import ElevationMap
from excavatwin.scene.observations import Unplaced
from excavatwin.scene.site import MappedView, Site


def cameras_table(site: Site, label_files: Mapping[str, str]) -> dict[str, Any]:
    """Cameras of the placed photos in map coordinates, and the photos that could not be placed.

    ``K`` and ``distortion`` (OpenCV k1, k2, p1, p2) are of the full photo; ``lattice`` is the undistorted image of
    the same camera that label images and points live on: ``(x, y)_lattice = affine @ (x, y, 1)_photo``.
    """
    return {
        "conventions": "T_map_cam: camera to map, OpenCV axes (x right, y down, z forward); pixel centres at +0.5; "
        "K and distortion (OpenCV k1, k2, p1, p2) are of the photo as displayed; undistort a photo pixel first, then "
        "affine gives its place on the lattice, of which the label image is",
        "frame": frame_sentence(site.map),
        "unit": site.map.unit,
        "cameras": [
            *(_placed(view, site.map, label_files.get(view.name)) for view in site.views),
            *(_unplaced(photo) for photo in site.unplaced),
        ],
    }


def _placed(view: MappedView, elevation_map: ElevationMap, label_file: str | None) -> dict[str, Any]:
    H, W = view.label.shape
    lattice = view.lattice
    T_map_cam = np.array(view.T_M_cam, np.float64)
    T_map_cam[:3, 3] += origin_of(elevation_map)
    return {
        "name": view.name,
        "placed": True,
        "reason": None,
        "width": lattice.width if lattice else W,
        "height": lattice.height if lattice else H,
        "K": lattice.K_photo if lattice else view.K_cam,
        "distortion": lattice.distortion if lattice else (0.0, 0.0, 0.0, 0.0),
        "T_map_cam": T_map_cam,
        "affine": lattice.affine if lattice else np.eye(2, 3),
        "lattice": {"width": W, "height": H, "K": view.K_cam},
        "label_image": label_file,
    }


def _unplaced(photo: Unplaced) -> dict[str, Any]:
    nothing = dict.fromkeys(("width", "height", "K", "distortion", "T_map_cam", "affine", "lattice", "label_image"))
    return {"name": photo.name, "placed": False, "reason": photo.reason, **nothing}
