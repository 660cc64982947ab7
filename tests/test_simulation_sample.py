"""The sample as files: EXIF read back, truth read back, positions where the camera stood."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import numpy as np
import pyproj
import pytest

from excavatwin.capture import find_photos
from excavatwin.evaluation import load_truth
from excavatwin.simulation import DigSite, orbit, save_truth, site_truth
from excavatwin.simulation.flights import FOCAL_RATIO
from excavatwin.simulation.recording.drone_photo import PLACE, write_photo
from excavatwin.simulation.site import PLACEMENTS

SAMPLE = Path(__file__).resolve().parent.parent / "sample"


def test_a_photo_tells_where_and_with_which_lens_it_was_taken(tmp_path) -> None:
    camera = orbit(1, width=160, focal_ratio=FOCAL_RATIO)[0]
    error = np.array([0.02, -0.01, 0.03])
    write_photo(tmp_path / "a.jpg", np.zeros((120, 160, 3), np.uint8), camera, error, datetime(2025, 5, 20, 10, 0, 5))
    (photo,) = find_photos(tmp_path)
    assert photo.focal == pytest.approx(camera.focal, rel=1e-6)
    assert photo.focal_source == "exif-35mm"
    assert photo.gps is not None
    assert photo.gps.sigma_horizontal == pytest.approx(0.02)
    assert photo.gps.sigma_vertical == pytest.approx(0.03)
    to_utm = pyproj.Transformer.from_crs(4326, PLACE.epsg, always_xy=True)
    easting, northing = to_utm.transform(photo.gps.longitude, photo.gps.latitude)
    wanted = np.array(PLACE.origin) + camera.T_M_cam[:3, 3] + error
    np.testing.assert_allclose([easting, northing, photo.gps.altitude], wanted, atol=1e-3)
    assert photo.gimbal is not None
    assert photo.gimbal.pitch == pytest.approx(np.rad2deg(np.arcsin(camera.T_M_cam[2, 2])), abs=0.01)


def test_a_truth_survives_its_file(tmp_path) -> None:
    site = DigSite(extent=12, margin=3, cell=0.2, vegetation=0, placements=PLACEMENTS[:1])
    camera = orbit(1, width=80)[0]
    truth = site_truth(site, [("a.jpg", camera)], cell=0.2, long_side=40, georeference=PLACE)
    save_truth(truth, tmp_path / "truth.npz")
    again = load_truth(tmp_path / "truth.npz")
    assert again.grid == truth.grid
    assert again.georeference == PLACE
    np.testing.assert_allclose(again.height, truth.height, atol=1e-4)
    np.testing.assert_array_equal(again.label, truth.label)
    np.testing.assert_array_equal(again.instance, truth.instance)
    assert again.names == truth.names
    for a, b in zip(again.objects, truth.objects, strict=True):
        assert a.size == pytest.approx(b.size)
        assert a.task_class == b.task_class
        np.testing.assert_allclose(a.footprint, b.footprint)
    assert again.views[0].name == "a.jpg"
    np.testing.assert_array_equal(again.views[0].label, truth.views[0].label)
    np.testing.assert_allclose(again.views[0].T_M_cam, camera.T_M_cam)


def test_the_shipped_sample_is_whole() -> None:
    photos = find_photos(SAMPLE / "photos")
    truth = load_truth(SAMPLE / "truth.npz")
    assert len(photos) >= 12
    assert [photo.name for photo in photos] == [view.name for view in truth.views]
    assert truth.georeference == PLACE
    assert all(p.gps and p.focal == pytest.approx(v.K_cam[0, 0]) for p, v in zip(photos, truth.views, strict=True))
    assert sum(file.stat().st_size for file in SAMPLE.rglob("*") if file.is_file()) < 8e6
