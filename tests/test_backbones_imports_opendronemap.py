"""OpenDroneMap projects, written as OpenSfM and ODM document them, read back against the simulated truth."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import laspy
import numpy as np
import pycolmap
import pyproj
import pytest
from scipy.spatial.transform import Rotation

from excavatwin.backbones.finished.opensfm_files import read_opensfm, to_projected
from excavatwin.backbones.reconstructors.opendronemap import OpenDroneMap
from excavatwin.errors import InputError
from excavatwin.scene.frames import invert_rigid
from finished_site import assert_true, depth_error, distorted, shots, spec, true_depth, write_photos

H, W = shots()[0].depth.shape
SIZE = max(H, W)
K = shots()[0].K
EPSG = 32632
#: Offset that ODM writes, and what lies at the site's origin: a kilometre north-east of it, off the central meridian.
OFFSET = np.array([431_000.0, 5_301_000.0, 0.0])
ORIGIN = OFFSET + np.array([700.0, 800.0, 450.0])
BROWN = {"k1": -0.12, "k2": 0.03, "k3": 0.004, "p1": 0.002, "p2": -0.003}
BROWN |= {"projection_type": "brown", "width": W, "height": H, "focal_x": K[0, 0] / SIZE, "focal_y": K[1, 1] / SIZE}
BROWN |= {"c_x": (K[0, 2] - W / 2) / SIZE, "c_y": (K[1, 2] - H / 2) / SIZE}
BROWN_COLMAP = spec("FULL_OPENCV", W, H, K[0, 0], K[1, 1], K[0, 2], K[1, 2], -0.12, 0.03, 0.002, -0.003, 0.004, 0, 0, 0)


def shot_record(T_W_cam):
    T = invert_rigid(T_W_cam)
    return {
        "rotation": Rotation.from_matrix(T[:3, :3]).as_rotvec().tolist(),
        "translation": T[:3, 3].tolist(),
        "camera": "v2 sim 1",
        "orientation": 1,
    }


def write_reconstruction(path, poses, camera=BROWN, reference=None):
    record = {"cameras": {"v2 sim 1": camera}, "shots": {name: shot_record(T) for name, T in poses.items()}}
    record["points"] = {"1": {"coordinates": [0.0, 0.0, 0.0], "color": [1, 2, 3]}}
    if reference:
        record["reference_lla"] = dict(zip(("latitude", "longitude", "altitude"), reference, strict=True))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps([{"cameras": {}, "shots": {}, "points": {}}, record]))


def moved(T, by):
    T = T.copy()
    T[:3, 3] += by
    return T


def write_laz(path, points, epsg=EPSG):
    header = laspy.LasHeader(point_format=7, version="1.4")
    header.scales, header.offsets = np.full(3, 0.001), np.floor(points.min(axis=0))
    if epsg:
        header.add_crs(pyproj.CRS.from_epsg(epsg))
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    path.parent.mkdir(parents=True, exist_ok=True)
    las.write(path)


def all_points():
    return np.concatenate([shot.points[np.isfinite(shot.depth)].astype(float) for shot in shots()])[::3]


def reference():
    """Latitude, longitude, altitude of OpenSfM's origin: 20 m beside and 30 m below the site's."""
    back = pyproj.Transformer.from_crs(EPSG, 4326, always_xy=True)
    lon, lat = back.transform(ORIGIN[0] + 12.0, ORIGIN[1] - 16.0)
    return lat, lon, float(ORIGIN[2]) - 30.0


def to_enu(points):
    """Coordinates of the CRS in the frame east, north, up at ``reference``: by way of geocentric ones, by hand."""
    lat, lon, alt = reference()
    to_xyz = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)
    to_lonlat = pyproj.Transformer.from_crs(EPSG, 4326, always_xy=True)
    lons, lats = to_lonlat.transform(points[:, 0], points[:, 1])
    xyz = np.stack(to_xyz.transform(lons, lats, points[:, 2]), axis=1)
    zero = np.array(to_xyz.transform(lon, lat, alt))
    s, c, S, C = np.sin(np.radians(lon)), np.cos(np.radians(lon)), np.sin(np.radians(lat)), np.cos(np.radians(lat))
    R = np.array([[-s, c, 0], [-S * c, -S * s, C], [C * c, C * s, S]])
    return (xyz - zero) @ R.T


def enu_pose(T):
    """A pose of the site in OpenSfM's frame: its position, and its axes by a step of a metre along each."""
    at = to_enu(np.concatenate([T[None, :3, 3], T[:3, 3] + T[:3, :3].T]) + ORIGIN)
    axes = (at[1:] - at[0]).T
    U, _, Vt = np.linalg.svd(axes)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = U @ Vt, at[0]
    return pose


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    camera = pycolmap.Camera(**BROWN_COLMAP)
    images = {shot.name: distorted(camera, shot) for shot in shots()}
    return write_photos(tmp_path_factory.mktemp("photos"), images)


