"""What all readers of finished reconstructions share: lenses, names and sizes of photos, PLY, discs of a cloud."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pycolmap
import pytest

from excavatwin.backbones.finished.clouds import CloudFile, thinned
from excavatwin.backbones.finished.lenses import Lens
from excavatwin.backbones.finished.photo_matching import fitted, match
from excavatwin.backbones.finished.ply import ply_vertices
from excavatwin.backbones.finished.posed_depth import DepthMap, on_lattice, resampled
from excavatwin.backbones.finished.splatting import Camera, Surfels, surfels
from excavatwin.errors import InputError
from excavatwin.kernels import splatting
from excavatwin.scene.frames import invert_rigid, project
from excavatwin.scene.photo import Photo
from finished_site import shots, spec, write_photos

RNG = np.random.default_rng(5)
LENSES = [
    Lens(640, 480, "SIMPLE_PINHOLE", (500.0, 310.0, 250.0)),
    Lens(640, 480, "PINHOLE", (500.0, 505.0, 310.0, 250.0)),
    Lens(640, 480, "SIMPLE_RADIAL", (500.0, 310.0, 250.0, -0.08)),
    Lens(640, 480, "RADIAL", (500.0, 310.0, 250.0, -0.08, 0.02)),
    Lens(640, 480, "OPENCV", (500.0, 505.0, 310.0, 250.0, -0.08, 0.02, 0.004, -0.003)),
    Lens(640, 480, "FULL_OPENCV", (500.0, 505.0, 310.0, 250.0, -0.08, 0.02, 0.004, -0.003, 0.002, 0.0, 0.0, 0.0)),
    Lens(640, 480, "OPENCV_FISHEYE", (900.0, 905.0, 310.0, 250.0, 0.01, -0.02, 0.0, 0.0)),
]


def photo_of(name="a.jpg", width=640, height=480, path=None) -> Photo:
    from pathlib import Path

    return Photo(name, Path(path or f"/photos/{name}"), width, height, "camera")


@pytest.mark.parametrize("turned", range(4))
@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: lens.model)
def test_a_lattice_says_where_photo_pixels_lie(lens: Lens, turned: int):
    """Photo pixels that COLMAP's code finds for rays come back onto those rays through Lattice.from_photo."""
    lens = replace(lens, turned=turned)
    shape = tuple(side // 2 for side in lens.size[::-1])
    lattice, K_cam, error = lens.lattice(shape, "model")
    uv_lattice = RNG.uniform(4, np.array(shape[::-1]) - 4, (300, 2))
    rays = (uv_lattice - K_cam[:2, 2]) / K_cam[[0, 1], [0, 1]]
    back = lattice.from_photo(lens.project(rays))
    assert np.abs(back - uv_lattice).max() < (1e-6 if error == 0 else 1.2 * error + 1e-6)
    assert (error == 0) == (lens.model not in ("FULL_OPENCV", "OPENCV_FISHEYE"))
    assert error < 0.2
    np.testing.assert_allclose(np.vstack([lattice.affine, [0, 0, 1]]) @ lattice.K_photo, K_cam, atol=1e-9)


@pytest.mark.parametrize("turned", range(4))
def test_turning_a_photo_turns_its_lens(turned: int):
    """A ray of the turned camera arrives where the turned photo shows what the stored photo shows."""
    lens = LENSES[4]
    shown = replace(lens, turned=turned)
    rays = RNG.uniform(-0.4, 0.4, (50, 2))
    stored_rays = (np.concatenate([rays, np.ones((50, 1))], axis=1) @ shown.rotation().T)[:, :2]
    picture = np.zeros((480, 640), int)
    for uv, uv_stored in zip(shown.project(rays), lens.project(stored_rays), strict=True):
        picture[:] = 0
        col, row = uv_stored.astype(int)
        picture[row, col] = 1
        row, col = np.argwhere(np.rot90(picture, -turned))[0]
        assert (np.floor(uv) == (col, row)).all()


def test_a_wide_fisheye_has_no_lattice():
    wide = Lens(640, 480, "OPENCV_FISHEYE", (210.0, 210.0, 320.0, 240.0, 0.05, -0.01, 0.0, 0.0))
    with pytest.raises(
        InputError, match=r"^model: lens model OPENCV_FISHEYE cannot be expressed.*undistort the photos"
    ):
        wide.lattice((240, 320), "model")
    with pytest.raises(InputError, match="EQUIRECTANGULAR has no focal length"):
        _ = Lens(640, 320, "EQUIRECTANGULAR", (640.0, 320.0)).K
    with pytest.raises(InputError, match="lens model PINHOLE with 1 parameters is unknown"):
        _ = Lens(640, 320, "PINHOLE", (640.0,)).K


def test_the_photo_on_its_lattice_is_what_a_pinhole_would_have_seen(tmp_path):
    from finished_site import distorted

    shot = shots()[0]
    H, W = shot.depth.shape
    camera = pycolmap.Camera(**spec("OPENCV", W, H, *shot.K[[0, 1, 0, 1], [0, 1, 2, 2]], -0.12, 0.03, 0.002, -0.003))
    photo = write_photos(tmp_path, {shot.name: distorted(camera, shot)})[0]
    lens = Lens(W, H, "OPENCV", tuple(camera.params))
    lattice, K_cam, _ = lens.lattice((H, W), "model")
    image, inside = resampled(photo, lens, K_cam, (H, W))
    unlensed = np.abs(distorted(camera, shot)[inside].astype(float) - shot.image[inside])
    assert inside.mean() > 0.9

    def difference(right: int, down: int) -> float:
        moved = np.roll(image.astype(float), (down, right), (0, 1)) - shot.image
        return float(np.abs(moved[3:-3, 3:-3][inside[3:-3, 3:-3]]).mean())

    assert difference(0, 0) < 0.35 * unlensed.mean()
    for right, down in ((1, 0), (0, 1)):  # half a pixel aside would be nearer to one side
        assert difference(right, down) == pytest.approx(difference(-right, -down), rel=0.06)
    assert lattice.distortion == (-0.12, 0.03, 0.002, -0.003)


def test_depth_between_rasters_is_exact_on_planes_and_keeps_edges():
    """A slanted plane and a nearer wall on a raster of another size and lens, asked on a lattice."""
    lens = Lens(200, 150, "OPENCV", (170.0, 172.0, 104.0, 70.0, -0.1, 0.02, 0.003, -0.002))
    camera = lens._camera
    v, u = np.mgrid[:150, :200] + 0.5
    x, y = camera.cam_from_img(np.stack([u.ravel(), v.ravel()], axis=1)).T
    plane = lambda x, y: 10 / (1 + 0.3 * x - 0.5 * y)  # noqa: E731  # depth of a plane along a ray
    depth = np.where(x > 0.2, 4.0, plane(x, y)).reshape(150, 200).astype(np.float32)
    depth[40:44, 30:34] = np.nan
    found = DepthMap(depth, lens, np.arange(depth.size, dtype=np.float32).reshape(depth.shape))
    K_cam = np.array([[120.0, 0, 66], [0, 120, 50], [0, 0, 1]])
    on, confidence = on_lattice(found, K_cam, (100, 130))
    j, i = np.meshgrid(np.arange(130), np.arange(100))
    lx, ly = (j + 0.5 - 66) / 120, (i + 0.5 - 50) / 120
    true = np.where(lx > 0.2, 4.0, plane(lx, ly))
    known = np.isfinite(on)
    error = np.abs(on / true - 1)[known]
    assert known.mean() > 0.9
    assert not known.all()
    away = np.abs(lx - 0.2)[known] > 0.01
    assert np.quantile(error[away], 0.99) < 1e-5  # but next to the hole, where the nearest pixel answers
    assert error[away].max() < 5e-3
    assert np.isin(np.round(on[known][~away], 2), np.round(np.r_[4.0, true[known]], 2)).mean() > 0.5  # nothing between
    uv = lens.project(np.stack([lx.ravel(), ly.ravel()], axis=1))
    inside = ((uv > 0) & (uv < (200, 150))).all(1)
    cols, rows = uv[inside].astype(int).T
    assert np.array_equal(confidence.ravel()[inside], rows * 200 + cols)


def test_names_are_matched_by_path_then_name_then_stem():
    photos = [photo_of("a.jpg"), photo_of("B.JPG"), photo_of("c.jpg"), photo_of("x.jpg")]
    found = match(["sub/a.jpg", "b.jpg", "c.png", "d.png"], photos, "model")
    assert [(photo.name, index) for photo, index in found.pairs] == [("a.jpg", 0), ("B.JPG", 1), ("c.jpg", 2)]
    assert [(one.name, one.reason) for one in found.unplaced] == [("x.jpg", "has no pose in model")]
    assert found.doubts == ("1 of the 4 images of model have no photo here, d.png among them.",)
    two = [photo_of("a.jpg", path="/p/left/a.jpg")]
    assert match(["right/a.jpg", "left/a.jpg"], two, "model").pairs[0][1] == 1
    with pytest.raises(InputError, match=r"a\.jpg may be 'right/a\.jpg' or 'left/a\.jpg' of model"):
        match(["right/a.jpg", "left/a.jpg"], [photo_of("a.jpg")], "model")
    with pytest.raises(InputError, match=r"none of the 1 photos \(a\.jpg, \.\.\.\) is among the 1 images of model"):
        match(["frame_1.png"], [photo_of("a.jpg")], "model")
    with pytest.raises(InputError, match=r"a\.jpg and a\.png both fit"):
        match(["a.tif"], [photo_of("a.jpg"), photo_of("a.png")], "model")


@pytest.mark.parametrize(("orientation", "turned"), [(1, 0), (3, 2), (6, 1), (8, 3)])
def test_lenses_follow_the_photo(tmp_path, orientation, turned):
    """Another program reads the photo as it is stored; we show it as its EXIF orientation says."""
    image = shots()[0].image
    photo = write_photos(tmp_path, {"a.jpg": image}, ".jpg", orientation)[0]
    H, W = image.shape[:2]
    lens = Lens(W, H, "PINHOLE", (200.0, 210.0, 150.0, 110.0))
    fit, said = fitted(lens, photo, "model")
    assert (fit.turned, fit.size, said) == (turned, (photo.width, photo.height), "")
    double, said = fitted(replace(lens, width=2 * W, height=2 * H), photo, "model")
    assert double.params == (100.0, 105.0, 75.0, 55.0)
    assert "rescaled" in said
    with pytest.raises(InputError, match=r"a\.jpg is .* px but its camera in model is 100 x 300"):
        fitted(replace(lens, width=100, height=300), photo, "model")


def test_mirrored_photos_are_refused(tmp_path):
    image = shots()[0].image
    photo = write_photos(tmp_path, {"a.jpg": image}, ".jpg", 4)[0]
    with pytest.raises(InputError, match="stored mirrored"):
        fitted(Lens(image.shape[1], image.shape[0], "PINHOLE", (200.0, 210.0, 150.0, 110.0)), photo, "model")


XYZ = np.array([[1.5, -2.25, 3.0], [4e5 + 0.125, 5e6 + 0.25, 7.0], [0.0, 0.0, -1.0]])


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_vertices(tmp_path, order):
    """With other properties, another element before, and comments."""
    head = (
        f"ply\nformat {order} 1.0\ncomment made by hand\nelement camera 2\nproperty float f\n"
        "element vertex 3\nproperty uchar red\nproperty double x\nproperty double y\nproperty double z\n"
        "property float nx\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode()
    if order == "ascii":
        body = "1.0\n2.0\n" + "".join(f"7 {x!r} {y!r} {z!r} 0.5\n" for x, y, z in XYZ.tolist()) + "3 0 1 2\n"
        body = body.encode()
    else:
        sign = "<" if "little" in order else ">"
        body = struct.pack(f"{sign}2f", 1, 2) + b"".join(struct.pack(f"{sign}B3df", 7, *p, 0.5) for p in XYZ)
        body += struct.pack(f"{sign}B3i", 3, 0, 1, 2)
    path = tmp_path / "cloud.ply"
    path.write_bytes(head + body)
    np.testing.assert_array_equal(np.concatenate(list(ply_vertices(path).chunks(2))), XYZ)
    np.testing.assert_array_equal(CloudFile(path, np.array([1.0, 2, 3])).sample(), XYZ + np.array([1, 2, 3]))
    path.write_bytes((head + body)[:-40])
    with pytest.raises(InputError, match=r"cloud\.ply (ends before its 3 vertices|holds a vertex)"):
        list(ply_vertices(path).chunks(2))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("hello", "is not a PLY file"),
        ("ply\nformat zip 1.0\nelement vertex 1\nproperty float x\nend_header\n", "no format line"),
        ("ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n", "without plain x, y and z"),
        ("ply\nformat ascii 1.0\nelement face 0\nend_header\n", "no vertices"),
    ],
)
def test_bad_ply(tmp_path, text, said):
    path = tmp_path / "bad.ply"
    path.write_text(text)
    with pytest.raises(InputError, match=rf"bad\.ply .*{said}"):
        ply_vertices(path)


