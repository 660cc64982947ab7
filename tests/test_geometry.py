"""Gravity, scale, voxels, outliers and object components."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from excavatwin.errors import InputError
from excavatwin.geometry.gravity import Gravity, KeepFrame
from excavatwin.geometry.local_geometry import CovarianceFeatures, NoLocalGeometry
from excavatwin.geometry.objects import NoObjects, Objects
from excavatwin.geometry.outliers import KeepAll, Outliers
from excavatwin.geometry.scale import Reference, Scale
from excavatwin.geometry.voxelize import Voxelize, nice_size
from excavatwin.mapping.raster import Raster
from excavatwin.scene.frames import rotation_between
from excavatwin.scene.grid import Grid
from excavatwin.scene.observations import Lattice, Observations, View
from excavatwin.scene.points import Points
from excavatwin.scene.voxels import Voxels
from hand_built import flat_local, terrain_below, voxelized, voxels_at
from tiny_site import look_at

seeds = st.integers(0, 2**32 - 1)
UP = np.array([0.0, 0.0, 1.0])


# ---- gravity


def _view(name: str, T_R_cam: np.ndarray, points: np.ndarray | None = None) -> View:
    H, W = (4, 6) if points is None else points.shape[:2]
    return View(
        name, np.full((H, W, 3), np.nan, np.float32) if points is None else points.astype(np.float32),
        np.ones((H, W), np.float32), np.zeros((H, W, 5), np.float32), T_R_cam,
        np.array([[10.0, 0, W / 2], [0, 10.0, H / 2], [0, 0, 1]]),
    )  # fmt: skip


def _turned(observations: Observations, R: np.ndarray) -> Observations:
    def turn(view: View) -> View:
        T = view.T_R_cam.copy()
        T[:3] = R @ T[:3]
        return replace(view, points=(view.points.astype(float) @ R.T).astype(np.float32), T_R_cam=T)

    return replace(observations, views=tuple(map(turn, observations.views)))


def _orbit(S: int = 5, depression: float = 8.0) -> Observations:
    eyes = [np.array([10 * np.cos(a), 10 * np.sin(a), depression]) for a in np.arange(S) * 1.1]
    return Observations(tuple(_view(f"{i}", look_at(eye, np.zeros(3))) for i, eye in enumerate(eyes)))


def _strip(S: int = 4, roll: float = 0.0) -> Observations:
    """Parallel nadir photos of ground with two bodies on it."""
    rng = np.random.default_rng(0)
    R = np.array([[np.cos(roll), np.sin(roll), 0], [np.sin(roll), -np.cos(roll), 0], [0, 0, -1]])
    views = []
    for s in range(S):
        x, y = np.meshgrid(3 * s + np.linspace(-6, 6, 30), np.linspace(-5, 5, 24))
        z = rng.normal(0, 0.02, x.shape) + 2.5 * ((np.abs(x - 4) < 1.2) & (np.abs(y) < 2))
        points = np.stack([x, y, z], -1)
        points[:3] = np.nan
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R, (3 * s, 0, 12)
        views.append(_view(f"{s}", T, points))
    return Observations(tuple(views))


tilts = [UP, np.array([0.3, -0.5, 0.8]), np.array([1.0, 0, 0]), -UP, np.array([1e-9, 0, -1.0])]


@pytest.mark.parametrize("up", tilts)
def test_a_known_vertical_is_taken_without_a_doubt(up: np.ndarray) -> None:
    R, doubts = Gravity()(replace(_orbit(), up=2 * up))
    assert doubts == ()
    assert R @ (up / np.linalg.norm(up)) == pytest.approx(UP, abs=1e-9)
    assert np.allclose(R.T @ R, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1)


@pytest.mark.parametrize("up", tilts)
def test_level_cameras_that_look_around_tell_the_vertical(up: np.ndarray) -> None:
    R, doubts = Gravity()(_turned(_orbit(), rotation_between(UP, up)))
    assert R @ (up / np.linalg.norm(up)) == pytest.approx(UP, abs=1e-6)
    assert len(doubts) == 1
    assert "cameras were held level" in doubts[0]


@pytest.mark.parametrize("up", tilts)
@pytest.mark.parametrize("roll", [0.0, 0.7])
def test_the_ground_tells_the_vertical_to_parallel_cameras(up: np.ndarray, roll: float) -> None:
    R, doubts = Gravity()(_turned(_strip(roll=roll), rotation_between(UP, up)))
    assert np.degrees(np.arccos((R @ (up / np.linalg.norm(up)))[2])) < 0.5  # despite the bodies
    assert "ground is level" in doubts[0]


def test_one_camera_is_enough_for_the_ground() -> None:
    R, _ = Gravity()(_strip(S=1))
    assert R[2, 2] > 0.999


def test_the_twin_keeps_the_frame() -> None:
    R, doubts = KeepFrame()(_orbit())
    assert np.array_equal(R, np.eye(3))
    assert doubts == ()


# ---- scale


def _measured(lattice: Lattice | None = None) -> Observations:
    """One view whose pixel (x, y) shows the point (x, y, 0) / 2 of frame R; rows from 20 on have no depth."""
    u, v = np.meshgrid(np.arange(40) + 0.5, np.arange(30) + 0.5)
    points = np.stack([u / 2, v / 2, 0 * u], -1)
    points[20:] = np.nan
    return Observations((replace(_view("a.jpg", np.eye(4), points), lattice=lattice),))


def _reference(a: tuple[float, float], b: tuple[float, float], metres: float, view: str = "a.jpg") -> Reference:
    return Reference(view, (float(a[0]), float(a[1])), (float(b[0]), float(b[1])), metres)


def test_the_scale_without_references() -> None:
    assert Scale()(replace(_measured(), metres_per_unit=0.25)) == (0.25, True, ())
    s, metric, doubts = Scale()(_measured())
    assert (s, metric) == (1.0, False)
    assert "no metric scale is known" in doubts[0]


def test_a_reference_makes_the_scale() -> None:
    s, metric, doubts = Scale((_reference((5.5, 5.5), (25.5, 5.5), 30.0),))(_measured())
    assert s == pytest.approx(3.0)  # 20 pixels are 10 units are 30 m
    assert metric
    assert doubts == ()


def test_references_decide_by_their_median_and_their_disagreement_is_told() -> None:
    ends = ((5.5, 5.5), (25.5, 5.5))
    three = tuple(_reference(*ends, metres) for metres in (30.0, 20.0, 21.0))
    s, _, doubts = Scale(three)(_measured())
    assert s == pytest.approx(2.1)
    assert doubts == ("the reference lengths disagree by 47.6%.",)
    close = tuple(_reference(*ends, metres) for metres in (20.0, 20.3))
    assert Scale(close)(_measured())[2] == ()


def test_a_reference_overrules_the_gps_and_says_so() -> None:
    one = Scale((_reference((5.5, 5.5), (25.5, 5.5), 22.0),))
    s, metric, doubts = one(replace(_measured(), metres_per_unit=2.0))
    assert (s, metric) == (pytest.approx(2.2), True)
    assert doubts == ("the reference length changes the scale of the photos' GPS by +10.0%.",)
    assert one(replace(_measured(), metres_per_unit=2.19))[2] == ()


def test_references_are_pixels_of_the_photo_as_displayed() -> None:
    K = np.array([[100.0, 0, 80], [0, 100, 60], [0, 0, 1]])
    quarter = Lattice(160, 120, np.array([[0.25, 0, 0], [0, 0.25, 0]]), K)
    s, _, _ = Scale((_reference((22.0, 22.0), (102.0, 22.0), 30.0),))(_measured(quarter))
    assert s == pytest.approx(3.0)


def test_the_nearest_pixel_with_depth_serves() -> None:
    hole = _measured()
    points = hole.views[0].points.copy()
    points[4:7, 4:7] = np.nan
    hole = replace(hole, views=(replace(hole.views[0], points=points),))
    scale = Scale((_reference((6.4, 5.5), (25.5, 5.5), 30.0),))
    assert scale.measure(hole, scale.references[0]) == pytest.approx((25.5 - 7.5) / 2)


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        (_reference((5, 5), (9, 9), 1.0, "b.jpg"), "'b.jpg', not a placed photo; placed are a.jpg"),
        (_reference((5, 5), (40.0, 9), 1.0), "outside 'a.jpg'"),
        (_reference((5, 5), (9, -0.5), 1.0), "outside 'a.jpg'"),
        (_reference((5, 5), (9, 29.5), 1.0), "no trustworthy depth"),
        (_reference((5.2, 5.2), (5.7, 5.7), 1.0), "same point"),
    ],
    ids=["unknown photo", "right of it", "above it", "no depth", "two ends in one pixel"],
)
def test_references_that_cannot_be_used(reference: Reference, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Scale((reference,))(_measured())


# ---- voxels


def _points(xyz: np.ndarray, view: np.ndarray | None = None, footprint: float = 0.05) -> Points:
    n = len(xyz)
    return Points(
        xyz=np.asarray(xyz, np.float32), confidence=np.arange(n, dtype=np.float32),
        evidence=np.random.default_rng(0).random((n, 5), np.float32),
        view=np.zeros(n, np.int32) if view is None else view.astype(np.int32), pixel=np.arange(n),
        rgb=(np.arange(3 * n).reshape(n, 3) % 256).astype(np.uint8), centres=np.array([[0.0, 0, 9], [1, 0, 9]]),
        footprint=np.linspace(1, 2, n, dtype=np.float32) * footprint, shapes=((1, n),),
    )  # fmt: skip


@settings(deadline=None, max_examples=20)
@given(seeds, st.floats(0.1, 0.7), st.sampled_from([0.0, -50.0]))
def test_voxels_against_a_dictionary(seed: int, size: float, shift: float) -> None:
    rng = np.random.default_rng(seed)
    points = _points(rng.random((80, 3)) * 2 + shift, np.sort(rng.integers(0, 2, 80)))
    voxels = Voxelize(size=size, k=4)(points, metric=True)
    of: dict[tuple[int, ...], list[int]] = {}
    for i, p in enumerate(points.xyz):
        of.setdefault(tuple(np.floor(p / np.float32(size)).astype(int)), []).append(i)
    assert len(voxels) == len(of)
    for j, key in enumerate(sorted(of)):  # ascending grid order
        members = of[key]
        assert (voxels.of_point[members] == j).all()
        means, colours = [], []
        for s in sorted(set(points.view[members].tolist())):
            own = [i for i in members if points.view[i] == s]
            m = np.flatnonzero((voxels.voxel == j) & (voxels.view == s))
            assert len(m) == 1
            means.append(points.xyz[own].astype(float).mean(axis=0))
            colours.append(points.rgb[own].astype(float).mean(axis=0))
            assert voxels.xyz[m[0]] == pytest.approx(means[-1], rel=1e-5, abs=1e-6)
            assert voxels.evidence[m[0]] == pytest.approx(points.evidence[own].mean(axis=0), rel=1e-5)
            assert voxels.confidence[m[0]] == pytest.approx(points.confidence[own].mean(), rel=1e-5)
        assert voxels.centre[j] == pytest.approx(np.mean(means, axis=0), rel=1e-5, abs=1e-6)
        assert voxels.footprint[j] == points.footprint[members].min()
        assert voxels.rgb[j] == pytest.approx(np.mean(colours, axis=0), rel=1e-5)


def test_the_voxel_size_follows_the_footprint() -> None:
    xyz = np.random.default_rng(0).random((50, 3)) * 5
    assert Voxelize(footprints=3.0)(_points(xyz, footprint=0.1), metric=False).size == pytest.approx(0.45)
    assert Voxelize(footprints=3.0)(_points(xyz, footprint=0.1), metric=True).size == 0.4


def test_the_neighbourhood_shrinks_with_the_cloud() -> None:
    xyz = np.random.default_rng(0).random((9, 3)) * 5
    voxels = Voxelize(size=0.01, k=24)(_points(xyz), metric=True)
    assert len(voxels) == 9
    assert voxels.neighbours.shape == voxels.distances.shape == (9, 8)


@pytest.mark.parametrize(
    ("size", "extent", "message"),
    [
        (1e-6, 100.0, "too small for this scene"),
        (50.0, 1.0, "in 1 voxels; expected thousands"),
    ],
)
def test_sizes_that_make_no_voxels(size: float, extent: float, message: str) -> None:
    xyz = np.random.default_rng(0).random((30, 3)) * extent
    with pytest.raises(InputError, match=message):
        Voxelize(size=size)(_points(xyz), metric=True)


@settings(deadline=None)
@given(st.floats(1e-6, 1e6))
def test_nice_sizes_are_readable_and_not_above(size: float) -> None:
    nice = nice_size(size, True)
    assert 0.74 * size < nice <= size * (1 + 2e-6)
    assert float(f"{nice:.2g}") == pytest.approx(nice, rel=1e-9)
    assert nice_size(size, False) == size
    assert nice_size(nice, True) == nice


@pytest.mark.parametrize(("size", "expected"), [(0.1, 0.1), (0.0999, 0.08), (1.0, 1.0), (1000.0, 1000.0), (0.3, 0.3)])
def test_sizes_that_are_nice_already(size: float, expected: float) -> None:
    assert nice_size(size, True) == expected


# ---- grids: no sample may fall off the map


@settings(deadline=None, max_examples=200)
@given(seeds, st.sampled_from([0.05, 0.1, 0.15, 0.3, 1.0, 0.7]), st.booleans())
def test_no_sample_falls_off_the_map(seed: int, cell: float, aligned: bool) -> None:
    rng = np.random.default_rng(seed)
    on_the_borders = rng.integers(-7, 9, (12, 2)) * cell
    xy = on_the_borders if aligned else rng.normal(0, 3, (12, 2))
    voxels = voxels_at(np.column_stack([xy, np.zeros(12)]), cell)
    cells = Raster()(voxels, flat_local(12))
    assert (cells.of_sample >= 0).all()
    row, col = np.divmod(cells.of_sample, cells.grid.cols)
    hair = 1e-5 * cell
    assert (np.abs(cells.grid.x[col] - voxels.xyz[:, 0]) <= cell / 2 + hair).all()
    assert (np.abs(cells.grid.y[row] - voxels.xyz[:, 1]) <= cell / 2 + hair).all()


def test_places_off_the_grid_are_named() -> None:
    grid = Grid(west=10.0, north=5.0, cell=0.5, rows=4, cols=6)
    xy = np.array([[10.1, 4.9], [12.9, 3.1], [9.9, 4.9], [13.1, 4.9], [10.1, 5.1], [10.1, 2.9], [np.nan, 4]])
    assert grid.flat_index(xy).tolist() == [0, 23, -1, -1, -1, -1, -1]
    corners = np.array([[10.0, 5.0], [13.0, 5.0], [10.0, 3.0], [13.0, 3.0]])
    assert grid.flat_index(corners).tolist() == [0, 5, 18, 23]
    X, Y = np.meshgrid(grid.x, grid.y)
    centres = np.column_stack([X.ravel(), Y.ravel()])
    assert (grid.flat_index(centres) == np.arange(24)).all()


# ---- outliers


def _sheet(rng: np.random.Generator) -> np.ndarray:
    x, y = np.meshgrid(np.arange(40) * 0.2, np.arange(40) * 0.2)
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(1600)]) + rng.uniform(-0.06, 0.06, (1600, 3)) + 20.1


def _amid(voxels: Voxels, x0: float = 20.5, x1: float = 27.5, y0: float = 20.5, y1: float = 27.5) -> np.ndarray:
    """Voxels on the ground away from the border of the sheet, where neighbours are missing on one side."""
    x, y, z = voxels.centre.T
    return (x > x0) & (x < x1) & (y > y0) & (y < y1) & (z < 22)


def test_points_in_the_air_are_outliers_and_the_ground_is_not() -> None:
    rng = np.random.default_rng(0)
    flying = rng.uniform([20, 20, 24], [28, 28, 32], (25, 3))
    voxels = voxelized(np.concatenate([_sheet(rng), flying]), 0.2)
    local = Outliers()(voxels, flat_local(len(voxels)))
    high = voxels.centre[:, 2] > 22
    assert not local.inlier[high].any()
    assert local.inlier[_amid(voxels)].mean() > 0.99


def test_what_is_merely_far_from_the_cameras_is_no_outlier() -> None:
    """Half the scene is sampled three times as coarsely, because its pixels are three times as large."""
    rng = np.random.default_rng(1)
    near, far = _sheet(rng), (_sheet(rng) - 20) * 3 + np.array([60, 0, 20])
    voxels = voxelized(np.concatenate([near, far[:600]]), 0.2)
    beyond = _amid(voxels, 61, 82, 1, 8)
    told = replace(voxels, footprint=np.where(voxels.centre[:, 0] > 40, 0.6, 0.1).astype(np.float32))
    in_metres = replace(voxels, footprint=np.full(len(voxels), 0.1, np.float32))
    assert Outliers()(told, flat_local(len(voxels))).inlier[beyond].mean() > 0.95
    assert Outliers()(in_metres, flat_local(len(voxels))).inlier[beyond].mean() < 0.5


def test_outliers_stay_outliers() -> None:
    voxels = voxelized(_sheet(np.random.default_rng(2)), 0.2)
    before = flat_local(len(voxels), np.arange(len(voxels)) % 7 > 0)
    after = Outliers()(voxels, before)
    assert (after.inlier <= before.inlier).all()
    amid = _amid(voxels)
    assert after.inlier[amid].sum() > 0.99 * before.inlier[amid].sum()
    assert KeepAll()(voxels, before) is before


def test_a_cloud_without_neighbours_has_no_outliers() -> None:
    voxels = voxels_at(np.zeros((1, 3)), 0.1)
    assert Outliers()(voxels, flat_local(1)).inlier.all()


# ---- local geometry


@pytest.mark.parametrize("degrees", [0.0, 20.0, 45.0, 80.0])
def test_slopes_are_the_angle_to_the_vertical(degrees: float) -> None:
    rng = np.random.default_rng(3)
    flat = np.column_stack([rng.uniform(0, 6, (4000, 2)), rng.normal(0, 0.003, 4000)])
    R = rotation_between(UP, np.array([np.sin(np.radians(degrees)), 0, np.cos(np.radians(degrees))]))
    local = CovarianceFeatures()(voxelized(flat @ R.T, 0.2))
    assert np.degrees(np.median(local.slope)) == pytest.approx(degrees, abs=2.0)
    assert (local.normal[:, 2] >= 0).all()
    assert local.roughness.max() < 0.1
    assert (local.curvature >= 0).all()
    assert (local.curvature <= 1 / 3 + 1e-6).all()


def test_the_flat_twin_is_flat() -> None:
    local = NoLocalGeometry()(voxels_at(np.random.default_rng(0).random((5, 3)), 0.1))
    assert not local.slope.any()
    assert not local.roughness.any()
    assert (local.normal == UP).all()
    assert local.inlier.all()


# ---- objects


def _cube(at: tuple[float, float], edge: int, size: float, base: float = 0.3) -> np.ndarray:
    ijk = np.stack(np.meshgrid(*[np.arange(edge)] * 3, indexing="ij"), -1).reshape(-1, 3)
    return ijk * size + np.array([*at, base])


def _yard() -> tuple[Voxels, dict[str, slice]]:
    """Ground, two cubes of one class, one of another touching the first, a low plate and a few loose voxels."""
    size = 0.1
    x, y = np.meshgrid(np.arange(60) * size, np.arange(20) * size)
    plate = np.column_stack([np.tile(np.arange(5), 5) * size + 4, np.repeat(np.arange(5), 5) * size, np.full(25, 0.1)])
    parts = {
        "ground": np.column_stack([x.ravel(), y.ravel(), np.zeros(1200)]),
        "cube": _cube((0, 0), 4, size),
        "twin": _cube((2, 0), 4, size),
        "touching": _cube((0.4, 0), 4, size),
        "plate": plate,
        "loose": np.array([[5, 1, 1], [5.1, 1, 1.1], [5, 1.1, 1]]),
    }
    classes = {"ground": 1, "cube": 4, "twin": 4, "touching": 5, "plate": 5, "loose": 4}
    ends = np.cumsum([0, *(len(p) for p in parts.values())])
    rows = {name: slice(a, b) for name, a, b in zip(parts, ends[:-1], ends[1:], strict=True)}
    evidence = np.zeros((ends[-1], 5))
    for name, k in classes.items():
        evidence[rows[name], k - 1] = 0.8
    return voxels_at(np.concatenate(list(parts.values())), size, evidence=evidence), rows


def test_components_of_the_yard() -> None:
    voxels, rows = _yard()
    terrain = terrain_below(voxels, voxels.centre[:, 2] < 0.05)
    objects = Objects()(voxels, voxels.evidence, flat_local(len(voxels)), terrain)
    ids = {name: set(objects.component[r].tolist()) for name, r in rows.items()}
    assert ids["ground"] == ids["plate"] == ids["loose"] == {0}  # terrain; too low; too small
    solid = [ids[name] for name in ("cube", "twin", "touching")]
    assert sorted(i for s in solid for i in s) == [1, 2, 3]  # each one component, apart or of another class
    assert (objects.task_class[rows["touching"]] == 5).all()
    assert (objects.task_class[rows["cube"]] == 4).all()
    assert ((objects.task_class > 0) == (objects.component > 0)).all()


def test_components_need_height_voxels_and_evidence() -> None:
    voxels, rows = _yard()
    terrain = terrain_below(voxels, voxels.centre[:, 2] < 0.05)
    local = flat_local(len(voxels))
    assert not Objects(min_height=20.0)(voxels, voxels.evidence, local, terrain).component.any()
    assert not Objects(min_voxels=65)(voxels, voxels.evidence, local, terrain).component.any()
    assert not Objects(e_min=0.9)(voxels, voxels.evidence, local, terrain).component.any()
    assert Objects(min_voxels=3)(voxels, voxels.evidence, local, terrain).component[rows["loose"]].all()
    assert Objects(min_height=0.5)(voxels, voxels.evidence, local, terrain).component[rows["plate"]].all()
    outlying = flat_local(len(voxels), np.zeros(len(voxels), bool))
    assert not Objects()(voxels, voxels.evidence, outlying, terrain).component.any()
    everywhere = terrain_below(voxels, np.ones(len(voxels), bool))
    assert not Objects()(voxels, voxels.evidence, local, everywhere).component.any()
    assert NoObjects()(voxels, voxels.evidence, local, terrain) is None


def test_the_least_confident_tenth_of_a_class_is_not_retained() -> None:
    voxels, rows = _yard()
    confidence = np.ones(len(voxels), np.float32)
    confidence[rows["twin"]] = 1e-3  # 64 of 131 excavator voxels
    confidence[rows["touching"]] = 1e-6  # the only obstacle of its kind besides the plate
    doubted = replace(voxels, confidence=confidence)
    terrain = terrain_below(voxels, voxels.centre[:, 2] < 0.05)
    kept = Objects(q=0.6)(doubted, voxels.evidence, flat_local(len(voxels)), terrain).component > 0
    assert kept[rows["cube"]].all()
    assert not kept[rows["twin"]].any()
    kept = Objects(q=0.1)(doubted, voxels.evidence, flat_local(len(voxels)), terrain).component > 0
    assert kept[rows["twin"]].all()
    assert kept[rows["touching"]].all()