def project_in_crs(folder, cloud=True):
    """As ODM 2021 and later: reconstruction.json in the CRS less the offset, OpenSfM's own beside it."""
    local = {shot.name: moved(shot.T, ORIGIN - OFFSET) for shot in shots()}
    write_reconstruction(folder / "opensfm" / "reconstruction.json", local, reference=reference())
    own = {shot.name: enu_pose(shot.T) for shot in shots()}
    write_reconstruction(folder / "opensfm" / "reconstruction.topocentric.json", own, reference=reference())
    coords = folder / "odm_georeferencing" / "coords.txt"
    coords.parent.mkdir(parents=True)
    coords.write_text(f"WGS84 UTM 32N\n{OFFSET[0]:.0f} {OFFSET[1]:.0f}\n0.1 0.2 400\n")
    if cloud:
        write_laz(folder / "odm_georeferencing" / "odm_georeferenced_model.laz", all_points() + ORIGIN)
    return folder


def assert_georeferenced(obs, atol=1e-4):
    tie = obs.georeference
    assert tie.epsg == EPSG
    assert obs.metres_per_unit == 1.0
    assert np.array_equal(obs.up, (0, 0, 1))
    for view, shot in zip(obs.views, shots(), strict=True):
        np.testing.assert_allclose(view.T_R_cam[:3, :3], shot.T[:3, :3], atol=atol)
        centre = view.T_R_cam[:3, 3] + tie.origin - ORIGIN
        np.testing.assert_allclose(centre, shot.T[:3, 3], atol=10 * atol)
        assert np.abs(view.points[np.isfinite(view.points)]).max() < 500  # float32 keeps these to 0.03 mm
    error = [np.median(depth_error(view, n, shots()[n].T)) for n, view in enumerate(as_local(obs))]
    assert max(error) < 3e-3


def as_local(obs):
    """The views in the site's own frame."""
    by = np.array(obs.georeference.origin) - ORIGIN
    return [replace(v, points=(v.points + by).astype(np.float32), T_R_cam=moved(v.T_R_cam, by)) for v in obs.views]


def test_a_georeferenced_project(tmp_path, photos):
    obs = OpenDroneMap(source=str(project_in_crs(tmp_path)))(photos)
    assert_georeferenced(obs)
    assert obs.source["depth"].endswith("odm_georeferenced_model.laz")
    assert np.isnan(obs.georeference.residual)  # these photos have no GPS
    assert obs.views[0].lattice.distortion[0] == pytest.approx(-0.12, abs=0.01)


def test_a_topocentric_project_is_brought_into_its_crs(tmp_path, photos):
    """As ODM before 2021 and newest: OpenSfM's frame is turned by the meridian convergence, 0.7 degrees here."""
    folder = project_in_crs(tmp_path)
    (folder / "opensfm" / "reconstruction.topocentric.json").replace(folder / "opensfm" / "reconstruction.json")
    turn = np.degrees(np.arccos((np.trace(enu_pose(shots()[0].T)[:3, :3].T @ shots()[0].T[:3, :3]) - 1) / 2))
    assert 0.3 < turn < 2
    assert_georeferenced(OpenDroneMap(source=str(folder))(photos), atol=2e-4)
    same = folder / "opensfm" / "reconstruction.json"
    shutil.copy(same, same.with_name("reconstruction.topocentric.json"))  # newest: both are topocentric
    assert_georeferenced(OpenDroneMap(source=str(folder))(photos), atol=2e-4)


