"""Photos to poses: against rendered truth, and with the sets that people really hand in."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from dense_scene import cameras, dig_site, render
from excavatwin.backbones.photogrammetry import Photogrammetry, Placement, Placing
from excavatwin.backbones.photogrammetry.features import extract
from excavatwin.backbones.photogrammetry.matching import choose_pairs, match
from excavatwin.backbones.photogrammetry.placement import PlacedCamera
from excavatwin.backbones.photogrammetry.poses import structure_from_motion
from excavatwin.backbones.photogrammetry.similarity import fit_similarity
from excavatwin.backbones.photogrammetry.undistortion import undistort
from excavatwin.errors import InputError, ReconstructionError
from excavatwin.scene.frames import project, unproject
from excavatwin.scene.observations import Lattice
from excavatwin.scene.photo import GpsFix, Photo
from excavatwin.scene.progress import silent

SIZE = 480, 360
PLACING = Placing(long_side=480, max_features=1500, contrast=0.02)


def photo_of(
    path: Path, focal: float | None, width: int = SIZE[0], height: int = SIZE[1], camera: str = "lens"
) -> Photo:
    return Photo(path.name, path, width, height, camera, focal, "exif-35mm" if focal else "unknown")


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Photo], np.ndarray, float]:
    """Photos of a dig site, six from above and eight on an oblique arc; their true centres; the focal length."""
    folder = tmp_path_factory.mktemp("photos")
    site = dig_site(seed=3, n=640)
    orbit = cameras("oblique", 28, SIZE[0])[:8]
    views = [*cameras("nadir", 9, SIZE[0])[:6], *orbit]
    photos = []
    for i, (K, T) in enumerate(views):
        path = folder / f"{i:02d}.png"
        cv2.imwrite(str(path), render(site, K, T, *SIZE, seed=i)[0][..., ::-1])
        photos.append(photo_of(path, float(K[0, 0])))
    return photos, np.array([T[:3, 3] for _, T in views]), float(views[0][0][0, 0])


@pytest.fixture(scope="module")
def placed(rendered: tuple[list[Photo], np.ndarray, float]) -> Placement:
    return structure_from_motion(rendered[0][6:], PLACING)


def test_oblique_photos_find_their_true_places(
    rendered: tuple[list[Photo], np.ndarray, float], placed: Placement
) -> None:
    photos, centres, focal = rendered
    assert [camera.name for camera in placed.cameras] == [photo.name for photo in photos[6:]]
    found = np.array([camera.T_R_cam[:3, 3] for camera in placed.cameras])
    fit = fit_similarity(found, centres[6:])
    assert fit is not None
    assert fit.residual < 0.06  # of 39 m from camera to ground
    assert placed.cameras[0].K_photo[0, 0] == pytest.approx(focal, rel=0.005)
    assert all(camera.reprojection_error < 0.6 for camera in placed.cameras)


def test_sparse_points_lie_where_their_photos_look(placed: Placement) -> None:
    for camera, visible in zip(placed.cameras, placed.points.visible, strict=True):
        assert len(visible) == camera.n_points > 50
        uv, z = project(camera.K_photo, camera.T_R_cam, placed.points.xyz[visible])
        assert (z > 0).all()
        assert ((uv > -5) & (uv < np.array(SIZE) + 5)).all()


def test_the_same_photos_give_the_same_numbers(
    rendered: tuple[list[Photo], np.ndarray, float], placed: Placement
) -> None:
    again = structure_from_motion(rendered[0][6:], PLACING)
    np.testing.assert_array_equal(again.points.xyz, placed.points.xyz)
    for a, b in zip(again.cameras, placed.cameras, strict=True):
        np.testing.assert_array_equal(a.T_R_cam, b.T_R_cam)


def test_oblique_views_correct_a_wrong_focal_length(rendered: tuple[list[Photo], np.ndarray, float]) -> None:
    photos, _, focal = rendered
    wrong = structure_from_motion([replace(photo, focal=0.96 * focal) for photo in photos[6:]], PLACING)
    assert "refined" in wrong.calibration
    assert wrong.cameras[0].K_photo[0, 0] == pytest.approx(focal, rel=0.01)


def test_views_from_above_keep_the_focal_length_they_came_with(
    rendered: tuple[list[Photo], np.ndarray, float],
) -> None:
    photos, _, focal = rendered
    wrong = structure_from_motion([replace(photo, focal=0.96 * focal) for photo in photos[:6]], PLACING)
    assert "held at its prior" in wrong.calibration
    assert wrong.cameras[0].K_photo[0, 0] == pytest.approx(0.96 * focal, rel=1e-9)
    blind = structure_from_motion([replace(photo, focal=None) for photo in photos[:6]], PLACING)
    assert any("focal length" in doubt for doubt in blind.doubts)


def test_unreadable_and_unrelated_photos_are_named(
    rendered: tuple[list[Photo], np.ndarray, float], tmp_path: Path
) -> None:
    photos, _, focal = rendered
    broken = tmp_path / "broken.jpg"
    broken.write_bytes(b"\xff\xd8\xff\xe0 not a photo")
    rng = np.random.default_rng(0)
    noise = tmp_path / "noise.png"
    cv2.imwrite(str(noise), cv2.resize(rng.integers(0, 255, (90, 120), np.uint8), SIZE))
    seen: list[tuple[str, int, int]] = []
    mixed = [*photos[6:], photo_of(broken, focal), photo_of(noise, focal)]
    placement = structure_from_motion(mixed, PLACING, lambda *step: seen.append(step))
    reasons = {item.name: item.reason for item in placement.unplaced}
    assert set(reasons) == {"broken.jpg", "noise.png"}
    assert "could not be read" in reasons["broken.jpg"]
    assert "features" in reasons["noise.png"]
    assert len(placement.cameras) == 8
    assert {stage for stage, _, _ in seen} == {"features", "matching", "mapping"}
    assert all(0 <= done <= total for _, done, total in seen)


def test_of_two_sites_the_larger_wins_and_the_other_is_named(
    rendered: tuple[list[Photo], np.ndarray, float], tmp_path: Path
) -> None:
    photos, _, focal = rendered
    other = dig_site(seed=11, n=640)
    strangers = []
    for i, (K, T) in enumerate(cameras("nadir", 9, SIZE[0])[:4]):
        path = tmp_path / f"other{i}.png"
        cv2.imwrite(str(path), render(other, K, T, *SIZE, seed=50 + i)[0][..., ::-1])
        strangers.append(photo_of(path, focal))
    placement = structure_from_motion([*strangers, *photos[6:]], PLACING)
    assert {camera.name for camera in placement.cameras} == {photo.name for photo in photos[6:]}
    assert {item.name for item in placement.unplaced} == {photo.name for photo in strangers}
    assert any("detached block of" in item.reason for item in placement.unplaced)


def test_too_few_photos_are_refused_with_advice(rendered: tuple[list[Photo], np.ndarray, float]) -> None:
    with pytest.raises(InputError, match="Found 1 photo"):
        structure_from_motion(rendered[0][:1], PLACING)
    with pytest.raises(InputError, match="Found 0 photo"):
        Photogrammetry().place([])


def test_photos_of_nothing_in_common_are_refused_with_advice(tmp_path: Path) -> None:
    photos = []
    for i in range(3):
        grain = np.random.default_rng(i).integers(0, 255, (90, 120), np.uint8)
        cv2.imwrite(str(tmp_path / f"{i}.png"), cv2.resize(grain, SIZE, interpolation=cv2.INTER_CUBIC))
        photos.append(photo_of(tmp_path / f"{i}.png", 400.0))
    with pytest.raises(ReconstructionError, match="overlap"):
        structure_from_motion(photos, PLACING)


def test_photos_without_any_feature_are_refused_with_advice(tmp_path: Path) -> None:
    photos = [photo_of(tmp_path / f"{i}.png", 400.0) for i in range(3)]
    for photo in photos:
        cv2.imwrite(str(photo.path), np.full((SIZE[1], SIZE[0]), 128, np.uint8))
    with pytest.raises(ReconstructionError, match="0 pairs"):
        structure_from_motion(photos, PLACING)


def test_matches_agree_with_a_plain_search(rendered: tuple[list[Photo], np.ndarray, float]) -> None:
    a, b = extract(rendered[0][6:8], 480, 300, 0.02, silent)[0]
    A, B = a.descriptors.astype(float), b.descriptors.astype(float)
    expected = []
    for i in range(len(A)):
        d = ((A[i] - B) ** 2).sum(1)
        j = int(d.argmin())
        back = ((A - B[j]) ** 2).sum(1)
        if back.argmin() == i and d[j] < 0.64 * np.sort(d)[1] and back[i] < 0.64 * np.sort(back)[1]:
            expected.append((i, j))
    assert len(expected) > 20
    np.testing.assert_array_equal(match(a, b, 0.8), expected)


def test_pairs_follow_gps_where_it_tells_and_looks_where_it_does_not(
    rendered: tuple[list[Photo], np.ndarray, float],
) -> None:
    features = extract(rendered[0], 480, 400, 0.02, silent)[0]
    n = len(features)
    assert len(choose_pairs(features, 4, 24, 0.8)) == n * (n - 1) // 2
    line = [
        replace(item, photo=replace(item.photo, gps=GpsFix(30 + 0.001 * i, -98, None)))
        for i, item in enumerate(features)
    ]
    pairs = choose_pairs(line, 6, 5, 0.8)
    assert {(i, i + 1) for i in range(n - 1)} <= set(pairs)
    assert len(pairs) < n * (n - 1) // 2
    alike = choose_pairs(features, 4, 5, 0.8)
    assert {(i, i + 1) for i in range(6, n - 1)} <= set(alike)
    assert all(i < j for i, j in alike)


LENSES = [(0.0, 0.0, 0.0, 0.0), (-0.12, 0.03, 0.0, 0.0), (0.07, -0.1, 0.002, -0.001)]


@pytest.mark.parametrize("lens", LENSES)
def test_lattice_maps_photo_pixels_as_opencv_does(lens: tuple[float, float, float, float]) -> None:
    K = np.array([[1100.0, 0, 810], [0, 1100, 590], [0, 0, 1]])
    lattice = Lattice(1600, 1200, np.array([[0.4, 0, 0], [0, 0.4, 0]]), K, lens)
    uv = np.random.default_rng(0).uniform([50, 50], [1550, 1150], (200, 2))
    expected = cv2.undistortPoints(
        uv[:, None], K, np.array(lens), P=K, criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-12)
    )[:, 0]
    np.testing.assert_allclose(lattice.from_photo(uv), 0.4 * expected, atol=1e-3)


@pytest.mark.parametrize("lens", LENSES)
def test_undistorted_images_show_photo_pixels_where_the_lattice_says(
    tmp_path: Path, lens: tuple[float, float, float, float]
) -> None:
    K = np.array([[880.0, 0, 640], [0, 880, 480], [0, 0, 1]])
    spots = np.array([[200.5, 180.5], [640.5, 480.5], [1010.5, 300.5], [420.5, 800.5], [1100.5, 760.5]])
    y, x = np.mgrid[:960, :1280] + 0.5
    grey = sum(np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * 6.0**2)) for u, v in spots)
    path = tmp_path / "spots.png"
    cv2.imwrite(str(path), np.round(250 * grey).clip(0, 255).astype(np.uint8))
    camera = PlacedCamera("spots.png", 1280, 960, K, lens, np.eye(4), 0, 0.0)
    posed, lattice = undistort(camera, photo_of(path, 880.0, 1280, 960), 640)
    assert posed.image.shape == (480, 640, 3)
    np.testing.assert_allclose(posed.K_cam, np.diag([0.5, 0.5, 1]) @ K)
    v, u = np.mgrid[:480, :640] + 0.5
    for at in lattice.from_photo(spots):
        near = np.hypot(u - at[0], v - at[1]) < 9
        weight = posed.image[..., 0].astype(float) * near
        centroid = np.array([(u * weight).sum(), (v * weight).sum()]) / weight.sum()
        np.testing.assert_allclose(centroid, at, atol=0.1)


def test_small_photos_are_not_enlarged(rendered: tuple[list[Photo], np.ndarray, float], placed: Placement) -> None:
    posed, lattice = undistort(placed.cameras[0], rendered[0][6], 640)
    assert posed.image.shape[:2] == SIZE[::-1]
    np.testing.assert_array_equal(lattice.affine, [[1, 0, 0], [0, 1, 0]])


def test_unprojected_depth_falls_back_on_its_pixels() -> None:
    rng = np.random.default_rng(1)
    depth = rng.uniform(5, 9, (40, 50)).astype(np.float32)
    depth[3, 4] = np.nan
    K = np.array([[60.0, 0, 25], [0, 61, 19], [0, 0, 1]])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = cv2.Rodrigues(np.array([0.3, -2.0, 0.4]))[0], [3, 4, 5]
    points = unproject(depth, K, T)
    assert np.isnan(points[3, 4]).all()
    uv, z = project(K, T, points)
    v, u = np.mgrid[:40, :50] + 0.5
    seen = np.isfinite(depth)
    np.testing.assert_allclose(uv[seen], np.stack([u, v], -1)[seen], atol=1e-3)
    np.testing.assert_allclose(z[seen], depth[seen], rtol=1e-5)


def test_a_placement_survives_its_file(placed: Placement, tmp_path: Path) -> None:
    full = replace(placed, doubts=("one", "two"), up_from="gimbal", up_doubt=0.7, source={"a": "b"})
    Photogrammetry.save_placement(full, tmp_path)
    back = Photogrammetry.load_placement(tmp_path)
    for name in (
        "unplaced",
        "up_from",
        "up_doubt",
        "metres_per_unit",
        "georeference",
        "doubts",
        "calibration",
        "source",
    ):
        assert getattr(back, name) == getattr(full, name)
    for a, b in zip(full.cameras, back.cameras, strict=True):
        assert (a.name, a.width, a.height, a.distortion, a.n_points) == (
            b.name,
            b.width,
            b.height,
            b.distortion,
            b.n_points,
        )
        np.testing.assert_array_equal(a.T_R_cam, b.T_R_cam)
        np.testing.assert_array_equal(a.K_photo, b.K_photo)
    np.testing.assert_array_equal(full.points.xyz, back.points.xyz)
    for i, j in zip(full.points.visible, back.points.visible, strict=True):
        np.testing.assert_array_equal(i, j)


def test_densify_asks_for_a_photo_that_has_gone(
    rendered: tuple[list[Photo], np.ndarray, float], placed: Placement
) -> None:
    with pytest.raises(InputError, match=r"13\.png was placed"):
        Photogrammetry().densify(placed, rendered[0][6:-1])


@pytest.mark.slow
def test_real_nadir_flight_is_upright_and_metric() -> None:
    root = Path(os.environ.get("EXCAVATWIN_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
    folder = root / "brighton_beach" / "images"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not here; set EXCAVATWIN_DATA to the folder of shared data sets")
    from excavatwin.capture import find_photos

    placement = Photogrammetry().place(find_photos(folder))
    assert len(placement.cameras) == 18
    assert placement.up_from == "gps"
    assert placement.georeference is not None
    assert placement.georeference.residual < 1.0
    assert np.median([camera.reprojection_error for camera in placement.cameras]) < 0.6
