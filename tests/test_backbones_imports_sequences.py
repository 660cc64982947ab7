"""transforms.json of nerfstudio, and folders of depth cameras, as their documentation lays them out."""

from __future__ import annotations

import json

import numpy as np
import pycolmap
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from excavatwin.backbones.reconstructors.nerfstudio import Nerfstudio
from excavatwin.backbones.reconstructors.rgbd import Rgbd
from excavatwin.errors import InputError
from excavatwin.scene.frames import invert_rigid
from finished_site import assert_true, depth_error, distorted, shots, spec, write_photos

H, W = shots()[0].depth.shape
K = shots()[0].K
OPENGL = np.diag([1.0, -1, -1, 1])
TERMS = {"k1": -0.12, "k2": 0.03, "p1": 0.002, "p2": -0.003}
OPENCV = pycolmap.Camera(**spec("OPENCV", W, H, K[0, 0], K[1, 1], K[0, 2], K[1, 2], *TERMS.values()))


def distorted_depth(shot):
    """Depth on the pixels of the image with its lens, by the nearest pixel of the image without."""
    v, u = np.mgrid[:H, :W] + 0.5
    xy = OPENCV.cam_from_img(np.stack([u.ravel(), v.ravel()], axis=1))
    col, row = np.floor(xy * K[[0, 1], [0, 1]] + K[:2, 2]).astype(int).T
    inside = (col >= 0) & (row >= 0) & (col < W) & (row < H)
    depth = np.zeros(H * W)
    depth[inside] = np.nan_to_num(shot.depth[row[inside], col[inside]])
    return depth.reshape(H, W)


def write_png(path, depth, per_unit):
    path.parent.mkdir(parents=True, exist_ok=True)
    values = np.round(np.nan_to_num(depth) * per_unit)
    Image.fromarray(np.where(values < 2**16, values, 0).astype(np.uint16)).save(path)  # beyond its range: none


