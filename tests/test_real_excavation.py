"""A real excavation, from photos to a SITE: 23 drone photos (caliterra), judged by places that a person can name."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray
from PIL import Image

from excavatwin.scene.frames import project
from excavatwin.scene.taxonomy import TaskClass
from test_cli import cli

pytestmark = pytest.mark.slow
PHOTOS = [f"IMG_{n}.jpg" for n in (*range(9400, 9408), *range(9414, 9431))]


@pytest.fixture(scope="module")
def excavation(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("caliterra")
    (folder / "photos").mkdir()
    for name in PHOTOS:
        photo = shared_data / "caliterra_site" / "images" / name
        if photo.exists():
            (folder / "photos" / name).symlink_to(photo)
    result = cli("map", folder / "photos", "-o", folder / "site")
    assert result.returncode == 0, result.stderr
    return folder / "site"


def share(site: Path, photo: str, box: tuple[int, int, int, int], k: TaskClass) -> float:
    """Share of the observed pixels of a box (x0, y0, x1, y1 on the lattice) that turned out to be of class k."""
    label = np.asarray(Image.open(site / "labels" / f"{photo}.png"))[box[1] : box[3], box[0] : box[2]]
    return float((label == k)[label != 255].mean())


def test_every_photo_is_placed_and_the_doubtful_vertical_is_said(excavation: Path) -> None:
    run = json.loads((excavation / "run.json").read_text())
    assert run["photos"]["placed"] == run["photos"]["found"] == 23
    assert any("GPS positions are too nearly on one line" in doubt for doubt in run["doubts"])
    assert any("vertical comes from" in doubt for doubt in run["doubts"])


def test_the_map_is_upright(excavation: Path) -> None:
    with xarray.open_dataset(excavation / "map.nc") as m:
        z = m.elevation.values.astype(float)
        X, Y = np.meshgrid(m.x.values - float(m.x.mean()), m.y.values - float(m.y.mean()))
        known = np.isfinite(z)
        design = np.stack([X[known], Y[known], np.ones(known.sum())], axis=1)
        plane = np.linalg.lstsq(design, z[known], rcond=None)[0]
        assert np.degrees(np.arctan(np.hypot(plane[0], plane[1]))) < 6
        assert (m.observed.values > 0).mean() > 0.5


def test_places_that_a_person_can_name_are_what_they_are(excavation: Path) -> None:
    named = {
        (232, 432, 264, 458): TaskClass.EXCAVATOR,
        (150, 330, 200, 400): TaskClass.CONSTRUCTION_TERRAIN,  # spoil heap
        (215, 355, 240, 385): TaskClass.CONSTRUCTION_TERRAIN,  # gravel cone
        (180, 60, 270, 130): TaskClass.CONSTRUCTION_TERRAIN,  # haul road
        (372, 275, 385, 300): TaskClass.OBSTACLE,  # concrete pipes
        (388, 100, 408, 130): TaskClass.OBSTACLE,
        (5, 20, 35, 150): TaskClass.REMOVABLE_COVER,  # trees
    }
    for box, task_class in named.items():
        assert share(excavation, "IMG_9404", box, task_class) > 0.5, (box, task_class)


def test_machine_and_pipes_stand_in_the_object_layer_and_heaps_do_not(excavation: Path) -> None:
    objects = json.loads((excavation / "objects.geojson").read_text())["features"]
    machines = [o["properties"] for o in objects if o["properties"]["class"] == "excavator"]
    assert len(machines) == 1
    length, width, height = machines[0]["size"]
    assert 3 < length < 9
    assert 1.5 < width < 4
    assert 1.5 < height < 5
    pipes = max(objects, key=lambda o: o["properties"]["size"][0])["properties"]
    assert pipes["class"] == "obstacle"
    assert pipes["size"][0] > 20  # a row of about sixty pipes stands as one body
    with xarray.open_dataset(excavation / "map.nc") as m:
        # Edges of objects share cells with the ground, which the consistency fills.
        assert np.isnan(m.elevation.values[m.object_id.values > 0]).mean() > 0.7


def shown_at(site: Path, photo: str, pixel: tuple[float, float], within: float = 20.0) -> dict[str, Any]:
    """The object whose box has its centre nearest to a pixel of a photo's lattice."""
    camera = next(c for c in json.loads((site / "cameras.json").read_text())["cameras"] if c["name"] == f"{photo}.jpg")
    objects = [o["properties"] for o in json.loads((site / "objects.geojson").read_text())["features"]]
    K, T = np.array(camera["lattice"]["K"]), np.array(camera["T_map_cam"])
    uv, z = project(K, T, np.array([o["centre"] for o in objects]))
    apart = np.where(z > 0, np.hypot(*(uv - pixel).T), np.inf)
    assert apart.min() < within, (photo, pixel)
    return objects[int(apart.argmin())]


def test_boxes_hold_the_pickup_and_the_manhole_and_no_specks_beside_them(excavation: Path) -> None:
    """The scale is good to 8 % only; a crew-cab pickup is 5.8 x 2.0 m, the manhole's square top under 2 m."""
    pickup = shown_at(excavation, "IMG_9414", (462, 408))
    assert pickup["class"] == "obstacle"
    assert 5.3 < pickup["size"][0] < 6.8
    assert 1.8 < pickup["size"][1] < 2.6  # 2.74 m with its halo
    manhole = shown_at(excavation, "IMG_9428", (520, 283))
    assert 1.5 < manhole["size"][1] <= manhole["size"][0] < 2.6  # 5.9 m with the specks of one view west of it
