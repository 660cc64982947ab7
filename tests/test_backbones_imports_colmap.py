"""COLMAP workspaces that COLMAP's own code wrote (pycolmap), read back against the simulated truth."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pycolmap
import pytest

from excavatwin.backbones import catalogue
from excavatwin.backbones.finished.colmap_files import read_array
from excavatwin.backbones.reconstructors.colmap import Colmap
from excavatwin.capture import find_photos
from excavatwin.errors import InputError
from excavatwin.scene.frames import invert_rigid
from excavatwin.scene.photo import GpsFix
from finished_site import (
    CAMERAS,
    assert_true,
    depth_error,
    distorted,
    shots,
    spec,
    true_depth,
    write_colmap,
    write_photos,
)

pycolmap.logging.minloglevel = 3
H, W = shots()[0].depth.shape
FX, FY, CX, CY = shots()[0].K[[0, 1, 0, 1], [0, 1, 2, 2]]
POSES = {shot.name: shot.T for shot in shots()}
MODELS = {
    "SIMPLE_PINHOLE": (FX, CX, CY),
    "RADIAL": (FX, CX, CY, -0.1, 0.02),
    "OPENCV": (FX, FY, CX, CY, -0.12, 0.03, 0.002, -0.003),
    "FULL_OPENCV": (FX, FY, CX, CY, -0.12, 0.03, 0.002, -0.003, 0.004, 0.0, 0.0, 0.0),
    "OPENCV_FISHEYE": (FX, FY, CX, CY, 0.3, 0.02, 0.0, 0.0),
}


def write_depth(dense, kind="geometric", size=None, poses=True):
    """True depth of the undistorted images, through COLMAP's writer."""
    model = pycolmap.Reconstruction(dense / "sparse")
    for image in model.images.values():
        camera = model.camera(image.camera_id)
        if size is not None:
            camera.rescale(*size)
        K = camera.calibration_matrix()
        v, u = np.mgrid[: camera.height, : camera.width] + 0.5
        rays = np.stack([(u.ravel() - K[0, 2]) / K[0, 0], (v.ravel() - K[1, 2]) / K[1, 1]], axis=1)
        depth = np.nan_to_num(true_depth(int(image.name[-6:-4]), rays)).reshape(camera.height, camera.width)
        path = dense / "stereo" / "depth_maps" / f"{image.name}.{kind}.bin"
        path.parent.mkdir(parents=True, exist_ok=True)
        pycolmap.DepthMap.from_array(depth.astype(np.float32), 1.0, 100.0).write(path)


def workspace(folder, model="OPENCV", binary=True, **depth):
    """photos/, ws/sparse/0 and ws/dense as COLMAP leaves them; returns (photos, ws)."""
    intrinsics = spec(model, W, H, *MODELS[model])
    camera = pycolmap.Camera(**intrinsics)
    photos = write_photos(folder / "photos", {shot.name: distorted(camera, shot) for shot in shots()})
    ws = folder / "ws"
    write_colmap(ws / "sparse" / "0", dict.fromkeys(POSES, intrinsics), POSES, binary=binary)
    pycolmap.undistort_images(ws / "dense", ws / "sparse" / "0", folder / "photos")
    if not binary:
        found = pycolmap.Reconstruction(ws / "dense" / "sparse")
        for path in (ws / "dense" / "sparse").iterdir():
            path.unlink()
        found.write_text(ws / "dense" / "sparse")
    write_depth(ws / "dense", **depth)
    return photos, ws


@pytest.fixture(scope="module")
def opencv(tmp_path_factory):
    return workspace(tmp_path_factory.mktemp("opencv"))


