"""points.laz, objects.geojson, label images and cameras.json, reopened and compared."""

from __future__ import annotations

import io
import json
from dataclasses import replace

import laspy
import numpy as np
import pyproj
import pytest
from PIL import Image

from excavatwin.export.cameras import cameras_table
from excavatwin.export.label_images import encode_label_image, label_file_names
from excavatwin.export.objects import objects_table, objects_wgs84_table
from excavatwin.export.point_cloud import encode_laz
from excavatwin.export.run_record import to_json
from excavatwin.scene.taxonomy import NOT_OBSERVED, PALETTE, TaskClass
from site_example import UTM, example_map, example_site


@pytest.fixture(scope="module")
def site():
    return example_site()


@pytest.mark.parametrize("georeferenced", [True, False])
def test_laz(georeferenced):
    site = example_site(georeferenced)
    cloud = laspy.read(io.BytesIO(encode_laz(site.points, site.map)))
    assert cloud.header.are_points_compressed
    assert (str(cloud.header.version), cloud.point_format.id) == ("1.4", 7)
    origin = np.array(UTM.origin if georeferenced else (0, 0, 0))
    np.testing.assert_allclose(cloud.xyz, site.points.xyz.astype(float) + origin, atol=0.000501)
    np.testing.assert_array_equal(cloud.header.scales, 0.001)
    for name, values in {
        "task_class": site.points.label,
        "confidence": site.points.confidence,
        "object_id": site.points.object_id,
        "support": site.points.support,
        "red": site.points.rgb[:, 0] * np.uint16(257),
        "blue": site.points.rgb[:, 2] * np.uint16(257),
    }.items():
        np.testing.assert_array_equal(np.asarray(cloud[name]), values)
    ground = np.isin(site.points.label, (TaskClass.CONSTRUCTION_TERRAIN, TaskClass.OTHER_TERRAIN))
    np.testing.assert_array_equal(np.asarray(cloud.classification) == 2, ground)
    assert set(np.unique(cloud.classification)) <= {1, 2, 67, 68, 69}
    names = cloud.header.vlrs.get("ClassificationLookupVlr")[0].lookups
    assert names[68].startswith("Excavator")
    crs = cloud.header.parse_crs()
    assert crs is not None
    assert crs.to_epsg() == (UTM.epsg if georeferenced else None)
    assert cloud.header.vlrs.get("WktCoordinateSystemVlr")[0].string.startswith(("PROJCS", "LOCAL_CS"))


def test_laz_of_nothing_and_of_unknown_scale(site):
    empty = replace(site.points, **{name: getattr(site.points, name)[:0] for name in site.points.__dataclass_fields__})
    assert len(laspy.read(io.BytesIO(encode_laz(empty, site.map))).x) == 0
    small = replace(site.points, xyz=site.points.xyz * np.float32(1e-4))
    m = example_map(georeferenced=False, metric=False)
    cloud = laspy.read(io.BytesIO(encode_laz(small, m)))
    assert cloud.header.parse_crs() is None
    np.testing.assert_allclose(cloud.xyz, small.xyz, atol=2e-9)


def test_objects_have_the_properties_of_the_contract(site):
    table = json.loads(to_json(objects_table(site.map)))
    assert table["crs"]["properties"]["name"] == "urn:ogc:def:crs:EPSG::32617"
    excavator, container = table["features"]
    assert list(excavator["properties"]) == [
        "object_id", "class", "centre", "size", "yaw_deg", "z_base", "z_top", "confidence",
    ]  # fmt: skip
    o = site.map.objects[0]
    assert excavator["properties"]["class"] == "excavator"
    assert container["properties"]["class"] == "obstacle"
    assert excavator["properties"]["size"] == [5.0, 2.6, 2.8]
    assert excavator["properties"]["yaw_deg"] == 30.0
    np.testing.assert_allclose(excavator["properties"]["centre"], np.add(o.centre, UTM.origin), atol=6e-4)
    assert excavator["properties"]["z_top"] == pytest.approx(o.z_top + UTM.origin[2], abs=6e-4)
    (ring,) = excavator["geometry"]["coordinates"]
    assert ring[0] == ring[-1]
    np.testing.assert_allclose(ring[:-1], o.footprint + UTM.origin[:2], atol=6e-4)