def write_transforms(folder, *, lens=True, shared=True, depth="png", change=lambda T: T @ OPENGL, **more):
    """A data set of nerfstudio: images, depths in millimetres, transforms.json. Returns the photos."""
    images = {shot.name: distorted(OPENCV, shot) if lens else shot.image for shot in shots()}
    photos = write_photos(folder / "images", images)
    numbers = {"fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2], "cy": K[1, 2], "w": W, "h": H}
    numbers |= TERMS if lens else {}
    frames = []
    for shot in shots():
        frame = {"file_path": f"./images/{shot.name}", "transform_matrix": change(shot.T).tolist()}
        frame |= {} if shared else numbers
        found = distorted_depth(shot) if lens else shot.depth
        name = f"depths/{shot.name.removesuffix('.png')}.{depth}"
        if depth == "npy":
            (folder / "depths").mkdir(exist_ok=True)
            np.save(folder / name, np.nan_to_num(found * 1000).astype(np.float32))
        elif depth:
            write_png(folder / name, found, 1000)
        frames.append(frame | ({"depth_file_path": name} if depth else {}))
    meta = {"camera_model": "OPENCV", "frames": frames, **(numbers if shared else {}), **more}
    (folder / "transforms.json").write_text(json.dumps(meta))
    return photos


@pytest.mark.parametrize(("lens", "shared", "depth"), [(True, True, "png"), (True, False, "npy"), (False, True, "npy")])
def test_a_data_set_of_nerfstudio(tmp_path, lens, shared, depth):
    photos = write_transforms(tmp_path, lens=lens, shared=shared, depth=depth)
    obs = Nerfstudio(source=str(tmp_path), up="z", metres_per_unit=1.0)(photos)
    assert_true(obs, tolerance=3e-3 if lens else 1e-4, covered=0.8)
    assert obs.metres_per_unit == 1.0
    assert obs.doubts == ()
    assert obs.views[0].lattice.distortion == pytest.approx(tuple(TERMS.values()) if lens else (0, 0, 0, 0))
    plain = Nerfstudio(source=str(tmp_path / "transforms.json"))(photos)
    assert plain.metres_per_unit is None
    assert any("does not say whether its unit is the metre" in doubt for doubt in plain.doubts)


def test_depth_of_another_unit_and_size(tmp_path):
    """As a phone delivers it: depth coarser than the image, and here in 900ths of a metre."""
    photos = write_transforms(tmp_path, lens=False, depth_unit_scale_factor=1 / 900)
    for shot in shots():
        coarse = shot.depth[1::2, 1::2] * 0.25 + shot.depth[::2, 1::2] * 0.25
        coarse = coarse + shot.depth[1::2, ::2] * 0.25 + shot.depth[::2, ::2] * 0.25
        write_png(tmp_path / "depths" / shot.name, coarse, 900)
    obs = Nerfstudio(source=str(tmp_path), up="z", metres_per_unit=1.0)(photos)
    assert obs.views[0].shape == (H // 2, W // 2)
    assert_true(obs, tolerance=1e-3, covered=0.8)
    told = Nerfstudio(source=str(tmp_path), up="z", depth_unit_scale_factor=1 / 900)(photos)
    np.testing.assert_array_equal(told.views[0].points, obs.views[0].points)


def test_mistakes_of_unit_and_axes_are_named(tmp_path):
    photos = write_transforms(tmp_path, lens=False, depth="npy", depth_unit_scale_factor=1.0)
    with pytest.raises(
        InputError, match=r"transforms\.json: .*the depth is in millimetres while the poses are in metres"
    ):
        Nerfstudio(source=str(tmp_path), up="z")(photos)
    write_transforms(tmp_path, lens=False, change=lambda T: T)
    with pytest.raises(InputError, match=r"transforms\.json: .*OpenGL"):
        Nerfstudio(source=str(tmp_path), up="z")(photos)
    write_transforms(tmp_path, lens=False, change=lambda T: invert_rigid(T @ OPENGL))
    with pytest.raises(InputError, match=r"transforms\.json: .*world-to-camera"):
        Nerfstudio(source=str(tmp_path), up="z")(photos)


def test_a_cloud_stands_in_for_depth(tmp_path):
    photos = write_transforms(tmp_path, depth="", ply_file_path="sparse_pc.ply")
    with pytest.raises(InputError, match=r"neither depth_file_path in its frames nor a ply_file_path that exists"):
        Nerfstudio(source=str(tmp_path))(photos)
    points = np.concatenate([shot.points[np.isfinite(shot.depth)] for shot in shots()])[::2]
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    (tmp_path / "sparse_pc.ply").write_bytes(head.encode() + points.astype("<f4").tobytes())
    obs = Nerfstudio(source=str(tmp_path), up="z", metres_per_unit=1.0)(photos)
    assert_true(obs, tolerance=3e-3, covered=0.8)
    assert "see its cloud instead" in obs.doubts[0]


@pytest.mark.parametrize(
    ("meta", "said"),
    [
        ({"frames": []}, "has no list of frames"),
        ({"frames": [{"transform_matrix": np.eye(4).tolist()}]}, "frame 0 of .* names no file_path"),
        ({"frames": [{"file_path": "a.png", "w": 9, "h": 9}]}, "frame 0 of .* has no focal length"),
        ({"fl_x": 9, "w": 9, "h": 9, "frames": [{"file_path": "a.png"}]}, "frame 0 of .* has no transform_matrix"),
        (
            {"fl_x": 9, "w": 9, "h": 9, "frames": [{"file_path": "a", "transform_matrix": (2 * np.eye(4)).tolist()}]},
            "is no rotation and translation",
        ),
        (
            {"camera_model": "EQUIRECTANGULAR", "fl_x": 9, "w": 9, "h": 9, "frames": [{"file_path": "a.png"}]},
            "camera_model 'EQUIRECTANGULAR'; expected a perspective",
        ),
        ({"fl_x": "nine", "w": 9, "h": 9, "frames": [{"file_path": "a.png"}]}, "has no number 'fl_x'"),
    ],
)
def test_bad_transforms(tmp_path, meta, said):
    photos = write_photos(tmp_path / "images", {"a.png": shots()[0].image})
    (tmp_path / "transforms.json").write_text(json.dumps(meta))
    with pytest.raises(InputError, match=rf"{said}"):
        Nerfstudio(source=str(tmp_path))(photos)


def test_missing_and_wrong_depth_files(tmp_path):
    photos = write_transforms(tmp_path, lens=False)
    (tmp_path / "depths" / "shot_01.png").unlink()
    with pytest.raises(InputError, match=r"depths/shot_01\.png is missing"):
        Nerfstudio(source=str(tmp_path))(photos)
    Image.fromarray(np.zeros((H, W), np.uint8)).save(tmp_path / "depths" / "shot_01.png")
    with pytest.raises(InputError, match=r"shot_01\.png holds 8-bit values"):
        Nerfstudio(source=str(tmp_path))(photos)
    (tmp_path / "depths" / "shot_01.png").write_bytes(b"none")
    with pytest.raises(InputError, match=r"shot_01\.png cannot be read as a depth map"):
        Nerfstudio(source=str(tmp_path))(photos)


def index_centred(K):
    """Intrinsics with the first pixel's centre at 0, as these data sets write them."""
    K = K.copy()
    K[:2, 2] -= 0.5
    return K


def write_tum(folder):
    """rgb.txt, depth.txt and groundtruth.txt, with times of their own, out of step; depth 5000 a metre."""
    photos = write_photos(folder / "rgb")
    lists = {"rgb": ["# colour"], "depth": ["# depth"], "groundtruth": ["# timestamp tx ty tz qx qy qz qw"]}
    for number, shot in enumerate(shots()):
        time = 1305031102.175 + 0.033 * number
        write_png(folder / "depth" / f"d{shot.name}", shot.depth / 5, 5000)
        lists["rgb"].append(f"{time:.6f} rgb/{shot.name}")
        lists["depth"].append(f"{time + 0.007:.6f} depth/d{shot.name}")
        values = [*shot.T[:3, 3] / 5, *Rotation.from_matrix(shot.T[:3, :3]).as_quat()]
        lists["groundtruth"].append(f"{time - 0.004:.6f} " + " ".join(f"{value:.8f}" for value in values))
        lists["groundtruth"].append(f"{time + 0.012:.6f} 9 9 9 0 0 0 1")  # of another moment
    for name, lines in lists.items():
        (folder / f"{name}.txt").write_text("\n".join(lines) + "\n")
    k = index_centred(K)
    (folder / "camera.txt").write_text(f"{k[0, 0]} {k[1, 1]} {k[0, 2]} {k[1, 2]}\n")
    return photos


def test_tum(tmp_path):
    """The site at a fifth of its size: 16 bits at 5000 a metre end at 13 m."""
    photos = write_tum(tmp_path)
    obs = Rgbd(source=str(tmp_path), up="z")(photos)
    assert_true(obs, tolerance=1e-4, metres=5.0)
    assert obs.metres_per_unit == 1.0
    for view, shot in zip(obs.views, shots(), strict=True):
        np.testing.assert_allclose(view.K_cam, shot.K, atol=1e-9)
    lines = (tmp_path / "groundtruth.txt").read_text().splitlines()
    (tmp_path / "groundtruth.txt").write_text("\n".join(lines[:1] + lines[3:]) + "\n")  # the first pose is gone
    obs = Rgbd(source=str(tmp_path), up="z")(photos)
    assert [(one.name, "no pose" in one.reason) for one in obs.unplaced] == [("shot_00.png", True)]
    assert "1 images of" in obs.doubts[0]
    (tmp_path / "groundtruth.txt").write_text("1305031102.175 1 2 3\n")
    with pytest.raises(InputError, match=r"groundtruth\.txt has '1 2 3'; expected tx ty tz qx qy qz qw"):
        Rgbd(source=str(tmp_path))(photos)
    (tmp_path / "depth.txt").write_text("first depth/a.png\n")
    with pytest.raises(InputError, match=r"depth\.txt, line 1, begins with 'first'; expected a time"):
        Rgbd(source=str(tmp_path))(photos)


def write_scannet(folder, log=False):
    """color/, depth/ (half as large, with intrinsics of its own), pose/NAME.txt, intrinsic/."""
    photos = write_photos(folder / "color")
    (folder / "pose").mkdir()
    (folder / "intrinsic").mkdir()
    for shot in shots():
        half = shot.depth[: H // 2 * 2 : 2, : W // 2 * 2 : 2]  # samples at the even pixels
        write_png(folder / "depth" / shot.name, half, 1000)
        np.savetxt(folder / "pose" / f"{shot.name.removesuffix('.png')}.txt", shot.T)
    four = np.eye(4)
    four[:3, :3] = index_centred(K)
    np.savetxt(folder / "intrinsic" / "intrinsic_color.txt", four)
    # Even pixels i of the image are pixels i / 2 of the depth map, and both count from 0.
    four[:2, :3] /= 2
    np.savetxt(folder / "intrinsic" / "intrinsic_depth.txt", four)
    return photos


def test_scannet(tmp_path):
    photos = write_scannet(tmp_path)
    obs = Rgbd(source=str(tmp_path), up="z")(photos)
    assert_true(obs, tolerance=1e-3, covered=0.8)
    lost = tmp_path / "pose" / "shot_04.txt"
    lost.write_text("\n".join(["-inf -inf -inf -inf"] * 4))
    obs = Rgbd(source=str(tmp_path), up="z")(photos)
    assert [one.name for one in obs.unplaced] == ["shot_04.png"]
    assert "tracking lost" in obs.doubts[0]
    lost.write_text("1 2 3\n")
    with pytest.raises(InputError, match=r"shot_04\.txt is 1 x 3; expected a 4 x 4 camera-to-world pose"):
        Rgbd(source=str(tmp_path))(photos)


def test_redwood_log_and_open3d_intrinsics(tmp_path):
    photos = write_photos(tmp_path / "image")
    rows = []
    for number, shot in enumerate(shots()):
        write_png(tmp_path / "depth" / shot.name, shot.depth, 1000)
        rows += [f"{number} {number} {number + 1}", *(" ".join(f"{v:.9f}" for v in row) for row in shot.T)]
    (tmp_path / "trajectory.log").write_text("\n".join(rows) + "\n")
    record = {"width": W, "height": H, "intrinsic_matrix": index_centred(K).T.ravel().tolist()}  # column by column
    (tmp_path / "camera_intrinsic.json").write_text(json.dumps(record))
    assert_true(Rgbd(source=str(tmp_path), up="z")(photos), tolerance=1e-3)
    (tmp_path / "camera_intrinsic.json").unlink()
    with pytest.raises(InputError, match=r"has no intrinsics \(intrinsics\.txt"):
        Rgbd(source=str(tmp_path))(photos)
    values = (K[0, 0], K[1, 1], K[0, 2], K[1, 2])
    assert_true(Rgbd(source=str(tmp_path), up="z", intrinsics=values, first_centre=0.5)(photos), tolerance=1e-3)
    (tmp_path / "trajectory.log").write_text("\n".join(rows[:10]) + "\n")
    with pytest.raises(InputError, match=r"trajectory\.log has 2 poses for 6 images"):
        Rgbd(source=str(tmp_path), intrinsics=values)(photos)


def test_an_rgbd_folder_of_another_unit_is_named(tmp_path):
    """Depth divided by 1 instead of 1000: millimetres taken for metres."""
    photos = write_scannet(tmp_path)
    with pytest.raises(InputError, match="the depth is in millimetres while the poses are in metres"):
        Rgbd(source=str(tmp_path), up="z", depth_per_metre=1.0)(photos)
    with pytest.raises(InputError, match=r"Rgbd\.depth_per_metre is -1"):
        Rgbd(depth_per_metre=-1.0)
    with pytest.raises(InputError, match=r"Rgbd\.intrinsics has 3 numbers"):
        Rgbd(intrinsics=(1.0, 2.0, 3.0))
    with pytest.raises(InputError, match=r"no rgb\.txt and no color/ and depth/"):
        Rgbd(source=str(tmp_path / "color"))(photos)


def test_upright_by_cameras_keeps_metres(tmp_path):
    photos = write_scannet(tmp_path)
    obs = Rgbd(source=str(tmp_path))(photos)
    assert obs.metres_per_unit == 1.0
    assert obs.source["gravity"] == "cameras and terrain"
    assert max(np.median(depth_error(view, n)) for n, view in enumerate(obs.views)) < 1e-3
