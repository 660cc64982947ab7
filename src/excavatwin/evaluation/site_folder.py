"""Read back from a SITE folder what evaluation compares: the map, its objects and the refined labels of the photos."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from excavatwin.errors import InputError
from excavatwin.scene.elevation_map import LAYERS, ElevationMap, MapObject
from excavatwin.scene.grid import Grid
from excavatwin.scene.observations import Georeference, Lattice
from excavatwin.scene.site import MappedView
from excavatwin.scene.taxonomy import parse_class


def load_map(folder: Path) -> ElevationMap:
    """The map of ``map.nc`` with the objects of ``objects.geojson``, in its local frame M.

    Raises:
        InputError: the folder holds no ``map.nc``.
    """
    import xarray

    path = folder / "map.nc"
    if not path.is_file():
        raise InputError(f"{folder} holds no map.nc; expected the folder that `excavatwin map` wrote.")
    with xarray.open_dataset(path, engine="h5netcdf", mask_and_scale=False) as dataset:
        x, y = dataset["x"].values, dataset["y"].values
        layers = {layer.name: dataset[layer.name].values for layer in LAYERS}
        attributes = dict(dataset.attrs)
    place = None
    if "epsg" in attributes:
        origin = [float(v) for v in attributes["origin"]]
        residual = float(attributes.get("georeference_residual_m", np.nan))
        place = Georeference(int(attributes["epsg"]), (origin[0], origin[1], origin[2]), residual)
    origin_xyz = np.array(place.origin if place else (0.0, 0.0, 0.0))
    for name in ("elevation", "object_top", "object_base"):
        layers[name] = (layers[name].astype(float) - origin_xyz[2]).astype(np.float32)
    cell = float((x[-1] - x[0]) / (len(x) - 1)) if len(x) > 1 else float(y[0] - y[-1]) / max(len(y) - 1, 1)
    grid = Grid(float(x[0]) - origin_xyz[0] - cell / 2, float(y[0]) - origin_xyz[1] + cell / 2, cell, len(y), len(x))
    objects_path = folder / "objects.geojson"
    table = json.loads(objects_path.read_text("utf-8")) if objects_path.is_file() else {"features": []}
    return ElevationMap(
        grid,
        **layers,  # type: ignore[arg-type]  # one array per layer of the registry
        objects=tuple(_object(feature, origin_xyz) for feature in table["features"]),
        metric=str(attributes.get("metric", "true")) == "true",
        georeference=place,
    )


def _object(feature: dict[str, Any], origin: np.ndarray) -> MapObject:
    p = feature["properties"]
    ring = np.array(feature["geometry"]["coordinates"][0], float)[:-1]
    centre = np.array(p["centre"], float) - origin
    length, width, height = p["size"]
    return MapObject(
        object_id=int(p["object_id"]),
        task_class=parse_class(p["class"]),
        centre=(float(centre[0]), float(centre[1]), float(centre[2])),
        size=(length, width, height),
        yaw=float(p["yaw_deg"]),
        z_base=float(p["z_base"]) - origin[2],
        z_top=float(p["z_top"]) - origin[2],
        confidence=float(p["confidence"]),
        footprint=ring - origin[:2],
    )


def load_views(folder: Path, origin: Sequence[float] = (0.0, 0.0, 0.0)) -> tuple[MappedView, ...]:
    """The placed photos of ``cameras.json`` with their label images; empty when the folder has none.

    Args:
        origin: of the map's local frame M; poses are written with it and come back without it [m].

    Raises:
        InputError: the table or a label image is damaged.
    """
    from PIL import Image

    path = folder / "cameras.json"
    if not path.is_file():
        return ()
    views = []
    for camera in json.loads(path.read_text("utf-8"))["cameras"]:
        if not camera["placed"] or not camera.get("label_image"):
            continue
        with Image.open(folder / camera["label_image"]) as image:
            label = np.asarray(image, np.uint8)
        k1, k2, p1, p2 = camera["distortion"]
        lattice = Lattice(
            camera["width"],
            camera["height"],
            np.array(camera["affine"], float),
            np.array(camera["K"], float),
            (k1, k2, p1, p2),
        )
        K_cam, T = np.array(camera["lattice"]["K"], float), np.array(camera["T_map_cam"], float)
        T[:3, 3] -= origin
        views.append(MappedView(camera["name"], label, K_cam, T, lattice=lattice))
    return tuple(views)