def test_wgs84_twin_follows_rfc_7946(site):
    table = json.loads(to_json(objects_wgs84_table(site.map)))
    assert "crs" not in table
    back = pyproj.Transformer.from_crs(4326, UTM.epsg, always_xy=True)
    for feature, o in zip(table["features"], site.map.objects, strict=True):
        ring = np.array(feature["geometry"]["coordinates"][0])
        assert (np.abs(ring) <= (180, 90)).all()
        np.testing.assert_allclose(np.stack(back.transform(*ring[:-1].T), 1), o.footprint + UTM.origin[:2], atol=1e-3)
        x, y = (ring - ring[0]).T
        assert x[:-1] @ y[1:] - y[:-1] @ x[1:] > 0  # counter-clockwise


def test_local_objects_name_no_place():
    m = example_map(georeferenced=False)
    assert objects_wgs84_table(m) is None
    assert json.loads(to_json(objects_table(m)))["crs"] is None


def test_clockwise_footprints_are_turned(site):
    o = site.map.objects[0]
    m = replace(site.map, objects=(replace(o, footprint=o.footprint[::-1]),))
    (ring,) = objects_table(m)["features"][0]["geometry"]["coordinates"]
    x, y = (np.array(ring) - ring[0]).T
    assert x[:-1] @ y[1:] - y[:-1] @ x[1:] > 0


def test_label_images(site):
    for view in site.views:
        image = Image.open(io.BytesIO(encode_label_image(view.label)))
        assert image.mode == "P"
        np.testing.assert_array_equal(np.asarray(image), view.label)
        colours = np.asarray(image.convert("RGB"))
        for k in np.unique(view.label):
            assert (colours[view.label == k] == PALETTE[int(k)]).all()
        assert f"{NOT_OBSERVED} not_observed" in image.text["Classes"]


def test_label_file_names_never_collide():
    assert label_file_names(["a.JPG", "b.png"]) == {"a.JPG": "a.png", "b.png": "b.png"}
    assert label_file_names(["a.jpg", "a.png", "A.tif"]) == {
        "a.jpg": "a.jpg.png", "a.png": "a.png.png", "A.tif": "A.tif.png",
    }  # fmt: skip
    assert label_file_names(["../left/1.jpg", "right\\1.jpg"]) == {
        "../left/1.jpg": ".._left_1.png", "right\\1.jpg": "right_1.png",
    }  # fmt: skip


def test_cameras(site):
    files = {view.name: f"labels/{view.name}.png" for view in site.views}
    table = json.loads(to_json(cameras_table(site, files)))
    first, _, lost = table["cameras"]
    view = site.views[0]
    assert (first["name"], first["placed"], first["reason"]) == ("IMG_0000.JPG", True, None)
    assert (first["width"], first["height"]) == (360, 240)
    assert first["label_image"] == "labels/IMG_0000.JPG.png"
    T = np.array(first["T_map_cam"])
    np.testing.assert_array_equal(T[:3, 3], view.T_M_cam[:3, 3] + UTM.origin)
    np.testing.assert_array_equal(T[:3, :3], view.T_M_cam[:3, :3])
    np.testing.assert_array_equal(first["K"], view.lattice.K_photo)
    np.testing.assert_array_equal(first["affine"], view.lattice.affine)
    assert first["lattice"]["width"] == 90
    assert lost["name"] == "IMG_0099.JPG"
    assert lost["placed"] is False
    assert lost["reason"] == "too few matches"
    assert lost["T_map_cam"] is None


def test_a_camera_whose_lattice_is_the_photo(site):
    bare = replace(site, views=(replace(site.views[0], lattice=None),))
    camera = json.loads(to_json(cameras_table(bare, {})))["cameras"][0]
    assert (camera["width"], camera["height"]) == (90, 60)
    assert camera["affine"] == [[1, 0, 0], [0, 1, 0]]


def test_the_lattice_sees_what_the_json_says(site):
    """A map point, projected with cameras.json alone, lands on the lattice pixel that it came from."""
    camera = json.loads(to_json(cameras_table(site, {})))["cameras"][0]
    T, K = np.array(camera["T_map_cam"]), np.array(camera["lattice"]["K"])
    view = site.views[0]
    row, col = np.argwhere(view.label != NOT_OBSERVED)[100]
    point = site.points.xyz[100].astype(float) + UTM.origin
    p = T[:3, :3].T @ (point - T[:3, 3])
    np.testing.assert_allclose((K @ p / p[2])[:2], (col + 0.5, row + 0.5), atol=0.05)