def write_ply(path, xyz):
    rows = "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in np.asarray(xyz, float).tolist())
    head = f"ply\nformat ascii 1.0\nelement vertex {len(xyz)}\n" + "".join(f"property double {a}\n" for a in "xyz")
    path.write_text(f"{head}end_header\n{rows}")
    return CloudFile(path)


def test_clouds_are_thinned_to_one_point_a_cube(tmp_path):
    xyz = RNG.uniform(0, 2, (3000, 3)) + np.array([4e5, 5e6, 100])
    origin = np.array([4e5, 5e6, 100.0])
    kept = thinned(write_ply(tmp_path / "c.ply", xyz), origin, 0.5)
    assert kept.dtype == np.float32
    assert len(kept) == len(np.unique(np.floor((xyz - origin) / 0.5), axis=0)) == 64
    near = np.abs(kept[:, None] - (xyz - origin)[None]).max(-1).min(1)
    assert near.max() < 1e-6
    assert len(thinned(CloudFile(tmp_path / "c.ply"), origin, 0.0)) == 3000


def naive_discs(cloud: Surfels, camera: Camera, least: float, share: float):
    """The kernels' result, disc by disc with whole-image arrays."""
    H, W = camera.shape
    K, T = camera.K_cam, invert_rigid(camera.T_R_cam)
    v, u = np.mgrid[:H, :W] + 0.5
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones_like(u)], axis=-1)
    discs = []
    for p, n, radius in zip(cloud.xyz, cloud.normal, cloud.radius, strict=True):
        c, m = T[:3, :3] @ p.astype(float) + T[:3, 3], T[:3, :3] @ n.astype(float)
        r = max(float(radius), least * c[2] / K[0, 0])
        if c[2] > 2 * r:
            depth = (m @ c) / (rays @ m)
            discs.append((depth, np.linalg.norm(rays * depth[..., None] - c, axis=-1), r))
    nearest = np.min([np.where(d <= r, depth, np.inf) for depth, d, r in discs], axis=0).astype(np.float32)
    weight = [np.where((d <= r) & (depth <= nearest + r), (1 - d**2 / r**2) ** 2 + 1e-6, 0) for depth, d, r in discs]
    total = np.sum([w * depth for w, (depth, _, _) in zip(weight, discs, strict=True)], axis=0)
    covered = np.any([(w > 0) & (d <= share * r) for w, (_, d, r) in zip(weight, discs, strict=True)], axis=0)
    with np.errstate(invalid="ignore"):
        return np.where(covered, total / np.sum(weight, axis=0), np.nan)


