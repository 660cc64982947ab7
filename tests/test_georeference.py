"""Upright and metric from camera centres: exact where it can be, refused where it cannot, and honest in between."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from excavatwin.backbones.photogrammetry.georeference import project, upright
from excavatwin.backbones.photogrammetry.gravity import angle, up_from_cameras, up_from_gimbal
from excavatwin.backbones.photogrammetry.placement import PlacedCamera, Placement, SparsePoints
from excavatwin.backbones.photogrammetry.similarity import fit_similarity, tilt_doubt
from excavatwin.scene.frames import transform
from excavatwin.scene.photo import Gimbal, GpsFix, Photo

UP = np.array([0.0, 0.0, 1.0])
EAST, NORTH = 587600.0, 3338100.0  # UTM 14N, a plausible site


def rotation(rng: np.random.Generator) -> np.ndarray:
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else q[:, [1, 0, 2]]


def looking(centre: np.ndarray, target: np.ndarray, heading: float = 0.0) -> np.ndarray:
    """Camera-to-world pose of a level camera; straight down, its x axis has the given heading."""
    z = (target - centre) / np.linalg.norm(target - centre)
    side = np.array([np.cos(heading), np.sin(heading), 0.0])
    x = side if abs(z[2]) > 0.999 else np.cross(z, UP)
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    T[:3, 3] = centre
    return T


def ground(rng: np.random.Generator, n: int = 800, rough: float = 0.3) -> np.ndarray:
    return np.column_stack([rng.uniform(-50, 50, (n, 2)), rng.normal(0, rough, n)])


def site(poses: list[np.ndarray], points: np.ndarray, seed: int = 0) -> Placement:
    """A placement in an arbitrary frame of what is at ``poses`` in metres, east, north, up."""
    rng = np.random.default_rng(seed)
    s, R, t = 0.07, rotation(rng), rng.normal(size=3)
    K = np.array([[1000.0, 0, 800], [0, 1000, 600], [0, 0, 1]])
    cameras = []
    for i, pose in enumerate(poses):
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R @ pose[:3, :3], s * R @ pose[:3, 3] + t
        cameras.append(PlacedCamera(f"{i}.jpg", 1600, 1200, K, (0.0, 0.0, 0.0, 0.0), T, 100, 0.3))
    visible = tuple(np.arange(len(points)) for _ in poses)
    return Placement(tuple(cameras), SparsePoints(s * points @ R.T + t, visible))


def photographed(
    centres: np.ndarray, altitude: bool = True, gps: bool = True, gimbals: list[Gimbal] | None = None
) -> list[Photo]:
    from pyproj import Transformer

    lon, lat = Transformer.from_crs(32614, 4326, always_xy=True).transform(centres[:, 0] + EAST, centres[:, 1] + NORTH)
    return [
        Photo(
            name=f"{i}.jpg",
            path=Path(f"{i}.jpg"),
            width=1600,
            height=1200,
            camera="x",
            gps=GpsFix(float(lat[i]), float(lon[i]), float(centres[i, 2] + 400) if altitude else None) if gps else None,
            gimbal=None if gimbals is None else gimbals[i],
        )
        for i in range(len(centres))
    ]


def block(n: int = 4, height: float = 40.0, seed: int = 1) -> list[np.ndarray]:
    """Nadir photos on a grid, flown there and back."""
    rng = np.random.default_rng(seed)
    poses = []
    for i in range(n):
        for j in range(n):
            c = np.array([20.0 * i - 30, 20.0 * j - 30, height + rng.normal(0, 0.5)])
            poses.append(looking(c, c - [0, 0, height], heading=np.pi * (i % 2)))
    return poses


def orbit(n: int = 12, radius: float = 30.0, height: float = 25.0) -> list[np.ndarray]:
    a = np.linspace(0, 2 * np.pi, n, endpoint=False)
    return [looking(np.array([radius * np.cos(t), radius * np.sin(t), height]), np.zeros(3)) for t in a]


def centres_of(poses: list[np.ndarray]) -> np.ndarray:
    return np.array([pose[:3, 3] for pose in poses])


def error_of(placed: Placement, poses: list[np.ndarray]) -> float:
    """Largest distance of a camera from where it was, in map coordinates [m]."""
    assert placed.georeference is not None
    found = np.array([camera.T_R_cam[:3, 3] for camera in placed.cameras]) + placed.georeference.origin
    return float(np.abs(found - centres_of(poses) - [EAST, NORTH, 400]).max())


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 10_000), scale=st.floats(1e-3, 1e3), d=st.sampled_from([2, 3]))
def test_similarity_recovers_what_made_it(seed: int, scale: float, d: int) -> None:
    rng = np.random.default_rng(seed)
    R, t, p = rotation(rng)[:d, :d], rng.normal(size=d), rng.normal(size=(12, d))
    if d == 2:
        R = np.array([[np.cos(seed), -np.sin(seed)], [np.sin(seed), np.cos(seed)]])
    fit = fit_similarity(p, scale * p @ R.T + t)
    assert fit is not None
    assert fit.scale == pytest.approx(scale)
    np.testing.assert_allclose(fit.rotation, R, atol=1e-7)
    np.testing.assert_allclose(fit.translation, t, atol=1e-6 * max(scale, 1))
    assert fit.inliers.all()


def test_similarity_ignores_a_third_of_wild_positions() -> None:
    rng = np.random.default_rng(3)
    p = rng.normal(size=(18, 3)) * 30
    q = 2 * p + rng.normal(0, 0.1, p.shape)
    q[:6] += rng.normal(0, 80, (6, 3))
    fit = fit_similarity(p, q)
    assert fit is not None
    assert not fit.inliers[:6].any()
    assert fit.scale == pytest.approx(2, rel=5e-3)
    assert fit.residual < 0.4


def test_tilt_doubt_covers_the_error_it_claims() -> None:
    """Over many noisy tracks the tilt lies within three doubts, and the doubt is no idle exaggeration."""
    ratios = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        p = np.column_stack([rng.uniform(-40, 40, 15), rng.uniform(-15, 15, 15), rng.normal(40, 1, 15)])
        fit = fit_similarity(p, p + rng.normal(0, 1.0, p.shape))
        assert fit is not None
        ratios.append(angle(fit.rotation.T @ UP, UP) / tilt_doubt(fit, p))
    assert np.mean(np.array(ratios) < 3) > 0.95
    assert np.median(ratios) > 0.15


def test_exact_gps_of_a_block_puts_every_camera_on_its_place() -> None:
    poses = block()
    points = ground(np.random.default_rng(0))
    placed = upright(site(poses, points), photographed(centres_of(poses)))
    assert placed.up_from == "gps"
    assert placed.metres_per_unit == 1
    assert placed.georeference is not None
    assert placed.georeference.epsg == 32614
    assert error_of(placed, poses) < 2e-3
    assert np.abs(placed.points.xyz).max() < 100  # local, safe in float32
    np.testing.assert_allclose(placed.points.xyz + placed.georeference.origin - [EAST, NORTH, 400], points, atol=5e-3)


def test_poses_stay_rigid_and_points_stay_on_their_pixels() -> None:
    poses, points = orbit(), ground(np.random.default_rng(0))
    before = site(poses, points)
    after = upright(before, photographed(centres_of(poses)))
    for a, b in zip(before.cameras, after.cameras, strict=True):
        np.testing.assert_allclose(b.T_R_cam[:3, :3] @ b.T_R_cam[:3, :3].T, np.eye(3), atol=1e-12)
        seen_a = transform(np.linalg.inv(a.T_R_cam), before.points.xyz)
        seen_b = transform(np.linalg.inv(b.T_R_cam), after.points.xyz)
        np.testing.assert_allclose(seen_a[:, :2] / seen_a[:, 2:], seen_b[:, :2] / seen_b[:, 2:], atol=1e-9)


@pytest.mark.parametrize("noise", [0.3, 3.0])
def test_one_flight_line_is_refused_for_gravity_but_still_gives_scale(noise: float) -> None:
    rng = np.random.default_rng(5)
    poses = [looking(c, c - [0, 0, 40]) for c in np.column_stack([np.zeros(14), np.linspace(-60, 60, 14), [40.0] * 14])]
    photos = photographed(centres_of(poses) + rng.normal(0, noise, (14, 3)))
    placed = upright(site(poses, ground(rng)), photos)
    assert placed.up_from != "gps"
    assert any("one line" in doubt for doubt in placed.doubts)
    assert placed.georeference is not None
    assert placed.up_doubt is not None
    tilt = angle(np.array([camera.T_R_cam[:3, 2] for camera in placed.cameras]).mean(0), -UP)
    assert tilt < 3 * placed.up_doubt
    spacing = np.ptp([camera.T_R_cam[1, 3] for camera in placed.cameras])
    assert spacing == pytest.approx(120, rel=0.01 if noise < 1 else 0.08)


def test_a_wild_gps_fix_is_named_as_an_outlier() -> None:
    poses = block()
    wrong = centres_of(poses)
    wrong[5] += [300, -200, 50]
    placed = upright(site(poses, ground(np.random.default_rng(0))), photographed(wrong))
    assert error_of(placed, poses) < 0.05
    assert any("1 GPS position(s)" in doubt for doubt in placed.doubts)


def test_a_hand_camera_around_a_small_heap_keeps_its_arbitrary_unit() -> None:
    rng = np.random.default_rng(2)
    poses = orbit(radius=3, height=2)
    photos = photographed(centres_of(poses) + rng.normal(0, 4, (12, 3)))
    placed = upright(site(poses, ground(rng) / 20), photos)
    assert placed.metres_per_unit is None
    assert placed.georeference is None
    assert any("GPS was not used" in doubt for doubt in placed.doubts)
    assert not any("arbitrary" in doubt for doubt in placed.doubts)  # a reference length may still make it metric


def test_missing_altitude_gives_heading_and_scale_and_says_so() -> None:
    poses = block()
    placed = upright(site(poses, ground(np.random.default_rng(0))), photographed(centres_of(poses), altitude=False))
    assert placed.georeference is not None
    assert any("no altitude" in doubt for doubt in placed.doubts)
    found = np.array([camera.T_R_cam[:2, 3] for camera in placed.cameras]) + placed.georeference.origin[:2]
    assert np.abs(found - centres_of(poses)[:, :2] - [EAST, NORTH]).max() < 1.0


def test_without_any_tag_the_map_is_upright_and_says_how() -> None:
    poses = orbit()
    placed = upright(site(poses, ground(np.random.default_rng(0))), photographed(centres_of(poses), gps=False))
    assert placed.up_from == "cameras and terrain"
    assert placed.metres_per_unit is None
    level = [camera.T_R_cam[2, 0] for camera in placed.cameras]
    assert np.degrees(np.abs(np.arcsin(level)).max()) < 0.5
    assert np.median([camera.T_R_cam[2, 3] for camera in placed.cameras]) > 0


def test_gimbal_angles_give_the_vertical() -> None:
    poses = orbit()
    pitch = -np.degrees(np.arctan2(25, 30))
    gimbals = [Gimbal(yaw=0.0, pitch=pitch, roll=0.0) for _ in poses]
    before = site(poses, ground(np.random.default_rng(0)))
    placed = upright(before, photographed(centres_of(poses), gps=False, gimbals=gimbals))
    assert placed.up_from == "gimbal"
    assert np.abs([camera.T_R_cam[2, 0] for camera in placed.cameras]).max() < 1e-6
    np.testing.assert_allclose(
        [camera.T_R_cam[2, 2] for camera in placed.cameras], np.sin(np.radians(pitch)), atol=1e-6
    )


def test_one_gimbal_that_lies_is_outvoted() -> None:
    poses = orbit()
    gimbals = {f"{i}.jpg": Gimbal(0.0, -np.degrees(np.arctan2(25, 30)), 0.0) for i in range(12)}
    gimbals["3.jpg"] = Gimbal(0.0, 10.0, 80.0)
    before = site(poses, ground(np.random.default_rng(0)))
    honest = up_from_gimbal(before.cameras, {k: v for k, v in gimbals.items() if k != "3.jpg"})
    up = up_from_gimbal(before.cameras, gimbals)
    assert up is not None
    assert honest is not None
    assert angle(up.direction, honest.direction) < 0.5


def test_a_rolled_gimbal_turns_the_way_its_maker_means() -> None:
    """Roll clockwise as seen from behind the camera lowers its right side."""
    T = looking(np.zeros(3), np.array([0.0, 10.0, 0.0]))
    a = np.radians(20)
    T[:3, :3] = T[:3, :3] @ np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    assert T[2, 0] < 0  # right side down
    camera = PlacedCamera("a", 1, 1, np.eye(3), (0.0, 0.0, 0.0, 0.0), T, 0, 0.0)
    cameras = [replace(camera, name=name) for name in "abc"]
    up = up_from_gimbal(cameras, {name: Gimbal(0.0, 0.0, 20.0) for name in "abc"})
    assert up is not None
    assert angle(up.direction, UP) < 1e-6


def test_nadir_block_on_a_gentle_slope_stays_near_the_vertical() -> None:
    poses = block()
    points = ground(np.random.default_rng(0))
    points[:, 2] += np.tan(np.radians(5)) * points[:, 0]
    before = site(poses, points)
    up = up_from_cameras(before.cameras, before.points.xyz)
    true = before.cameras[0].T_R_cam[:3, :3] @ poses[0][:3, :3].T @ UP
    assert angle(up.direction, true) < 2
    assert angle(up.direction, true) < 2 * up.doubt


def test_a_cliff_does_not_pass_for_level_ground() -> None:
    """Level cameras in an arc before a wall: the wall's plane is far from what the cameras say and is not believed."""
    rng = np.random.default_rng(0)
    a = np.linspace(-1.2, 1.2, 9)
    poses = [looking(np.array([30 * np.sin(t), -30 * np.cos(t), 2.0]), np.array([0, 0, 2.0])) for t in a]
    wall = np.column_stack([rng.uniform(-20, 20, 600), rng.normal(0, 0.2, 600), rng.uniform(0, 15, 600)])
    before = site(poses, wall)
    up = up_from_cameras(before.cameras, before.points.xyz)
    true = before.cameras[0].T_R_cam[:3, :3] @ poses[0][:3, :3].T @ UP
    assert up.source == "cameras"
    assert angle(up.direction, true) < 3


def test_zone_and_hemisphere() -> None:
    assert project([GpsFix(-33.9, 18.4, 10.0)] * 3)[0] == 32734
    assert project([GpsFix(30.17, -98.09, None)] * 3)[0] == 32614
    assert np.isnan(project([GpsFix(30.17, -98.09, None)])[1][0, 2])