@pytest.mark.parametrize("model", MODELS)
def test_every_lens_of_colmap_gives_the_true_site(tmp_path, model):
    photos, ws = workspace(tmp_path, model, binary=model != "RADIAL")
    obs = Colmap(source=str(ws), up="z")(photos)
    assert_true(obs, covered=0.8)
    for view, shot in zip(obs.views, shots(), strict=True):
        np.testing.assert_allclose(view.K_cam, shot.K, rtol=1e-6)  # the lattice is the photo without its lens
        both = np.isfinite(view.points[..., 0])
        difference = np.abs(view.image[both].astype(float) - shot.image[both]).mean()
        assert difference < (2 if "PINHOLE" in model else 5)
        camera = pycolmap.Camera(**spec(model, W, H, *MODELS[model]))
        rays = np.random.default_rng(0).uniform(-0.3, 0.3, (50, 2))
        on = view.lattice.from_photo(camera.img_from_cam(np.c_[rays, np.ones(50)]))
        assert np.abs(on - (rays * view.K_cam[[0, 1], [0, 1]] + view.K_cam[:2, 2])).max() < 0.3
    assert obs.source["reconstructor"] == "colmap"
    assert obs.metres_per_unit is None
    assert obs.unplaced == ()
    assert obs.doubts == ()


def test_the_frame_comes_from_the_photos_where_colmap_knows_none(opencv):
    """COLMAP's frame is arbitrary; GPS of the photos gives metres, vertical and map coordinates."""
    from pyproj import Transformer

    photos, ws = opencv
    plain = Colmap(source=str(ws))(photos)
    assert plain.metres_per_unit is None
    assert plain.source["gravity"] == "cameras and terrain"
    assert np.array_equal(plain.up, (0, 0, 1))
    for number, view in enumerate(plain.views):
        assert np.median(depth_error(view, number)) < 1e-3
        relative = invert_rigid(plain.views[0].T_R_cam) @ view.T_R_cam
        np.testing.assert_allclose(relative, invert_rigid(shots()[0].T) @ shots()[number].T, atol=1e-5)
    back = Transformer.from_crs(32632, 4326, always_xy=True)
    tagged = []
    for photo, shot in zip(photos, shots(), strict=True):
        east, north, up = shot.T[:3, 3] + np.array([500_000, 5_300_000, 400])
        lon, lat = back.transform(east, north)
        tagged.append(replace(photo, gps=GpsFix(lat, lon, up)))
    tied = Colmap(source=str(ws))(tagged)
    assert tied.georeference.epsg == 32632
    assert tied.georeference.residual < 0.02
    assert tied.metres_per_unit == 1.0
    at = np.array([view.centre for view in tied.views]) + tied.georeference.origin - (500_000, 5_300_000, 400)
    assert np.abs(at - [shot.T[:3, 3] for shot in shots()]).max() < 0.05
    ground = tied.views[0].points + np.array(tied.georeference.origin) - (500_000, 5_300_000, 400)
    error = np.linalg.norm(ground - shots()[0].points, axis=-1)
    assert np.nanmedian(error) < 0.05


def test_units_of_the_model_are_the_users_to_say(opencv):
    photos, ws = opencv
    obs = Colmap(source=str(ws), up="-z", metres_per_unit=0.5)(photos)
    assert obs.metres_per_unit == 0.5
    assert np.array_equal(obs.up, (0, 0, -1))
    assert obs.source["gravity"] == "the reconstruction's files"


@pytest.mark.parametrize("given", ["undistorted", "dense folder", "small maps", "photometric", "missing map"])
def test_what_colmap_leaves_behind(tmp_path, opencv, given):
    photos, ws = opencv
    ws = shutil.copytree(ws, tmp_path / "ws")
    maps = ws / "dense" / "stereo" / "depth_maps"
    if given == "undistorted":  # the user gives the undistorted images as photos
        photos = find_photos(ws / "dense" / "images")
        obs = Colmap(source=str(ws), up="z")(photos)
        assert_true(obs)
        assert obs.views[0].lattice.distortion == (0, 0, 0, 0)
    elif given == "dense folder":  # without any model that knows the lens, the original photos do not fit
        shutil.rmtree(ws / "sparse")
        assert_true(Colmap(source=str(ws / "dense"), up="z")(find_photos(ws / "dense" / "images")))
        with pytest.raises(InputError, match=r"shot_00\.png is 228 x 174 px but its camera in .*dense is"):
            Colmap(source=str(ws))(photos)
    elif given == "small maps":  # --PatchMatchStereo.max_image_size
        shutil.rmtree(maps)
        write_depth(ws / "dense", size=(120, 91))
        obs = Colmap(source=str(ws), up="z")(photos)
        assert max(obs.views[0].shape) <= 120
        assert_true(obs, covered=0.8)
    elif given == "photometric":
        for path in maps.iterdir():
            path.rename(path.with_name(path.name.replace("geometric", "photometric")))
        obs = Colmap(source=str(ws), up="z")(photos)
        assert "6 depth maps of" in obs.doubts[0]
        assert "photometric" in obs.doubts[0]
    else:
        (maps / "shot_02.png.geometric.bin").unlink()
        obs = Colmap(source=str(ws), up="z")([*photos, replace(photos[0], name="other.png")])
        assert len(obs.views) == 5
        reasons = {one.name: one.reason for one in obs.unplaced}
        assert "has no pose in" in reasons["other.png"]
        assert "geometric.bin" in reasons["shot_02.png"]


