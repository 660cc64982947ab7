"""EXIF and XMP: position, attitude, time and focal length, as cameras write them and as programs garble them."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from excavatwin.capture import find_photos
from excavatwin.capture.cameras import SENSOR_WIDTHS, Lens, camera_table, focal_pixels
from excavatwin.scene.photo import Photo

DATA = Path(os.environ.get("EXCAVATWIN_DATA", Path(__file__).parents[2] / "shared" / "data"))
EXIF_IFD, GPS_IFD = 0x8769, 0x8825
DJI = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<rdf:Description xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" drone-dji:GimbalRollDegree="+0.00" '
    'drone-dji:GimbalYawDegree="-121.30" drone-dji:GimbalPitchDegree="-89.90" drone-dji:RtkStdLon="0.01123" '
    'drone-dji:RtkStdLat="0.01345" drone-dji:RtkStdHgt="0.02517"/></rdf:RDF></x:xmpmeta>'
)


def photo_with(folder: Path, main=None, detail=None, gps=None, xmp: str | None = None, size=(160, 120)) -> Photo:
    """The photo of a JPEG that carries these tags."""
    exif = Image.Exif()
    for tag, value in (main or {}).items():
        exif[tag] = value
    exif.get_ifd(EXIF_IFD).update(detail or {})
    exif.get_ifd(GPS_IFD).update(gps or {})
    options = {"xmp": xmp.encode()} if xmp else {}
    Image.new("RGB", size, (90, 80, 70)).save(folder / "a.jpg", exif=exif, **options)
    (photo,) = find_photos(folder)
    return photo


def position(lat_ref="N", lon_ref="E", alt_ref=b"\x00", **more):
    return {1: lat_ref, 2: (46.0, 50.0, 33.3855), 3: lon_ref, 4: (91.0, 59.0, 40.4156), 5: alt_ref, 6: 198.25, **more}


@pytest.mark.parametrize(("lat_ref", "lat_sign"), [("N", 1), ("S", -1)])
@pytest.mark.parametrize(("lon_ref", "lon_sign"), [("E", 1), ("W", -1)])
@pytest.mark.parametrize(("alt_ref", "alt_sign"), [(b"\x00", 1), (b"\x01", -1)])
def test_gps_signs(tmp_path, lat_ref, lat_sign, lon_ref, lon_sign, alt_ref, alt_sign):
    fix = photo_with(tmp_path, gps=position(lat_ref, lon_ref, alt_ref)).gps
    assert fix is not None
    assert fix.latitude == pytest.approx(lat_sign * (46 + 50 / 60 + 33.3855 / 3600), abs=1e-7)
    assert fix.longitude == pytest.approx(lon_sign * (91 + 59 / 60 + 40.4156 / 3600), abs=1e-7)
    assert fix.altitude == pytest.approx(alt_sign * 198.25)
    assert fix.sigma_horizontal is None


@pytest.mark.parametrize(
    "gps",
    [
        {},
        {1: "N", 2: (46.0, 50.0, 33.0)},  # no longitude
        position() | {9: "V"},  # void
        position() | {2: (0.0, 0.0, 0.0), 4: (0.0, 0.0, 0.0)},  # never filled
        position() | {2: (146.0, 0.0, 0.0)},  # impossible
        position() | {2: (IFDRational(0, 0), 0.0, 0.0)},  # not a number
    ],
)
def test_a_position_that_is_none_is_none(tmp_path, gps):
    assert photo_with(tmp_path, gps=gps).gps is None


def test_position_without_altitude(tmp_path):
    fix = photo_with(tmp_path, gps={k: v for k, v in position().items() if k < 5}).gps
    assert fix is not None
    assert fix.altitude is None


@pytest.mark.parametrize("element", [False, True])
def test_dji_attitude_and_rtk_accuracy(tmp_path, element):
    xmp = DJI
    if element:  # the same facts as elements, as some firmware writes them
        xmp = "<drone-dji:GimbalYawDegree>-121.30</drone-dji:GimbalYawDegree>".join(["<x>", ""]) + "".join(
            f"<drone-dji:{name}>{value}</drone-dji:{name}>"
            for name, value in {
                "GimbalPitchDegree": -89.9,
                "GimbalRollDegree": 0,
                "RtkStdLat": 0.01345,
                "RtkStdLon": 0.01123,
                "RtkStdHgt": 0.02517,
            }.items()
        )
    photo = photo_with(tmp_path, gps=position(), xmp=xmp)
    assert photo.gimbal is not None
    assert (photo.gimbal.yaw, photo.gimbal.pitch, photo.gimbal.roll) == (-121.3, -89.9, 0.0)
    assert photo.gps is not None
    assert photo.gps.sigma_horizontal == pytest.approx(0.01345)
    assert photo.gps.sigma_vertical == pytest.approx(0.02517)


def test_time_orders_within_a_second(tmp_path):
    stamps = []
    for fraction in ("05", "297"):
        photo = photo_with(tmp_path, detail={0x9003: "2016:12:04 11:01:00", 0x9291: fraction})
        stamps.append(photo.time)
    assert stamps[1] - stamps[0] == pytest.approx(0.247)
    assert photo_with(tmp_path, detail={0x9003: "0000:00:00 00:00:00"}).time is None


def test_missing_exif(tmp_path):
    Image.new("RGB", (160, 120)).save(tmp_path / "a.png")
    (photo,) = find_photos(tmp_path)
    assert (photo.focal, photo.focal_source, photo.gps, photo.gimbal, photo.time) == (None, "unknown", None, None, None)
    assert photo.camera == "unknown camera 160x120"


def test_garbled_exif_does_not_cost_the_photo(tmp_path):
    Image.new("RGB", (160, 120)).save(tmp_path / "a.jpg", exif=b"Exif\x00\x00II*\x00\xff\xff\xff\x7f" + b"\x07" * 40)
    (photo,) = find_photos(tmp_path)
    assert photo.gps is None


def test_cameras_differ_by_model_size_and_zoom(tmp_path):
    detail = {0x920A: 4.5}
    one = photo_with(tmp_path, {0x010F: "Canon", 0x0110: "Canon X"}, detail)
    assert one.camera == "Canon X 160x120 4.5mm"
    others = [
        photo_with(tmp_path, {0x010F: "Canon", 0x0110: "Canon Y"}, detail),
        photo_with(tmp_path, {0x010F: "Canon", 0x0110: "Canon X"}, {0x920A: 9.0}),
        photo_with(tmp_path, {0x010F: "Canon", 0x0110: "Canon X"}, detail | {0xA404: 2.0}),
        photo_with(tmp_path, {0x010F: "Canon", 0x0110: "Canon X"}, detail, size=(120, 160)),
    ]
    assert len({one.camera, *(photo.camera for photo in others)}) == 5


def test_35_mm_equivalent_relates_diagonals():
    for long_side, short_side in ((4000, 3000), (6000, 4000)):
        focal, source = focal_pixels(Lens(focal_35mm=28), long_side, short_side)
        assert source == "exif-35mm"
        assert focal / math.hypot(long_side, short_side) == pytest.approx(28 / math.hypot(36, 24))
    assert focal_pixels(Lens(focal_35mm=24), 3840, 2160)[0] == pytest.approx(24 / 36 * 3840)


def test_focal_plane_resolution_of_an_original():
    lens = Lens(model="Unheard", focal_mm=35.0, pitch_mm=22.3 / 6000, recorded=(6000, 4000))
    focal, source = focal_pixels(lens, 6000, 4000)
    assert source == "exif-focal-plane"
    assert focal == pytest.approx(35 / 22.3 * 6000)
    shrunk, _ = focal_pixels(lens, 1500, 1000)  # PixelXDimension still tells the original size
    assert shrunk == pytest.approx(focal / 4)


def test_stale_focal_plane_resolution_is_not_believed():
    """caliterra: 4000 px photos shrunk to 1600 px still say 16393 px/inch; taken at its word the sensor is 2.5 mm."""
    pitch = 25.4 / 16393.44
    for recorded in (None, (1600.0, 1200.0)):
        assert focal_pixels(Lens(focal_mm=4.5, pitch_mm=pitch, recorded=recorded), 1600, 1200) == (None, "unknown")
    lens = Lens(model="Canon PowerShot SX260 HS", focal_mm=4.5, pitch_mm=pitch)
    focal, source = focal_pixels(lens, 1600, 1200)
    assert source == "camera-table"
    assert focal == pytest.approx(4.5 / (4000 * pitch) * 1600, rel=1e-3)


def test_the_table_yields_to_another_lens_of_the_same_device():
    wide = focal_pixels(Lens(model="iPhone XS", focal_mm=4.25, focal_35mm=26), 4032, 3024)
    tele = focal_pixels(Lens(model="iPhone XS", focal_mm=6.0, focal_35mm=52), 4032, 3024)
    assert wide[1] == "camera-table"
    assert tele == (pytest.approx(52 / math.hypot(36, 24) * 5040), "exif-35mm")


def test_the_table_and_the_equivalent_agree_where_cameras_tell_both():
    """The diagonal convention, checked against sensor widths: within the rounding of f35 to full millimetres."""
    for model, focal_mm, focal_35mm in (("iPhone 5s", 4.15, 29), ("iPhone XS", 4.25, 26), ("FC6310", 8.8, 24)):
        short_side = 3648 if model == "FC6310" else 4104
        by_table, source = focal_pixels(Lens(model=model, focal_mm=focal_mm), 5472, short_side)
        by_35mm, _ = focal_pixels(Lens(focal_35mm=focal_35mm), 5472, short_side)
        assert source == "camera-table"
        assert by_table == pytest.approx(by_35mm, rel=0.5 / focal_35mm + 0.005)


def test_every_sensor_of_the_table_is_plausible_and_has_a_source():
    table = camera_table()
    assert len({(s.model, s.focal_mm) for s in table}) == len(table) > 20
    for sensor in table:
        assert min(abs(sensor.width_mm / width - 1) for width in SENSOR_WIDTHS) < 0.025, sensor
        assert sensor.source


@pytest.mark.parametrize(
    ("folder", "ratio", "source"),
    [
        ("caliterra_site/images", 0.726, "camera-table"),
        ("lewis_oblique/images", 0.699, "camera-table"),
        ("brighton_beach/images", 0.582, "camera-table"),
        ("sandpile_oppaiyama/images", 0.848, "camera-table"),
        ("belvedere_icepy4d/cam1", 1.1014, "camera-table"),  # calibrated: calib/cam1.txt, 6621.7 / 6012
    ],
)
def test_real_photos(folder, ratio, source):
    if not (DATA / folder).exists():
        pytest.skip(f"shared data not present: {folder}")
    photos = find_photos(DATA / folder)
    for photo in photos:
        assert photo.focal == pytest.approx(ratio * photo.width, rel=0.03)
        assert photo.focal_source == source
    assert len({photo.camera for photo in photos}) == 1
    assert np.all([photo.time is not None for photo in photos])