def test_poses_at_the_reference_keep_their_place():
    lat, lon, alt = reference()
    T = to_projected(np.eye(4), (lat, lon, alt), EPSG)
    np.testing.assert_allclose(T[:3, 3], ORIGIN + np.array([12, -16, -30]), atol=1e-6)
    convergence = pyproj.Proj(EPSG).get_factors(lon, lat).meridian_convergence
    assert np.degrees(np.arctan2(T[1, 0], T[0, 0])) == pytest.approx(convergence, abs=1e-4)


@pytest.mark.parametrize("suffix", ["", ".tif"])
def test_depth_maps_come_first(tmp_path, photos, suffix):
    """OpenSfM's own dense step: maps on undistorted images whose principal point is the middle, with scores."""
    folder = project_in_crs(tmp_path, cloud=False)
    maps = folder / "opensfm" / "undistorted" / "depthmaps"
    maps.mkdir(parents=True)
    width, height = 160, 160 * H // W
    f = (K[0, 0] + K[1, 1]) / 2 * width / W
    v, u = np.mgrid[:height, :width] + 0.5
    rays = np.stack([(u.ravel() - width / 2) / f, (v.ravel() - height / 2) / f], axis=1)
    for number, shot in enumerate(shots()):
        depth = np.nan_to_num(true_depth(number, rays)).reshape(height, width).astype(np.float32)
        score = np.full(depth.shape, 0.5 + 0.05 * number, np.float32)
        np.savez_compressed(maps / f"{shot.name}{suffix}.clean.npz", depth=depth, plane=np.zeros(3), score=score)
    obs = OpenDroneMap(source=str(folder))(photos)
    assert_georeferenced(obs)
    assert obs.source["confidence"].startswith("correlation score")
    assert np.unique(obs.views[2].confidence).tolist() == pytest.approx([0.0, 0.6])
    (maps / f"shot_03.png{suffix}.clean.npz").write_bytes(b"zip")
    with pytest.raises(InputError, match=r"shot_03\.png.*clean\.npz is not a depth map of OpenSfM"):
        OpenDroneMap(source=str(folder))(photos)


def test_a_project_without_gps(tmp_path, photos):
    """No reference, no CRS: the frame is OpenSfM's, its unit unknown."""
    write_reconstruction(tmp_path / "opensfm" / "reconstruction.json", {shot.name: shot.T for shot in shots()})
    write_laz(tmp_path / "odm_georeferencing" / "odm_georeferenced_model.laz", all_points(), epsg=None)
    obs = OpenDroneMap(source=str(tmp_path), up="z")(photos)
    assert_true(obs, tolerance=3e-3, covered=0.8)
    assert obs.georeference is None
    assert obs.metres_per_unit is None


@pytest.mark.parametrize("local", [True, False])
def test_the_filtered_cloud_will_do(tmp_path, photos, local):
    """Without the georeferenced cloud: the filtered one, in the frame of reconstruction.json."""
    folder = project_in_crs(tmp_path, cloud=False)
    points = all_points() + ORIGIN - OFFSET
    if not local:
        (folder / "opensfm" / "reconstruction.topocentric.json").replace(folder / "opensfm" / "reconstruction.json")
        points = to_enu(all_points() + ORIGIN)
    path = folder / "odm_filterpoints" / "point_cloud.ply"
    path.parent.mkdir()
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    head += "".join(f"property double {axis}\n" for axis in "xyz") + "end_header\n"
    path.write_bytes(head.encode() + points.astype("<f8").tobytes())
    obs = OpenDroneMap(source=str(folder))(photos)
    if local:
        assert_georeferenced(obs)
    else:
        assert obs.georeference is None
        assert obs.metres_per_unit == 1.0
        assert any("is in the local frame" in doubt for doubt in obs.doubts)
        assert np.median(depth_error(obs.views[0], 0)) < 3e-3