def test_fused_cloud_instead_of_depth_maps(tmp_path, opencv):
    photos, ws = opencv
    ws = shutil.copytree(ws, tmp_path / "ws", ignore=shutil.ignore_patterns("*.bin.geometric", "depth_maps"))
    points = np.concatenate([shot.points[np.isfinite(shot.points[..., 0])] for shot in shots()])
    rows = np.zeros(len(points), dtype=[(a, "<f4") for a in ("x", "y", "z", "nx", "ny", "nz")] + [("red", "u1")])
    rows["x"], rows["y"], rows["z"] = points.T
    head = "ply\nformat binary_little_endian 1.0\n" + f"element vertex {len(rows)}\n"
    head += "".join(f"property float {a}\n" for a in ("x", "y", "z", "nx", "ny", "nz")) + "property uchar red\n"
    (ws / "dense" / "fused.ply").write_bytes((head + "end_header\n").encode() + rows.tobytes())
    obs = Colmap(source=str(ws), up="z")(photos)
    assert_true(obs, tolerance=3e-3, covered=0.8)
    assert "fused.ply instead" in obs.doubts[0]
    assert obs.source["depth"].startswith("point cloud")


@pytest.mark.parametrize("wrong", ["opengl", "inverted"])
def test_a_convention_that_is_not_colmaps_is_named(tmp_path, opencv, wrong):
    """A converter that wrote poses of another convention into a model is caught by the other views."""
    ws = shutil.copytree(opencv[1], tmp_path / "ws")
    change = {"opengl": lambda T: T @ np.diag([1.0, -1, -1, 1]), "inverted": invert_rigid}[wrong]
    poses = {name: change(T) for name, T in POSES.items()}
    model = pycolmap.Reconstruction(ws / "dense" / "sparse")
    cameras = {}
    for image in model.images.values():
        camera = model.camera(image.camera_id)
        cameras[image.name] = spec("PINHOLE", camera.width, camera.height, *camera.params)
    shutil.rmtree(ws / "sparse")
    shutil.rmtree(ws / "dense" / "sparse")
    write_colmap(ws / "dense" / "sparse", cameras, poses)
    said = {"opengl": "OpenGL", "inverted": "world-to-camera"}[wrong]
    with pytest.raises(InputError, match=rf"dense: .*{said}"):
        Colmap(source=str(ws), up="z")(find_photos(ws / "dense" / "images"))