def random_discs(seed: int = 2, n: int = 60):
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(n, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    T = np.eye(4)
    T[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    T[:3, :3] *= np.linalg.det(T[:3, :3])
    T[:3, 3] = rng.normal(size=3)
    p = np.stack([rng.uniform(-3, 3, n), rng.uniform(-3, 3, n), rng.uniform(-1, 9, n)], axis=1)
    xyz = (p @ T[:3, :3].T + T[:3, 3]).astype(np.float32)
    cloud = Surfels(xyz, normal.astype(np.float32), rng.uniform(0.05, 0.8, n).astype(np.float32))
    return cloud, Camera(np.array([[30.0, 0, 21], [0, 33, 14], [0, 0, 1]]), T, (32, 40))


@pytest.mark.parametrize("seed", range(4))
def test_disc_kernels_equal_their_naive_twin(seed):
    cloud, camera = random_discs(seed)
    expected = naive_discs(cloud, camera, 0.75, 0.75)
    found = cloud.depth(camera)
    assert 0.1 < np.isfinite(expected).mean() < 1
    assert np.array_equal(np.isfinite(found), np.isfinite(expected))
    np.testing.assert_allclose(found[np.isfinite(found)], expected[np.isfinite(found)], rtol=1e-4)


def test_sampled_depth_equals_its_naive_twin():
    rng = np.random.default_rng(1)
    depth = rng.uniform(4, 4.04, (7, 9)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.1] = np.nan
    depth[:, 6:] += 3
    uv = rng.uniform(-1, 10, (400, 2))
    found = splatting.sample_depth(depth, uv, 0.02)
    for (u, v), value in zip(uv, found, strict=True):
        if not (0 <= u < 9 and 0 <= v < 7):
            assert np.isnan(value)
            continue
        nearest = depth[int(v), int(u)]
        x, y = u - 0.5, v - 0.5  # up to half a pixel beyond the outer centres
        i, j = min(int(max(y, 0)), 5), min(int(max(x, 0)), 7)
        four = depth[i : i + 2, j : j + 2]
        if not np.ptp(four) < 0.02 * nearest:
            assert value == nearest or (np.isnan(value) and np.isnan(nearest))
            continue
        weight = np.outer([1 - (y - i), y - i], [1 - (x - j), x - j])
        assert value == pytest.approx(1 / (weight / four).sum(), rel=1e-6)


def scattered(corner, a, b, n):
    s, t = RNG.random((2, n))
    return np.asarray(corner) + s[:, None] * np.asarray(a, float) + t[:, None] * np.asarray(b, float)


def test_nothing_shines_through_a_wall_of_scattered_points(tmp_path):
    """A wall before a floor: where the wall stands no pixel sees the floor, however the points fall."""
    floor = scattered((-6, 0, -6), (12, 0, 0), (0, 0, 14), 40_000)
    wall = scattered((-2, 0, 1), (4, 0, 0), (0, -3, 0), 2_500)
    cloud = write_ply(tmp_path / "wall.ply", np.concatenate([floor, wall]))
    T = np.eye(4)
    T[:3, 3] = (0, -2, -8)
    camera = Camera(np.array([[200.0, 0, 120], [0, 200, 80], [0, 0, 1]]), T, (160, 240))
    found = surfels(cloud, np.zeros(3), [camera]).depth(camera)
    v, u = np.mgrid[:160, :240] + 0.5
    rays = np.stack([(u - 120) / 200, (v - 80) / 200, np.ones_like(u)], axis=-1)
    at = T[:3, 3] + rays * 9.0  # on the wall's plane, 9 before the camera
    behind = (np.abs(at[..., 0]) < 1.85) & (at[..., 1] > -2.85) & (at[..., 1] < -0.15)
    assert behind.sum() > 3000
    assert (np.abs(found[behind] - 9) < 0.1).mean() > 0.97
    assert np.nanmax(found[behind]) < 9.1
    beside = (np.abs(at[..., 0]) > 2.2) & (rays[..., 1] > 0.2)
    on_floor = 2 / rays[..., 1]
    seen = beside & np.isfinite(found)
    assert seen.sum() > 0.95 * (beside & (on_floor < 13.5)).sum()
    assert np.quantile(np.abs(found / on_floor - 1)[seen], 0.98) < 0.01
    above = rays[..., 1] < -0.15
    assert np.isnan(found[above & (np.abs(at[..., 0]) > 2.3)]).all()  # no cloud there, no depth invented


def test_points_land_on_their_pixels(tmp_path):
    shot = shots()[0]
    cloud = write_ply(tmp_path / "c.ply", shot.points[np.isfinite(shot.points[..., 0])])
    camera = Camera(shot.K, shot.T, shot.depth.shape)
    found = surfels(cloud, np.zeros(3), [camera]).depth(camera)
    uv, z = project(shot.K, shot.T, shot.points)
    assert np.nanmax(np.abs(uv[..., 0] - np.arange(uv.shape[1]) - 0.5)) < 0.01
    both = np.isfinite(found) & np.isfinite(z)
    assert both.sum() > 0.97 * np.isfinite(z).sum()
    assert np.median(np.abs(found / z - 1)[both]) < 1e-3
    away = replace(camera, T_R_cam=shot.T @ np.diag([1.0, -1, -1, 1]))
    with pytest.raises(InputError, match=r"no point of .* lies in any of the photos"):
        surfels(cloud, np.zeros(3), [away])


def test_a_shelf_of_many_views_needs_few_open_files(tmp_path):
    """More views than a program may hold files open; sizes differ, and one has no picture."""
    resource = pytest.importorskip("resource", reason="limits of open files are a matter of Unix")

    from excavatwin.backbones.finished.shelf import Shelf
    from excavatwin.scene.observations import View

    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    shelf = Shelf(tmp_path)
    made = []
    for number in range(200):
        shape = (3 + number % 2, 4)
        made.append(
            View(
                name=f"{number}",
                points=RNG.random((*shape, 3)).astype(np.float32),
                confidence=RNG.random(shape).astype(np.float32),
                evidence=np.broadcast_to(np.float32(0), (*shape, 5)),
                T_R_cam=np.eye(4),
                K_cam=np.eye(3),
                image=None if number == 7 else RNG.integers(0, 255, (*shape, 3), np.uint8),
            )
        )
        shelf.add(made[-1])
    resource.setrlimit(resource.RLIMIT_NOFILE, (100, hard))
    try:
        found = shelf.views()
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert len(found) == 200
    for view, true in zip(found, made, strict=True):
        assert isinstance(view.points, np.memmap)
        np.testing.assert_array_equal(view.points, true.points)
        np.testing.assert_array_equal(view.confidence, true.confidence)
        assert (view.image is None) == (true.image is None)
        if true.image is not None:
            np.testing.assert_array_equal(view.image, true.image)
    found[3].points[:] = 1.0
    assert (shelf.views()[3].points == 1).all()