CAMERAS = {
    "perspective": (
        {"projection_type": "perspective", "width": W, "height": H, "focal": 0.8, "k1": -0.1, "k2": 0.02},
        spec("RADIAL", W, H, 0.8 * SIZE, W / 2, H / 2, -0.1, 0.02),
    ),
    "fisheye": (
        {"projection_type": "fisheye", "width": W, "height": H, "focal": 0.8, "k1": 0.03, "k2": -0.01},
        spec("RADIAL_FISHEYE", W, H, 0.8 * SIZE, W / 2, H / 2, 0.03, -0.01),
    ),
    "brown": (BROWN, BROWN_COLMAP),
}


@pytest.mark.parametrize("kind", CAMERAS)
def test_lenses_of_opensfm(tmp_path, kind):
    camera, expected = CAMERAS[kind]
    write_reconstruction(tmp_path / "reconstruction.json", {"a.jpg": np.eye(4)}, camera)
    lens = read_opensfm(tmp_path / "reconstruction.json").shots["a.jpg"].lens
    rays = np.random.default_rng(0).uniform(-0.4, 0.4, (40, 2))
    true = pycolmap.Camera(**expected).img_from_cam(np.c_[rays, np.ones(40)])
    np.testing.assert_allclose(lens.project(rays), true, atol=1e-9)


def test_refusals(tmp_path, photos):
    folder = project_in_crs(tmp_path / "p")
    with pytest.raises(InputError, match=r"holds no opensfm/reconstruction\.json"):
        OpenDroneMap(source=str(tmp_path))(photos)
    coords = folder / "odm_georeferencing" / "coords.txt"
    coords.write_text("WGS84 UTM 33N\n431000 5301000\n")
    with pytest.raises(
        InputError, match=r"odm_georeferenced_model\.laz is in EPSG:32632 but its project in EPSG:32633"
    ):
        OpenDroneMap(source=str(folder))(photos)
    coords.write_text("EPSG:4326\n431000 5301000\n")
    with pytest.raises(InputError, match=r"coords\.txt is in WGS 84, not in a projected CRS"):
        OpenDroneMap(source=str(folder))(photos)
    coords.write_text("somewhere\n431000 5301000\n")
    with pytest.raises(InputError, match=r"coords\.txt names no CRS in its first line, but 'somewhere'"):
        OpenDroneMap(source=str(folder))(photos)
    coords.write_text("WGS84 UTM 99N\n431000 5301000\n")
    with pytest.raises(InputError, match=r"coords\.txt names no CRS in its first line, but 'WGS84 UTM 99N'"):
        OpenDroneMap(source=str(folder))(photos)
    coords.write_text("+proj=utm +zone=32 +datum=WGS84 +units=m +no_defs\n431000 5301000\n")
    assert OpenDroneMap(source=str(folder))(photos).georeference.epsg == EPSG
    (folder / "odm_georeferencing" / "odm_georeferenced_model.laz").write_bytes(b"LASF broken")
    with pytest.raises(InputError, match=r"odm_georeferenced_model\.laz cannot be read as LAS or LAZ"):
        OpenDroneMap(source=str(folder))(photos)
    (folder / "odm_georeferencing" / "odm_georeferenced_model.laz").unlink()
    with pytest.raises(InputError, match=r"neither odm_georeferencing/odm_georeferenced_model\.laz nor depth maps"):
        OpenDroneMap(source=str(folder))(photos)
    path = folder / "opensfm" / "reconstruction.json"
    write_reconstruction(path, {"a.jpg": np.eye(4)}, BROWN | {"projection_type": "dual"})
    with pytest.raises(InputError, match="is of type 'dual'"):
        OpenDroneMap(source=str(folder))(photos)
    path.write_text("{")
    with pytest.raises(InputError, match=r"reconstruction\.json is damaged"):
        OpenDroneMap(source=str(folder))(photos)