def test_refusals_name_the_file_and_the_command(tmp_path, opencv):
    photos, ws = opencv
    sparse = shutil.copytree(ws / "sparse", tmp_path / "only" / "sparse")
    with pytest.raises(InputError, match=r"colmap image_undistorter .*colmap patch_match_stereo"):
        Colmap(source=str(sparse.parent))(photos)
    with pytest.raises(InputError, match="holds no COLMAP model"):
        Colmap(source=str(tmp_path))(photos)
    with pytest.raises(InputError, match="say which: --reconstructor colmap:PATH"):
        Colmap()(photos)
    with pytest.raises(InputError, match="does not exist"):
        Colmap(source=str(tmp_path / "nowhere"))(photos)
    with pytest.raises(InputError, match=r"Colmap\.up is 'north'"):
        Colmap(up="north")
    damaged = shutil.copytree(ws, tmp_path / "damaged")
    path = damaged / "dense" / "stereo" / "depth_maps" / "shot_01.png.geometric.bin"
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(InputError, match=r"shot_01\.png\.geometric\.bin promises .* but holds"):
        Colmap(source=str(damaged))(photos)
    path.write_bytes(b"nonsense")
    with pytest.raises(InputError, match=r"shot_01\.png\.geometric\.bin is not a depth map of COLMAP"):
        Colmap(source=str(damaged))(photos)
    for file in (damaged / "dense" / "sparse").glob("images.*"):
        file.write_bytes(file.read_bytes()[:50])
    with pytest.raises(InputError, match="cannot be read as a COLMAP model"):
        Colmap(source=str(damaged))(photos)


def test_depth_arrays_are_read_as_colmap_writes_them(tmp_path):
    values = np.arange(1, 13, dtype=np.float32).reshape(3, 4)
    values[1, 2] = 0
    pycolmap.DepthMap.from_array(values, 1.0, 20.0).write(tmp_path / "d.bin")
    found = read_array(tmp_path / "d.bin")
    assert np.isnan(found[1, 2])
    np.testing.assert_array_equal(np.nan_to_num(found), values)


def test_the_door_finds_it_and_scratch_holds_the_views(tmp_path, opencv):
    photos, ws = opencv
    model = catalogue.make("reconstructor", f"colmap:{ws}")
    assert isinstance(model, Colmap)
    assert model.card.name == "colmap"
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    told = []
    obs = model(photos, lambda *step: told.append(step), scratch)
    assert all(isinstance(view.points, np.memmap) for view in obs.views)
    assert told[-1] == ("read depth", len(CAMERAS), len(CAMERAS))
    np.testing.assert_array_equal(obs.views[3].points, model(photos).views[3].points)
    before = model.identity()
    assert before.startswith("pycolmap")
    path = ws / "dense" / "stereo" / "depth_maps" / "shot_00.png.geometric.bin"
    path.write_bytes(path.read_bytes())
    assert model.identity() != before  # written again: another reconstruction


@pytest.mark.parametrize("orientation", [3, 6, 8])
def test_photos_that_are_stored_turned(tmp_path, orientation):
    """COLMAP reads photos as they are stored; the views show them as their EXIF orientation says."""
    intrinsics = spec("OPENCV", W, H, *MODELS["OPENCV"])
    images = {shot.name: distorted(pycolmap.Camera(**intrinsics), shot) for shot in shots()}
    photos = write_photos(tmp_path / "photos", images, orientation=orientation)
    write_colmap(tmp_path / "ws" / "sparse" / "0", dict.fromkeys(POSES, intrinsics), POSES)
    pycolmap.undistort_images(tmp_path / "ws" / "dense", tmp_path / "ws" / "sparse" / "0", tmp_path / "photos")
    write_depth(tmp_path / "ws" / "dense")
    obs = Colmap(source=str(tmp_path / "ws"), up="z")(photos)
    for number, (view, photo, shot) in enumerate(zip(obs.views, photos, shots(), strict=True)):
        assert view.shape == (photo.height, photo.width) == ((H, W) if orientation == 3 else (W, H))
        turned = np.rot90(view.image, {3: 2, 6: 1, 8: 3}[orientation])
        both = np.isfinite(np.rot90(view.points[..., 0], {3: 2, 6: 1, 8: 3}[orientation]))
        assert np.abs(turned[both].astype(float) - shot.image[both]).mean() < 6
        p = view.points[np.isfinite(view.points[..., 0])].astype(float)
        inverse = invert_rigid(shot.T)
        p_cam = p @ inverse[:3, :3].T + inverse[:3, 3]
        error = np.abs(p_cam[:, 2] / true_depth(number, p_cam[:, :2] / p_cam[:, 2:]) - 1)
        assert np.nanmedian(error) < 1e-3
        assert len(p) > 0.8 * np.isfinite(shot.depth).sum()
