"""Boxes, instances, occupancy, rasters, elevation and labels of cells, and what goes into the map."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull, QhullError, cKDTree
from scipy.stats import norm

from excavatwin.errors import InputError
from excavatwin.mapper import Mapper
from excavatwin.mapping.assembly import cell_support
from excavatwin.mapping.boxes import convex_hull, smallest_rectangle, weighted_bounds
from excavatwin.mapping.cell_labels import CellLabels
from excavatwin.mapping.elevation import Elevation
from excavatwin.mapping.instances import Instances
from excavatwin.mapping.occupancy import Occupancy, witnessed
from excavatwin.mapping.raster import Cells, Raster
from excavatwin.scene.labels import Labels
from excavatwin.scene.observations import Georeference
from excavatwin.scene.support import Terrain
from excavatwin.scene.taxonomy import NOT_OBSERVED, Reason, Support, TaskClass
from excavatwin.scene.voxels import Voxels
from hand_built import flat_local, labels_of, terrain_below, voxels_at

relaxed = settings(deadline=None, max_examples=25)
seeds = st.integers(0, 2**32 - 1)


# ---- boxes


def _rotation(degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s], [s, c]])


@relaxed
@given(seeds, st.integers(3, 60), st.booleans())
def test_convex_hull(seed: int, n: int, gridded: bool) -> None:
    rng = np.random.default_rng(seed)
    xy = rng.integers(0, 5, (n, 2)).astype(float) if gridded else rng.normal(size=(n, 2))
    hull = convex_hull(xy)
    try:
        expected = xy[ConvexHull(xy).vertices]  # counter-clockwise in 2D
    except QhullError:  # all on one line
        assert len(hull) <= 2
        return
    start = min(range(len(expected)), key=lambda i: tuple(expected[i]))
    assert hull == pytest.approx(np.roll(expected, -start, axis=0))


def test_hulls_of_points_without_area() -> None:
    assert len(convex_hull(np.zeros((0, 2)))) == 0
    assert convex_hull(np.ones((4, 2))).tolist() == [[1, 1]]
    line = np.outer(np.arange(5.0), [1, 2])
    assert convex_hull(line).tolist() == [[0, 0], [4, 8]]


def _area(hull: np.ndarray, degrees: float) -> float:
    return float(np.ptp(hull @ _rotation(degrees), axis=0).prod())


@relaxed
@given(seeds)
def test_smallest_rectangle_against_all_rotations(seed: int) -> None:
    rng = np.random.default_rng(seed)
    xy = rng.normal(size=(25, 2)) * [3, 1] @ _rotation(rng.uniform(0, 180))
    box = smallest_rectangle(convex_hull(xy))
    least = min(_area(xy, a) for a in np.arange(0, 90, 0.25))
    assert box.length * box.width <= least * (1 + 1e-9)
    assert box.length * box.width > 0.98 * least
    assert box.length >= box.width
    assert -90 <= box.yaw < 90
    local = (xy - box.centre) @ _rotation(box.yaw)  # along and across the box
    assert (np.abs(local) <= np.array([box.length, box.width]) / 2 + 1e-9).all()


@relaxed
@given(seeds, st.floats(-180, 180))
def test_boxes_turn_with_what_they_hold(seed: int, degrees: float) -> None:
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-1, 1, (200, 2)) * [3, 1]
    a = smallest_rectangle(convex_hull(xy))
    b = smallest_rectangle(convex_hull(xy @ _rotation(degrees).T + [10, -4]))
    assert (b.length, b.width) == pytest.approx((a.length, a.width))
    assert b.centre == pytest.approx(_rotation(degrees) @ a.centre + [10, -4])
    turned = (b.yaw - a.yaw - degrees) % 180
    assert min(turned, 180 - turned) < 1e-6


@pytest.mark.parametrize("yaw", [-90.0, -60.0, 0.0, 30.0, 89.0])
def test_a_known_rectangle(yaw: float) -> None:
    corners = np.array([[2, 0.5], [-2, 0.5], [-2, -0.5], [2, -0.5]]) @ _rotation(yaw).T + [7, 8]
    box = smallest_rectangle(convex_hull(corners))
    assert (box.length, box.width) == pytest.approx((4, 1))
    assert box.centre == pytest.approx([7, 8])
    assert abs((box.yaw - yaw + 90) % 180 - 90) < 1e-6
    assert -90 <= box.yaw < 90


def test_the_yaw_stays_in_its_range_to_the_last_bit() -> None:
    for lean in np.linspace(-1e-15, 1e-15, 41):
        box = smallest_rectangle(np.array([[0, 0], [lean, -3.0], [1, -3.0], [1, 0]])[::-1])
        assert -90 <= box.yaw < 90
        box = smallest_rectangle(np.array([[lean, 3.0], [0, 0], [1, 0], [1, 3.0]]))
        assert -90 <= box.yaw < 90


def test_boxes_without_area() -> None:
    point = smallest_rectangle(np.array([[3.0, 4.0]]))
    assert (point.centre.tolist(), point.length, point.width, point.yaw) == ([3, 4], 0, 0, 0)
    line = smallest_rectangle(np.array([[0.0, 0.0], [3.0, 3.0]]))
    assert (line.length, line.width, line.yaw) == (pytest.approx(np.sqrt(18)), pytest.approx(0), pytest.approx(45))
    assert smallest_rectangle(np.zeros((0, 2))).length == 0


# ---- instances


def _bodies(*bodies: tuple[float, float, int, int, int]) -> tuple[Voxels, Labels, list[slice]]:
    """Level ground of 8 m x 4 m, and boxes (x, y, edge along x [voxels], height [voxels], class) standing on it."""
    size = 0.1
    x, y = np.meshgrid(np.arange(80) * size, np.arange(40) * size)
    parts, label = [np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()])], [np.ones(3200)]
    for bx, by, edge, high, k in bodies:
        ijk = np.stack(np.meshgrid(np.arange(edge), np.arange(4), np.arange(1, high + 1), indexing="ij"), -1)
        parts.append(ijk.reshape(-1, 3) * size + np.array([bx, by, 0]))
        label.append(np.full(edge * 4 * high, k))
    ends = np.cumsum([len(p) for p in parts])
    rows = [slice(a, b) for a, b in pairwise(ends)]
    return voxels_at(np.concatenate(parts), size), labels_of(np.concatenate(label)), rows


def _ground(voxels: Voxels) -> Terrain:
    return terrain_below(voxels, voxels.centre[:, 2] < 0.05)


def _instances(
    *bodies: tuple[float, float, int, int, int], stage: Instances | None = None
) -> tuple[list[set[int]], list[set[int]]]:
    voxels, labels, rows = _bodies(*bodies)
    of_voxel, after = (stage or Instances())(voxels, flat_local(len(voxels)), labels, _ground(voxels), metric=False)
    assert (of_voxel[:3200] == 0).all()
    assert (after.label[:3200] == 1).all()
    return [set(of_voxel[r].tolist()) for r in rows], [set(after.label[r].tolist()) for r in rows]


def test_a_fragment_joins_the_body_it_touches() -> None:
    numbers, classes = _instances((1, 1, 20, 10, 4), (3.0, 1, 3, 10, 5))
    assert numbers == [{1}, {1}]
    assert classes == [{4}, {4}]


def test_two_large_bodies_stay_apart_even_when_they_touch() -> None:
    numbers, classes = _instances((1, 1, 12, 10, 4), (2.2, 1, 10, 10, 5))
    assert numbers == [{1}, {2}]
    assert classes == [{4}, {5}]


def test_a_small_body_far_from_a_large_one_keeps_its_class() -> None:
    numbers, classes = _instances((1, 1, 20, 10, 4), (5, 1, 4, 10, 5))
    assert numbers == [{1}, {2}]
    assert classes == [{4}, {5}]


def test_objects_are_numbered_by_size() -> None:
    numbers, _ = _instances((0, 0, 4, 6, 5), (2, 0, 12, 6, 4), (5, 0, 8, 6, 4))
    assert numbers == [{3}, {1}, {2}]


def test_parts_of_one_class_apart_by_less_than_the_radius_are_one() -> None:
    gap = 0.3  # and 0.1 m from voxel to voxel: 0.4 m < 4.5 voxels
    numbers, _ = _instances((1, 1, 8, 10, 4), (1.8 + gap, 1, 8, 10, 4))
    assert numbers == [{1}, {1}]
    numbers, _ = _instances((1, 1, 8, 10, 4), (1.8 + 0.5, 1, 8, 10, 4))
    assert numbers == [{1}, {2}]


def test_what_is_low_or_small_is_no_object() -> None:
    bodies = (1, 1, 12, 2, 5), (4, 1, 1, 3, 5), (6, 1, 1, 2, 4)
    numbers, classes = _instances(*bodies, stage=Instances(min_samples=12))
    assert numbers == [{0}, {1}, {0}]  # 0.2 m high; 12 voxels, 0.3 m high; 8 voxels
    assert classes == [{5}, {5}, {4}]  # the class stays, the object is not made
    assert _instances(*bodies)[0] == [{0}, {0}, {0}]  # and the second is a speck while only one view found it


def _machines(*bodies: tuple[float, float, int, int, int]) -> tuple[list[set[int]], list[set[int]]]:
    voxels, labels, rows = _bodies(*bodies)
    of_voxel, after = Instances()(voxels, flat_local(len(voxels)), labels, _ground(voxels), metric=True)
    return [set(of_voxel[r].tolist()) for r in rows], [set(after.label[r].tolist()) for r in rows]


def test_parts_of_a_boom_belong_to_the_machine_they_can_be_reached_from() -> None:
    machine, stick = (1, 1, 15, 20, 4), (4.2, 1, 3, 10, 4)
    assert _machines(machine, stick) == ([{1}, {1}], [{4}, {4}])  # 1.8 m of boom are missing
    bucket = (6.0, 1, 3, 10, 4)
    assert _machines(machine, stick, bucket) == ([{1}] * 3, [{4}] * 3)  # reached by way of the stick
    assert _machines(machine, bucket) == ([{1}, {2}], [{4}, {5}])  # too far: and too small for a machine
    cone = (4.2, 1, 3, 4, 4)
    assert _machines(machine, cone) == ([{1}, {2}], [{4}, {5}])  # no part of a machine is as low
    assert _machines((1, 1, 15, 20, 5), stick) == ([{1}, {2}], [{5}, {5}])  # an obstacle has no boom
    other = (4.2, 1, 12, 20, 4)
    assert _machines(machine, other) == ([{1}, {2}], [{4}, {4}])  # two machines stay two


def test_a_body_whose_sides_are_missing_is_one() -> None:
    """A roof and the machine's base 1.2 m below it, nothing in between: vertical distances count a quarter."""
    voxels, labels, _ = _bodies((1, 1, 10, 1, 4))
    roof = voxels.centre[3200:] + np.array([0, 0, 1.2], np.float32)
    both = voxels_at(np.concatenate([voxels.centre, roof]), 0.1)
    label = np.concatenate([labels.label, np.full(40, 4)])
    of_voxel, _ = Instances()(both, flat_local(len(both)), labels_of(label), _ground(both), metric=True)
    assert set(of_voxel[3200:].tolist()) == {1}


def test_terrain_and_outliers_are_no_instances() -> None:
    voxels, labels, _ = _bodies((1, 1, 12, 10, 4))
    everywhere = terrain_below(voxels, np.ones(len(voxels), bool))
    assert not Instances()(voxels, flat_local(len(voxels)), labels, everywhere, metric=True)[0].any()
    none = flat_local(len(voxels), np.zeros(len(voxels), bool))
    of_voxel, after = Instances()(voxels, none, labels, _ground(voxels), metric=True)
    assert not of_voxel.any()
    assert (after.label == labels.label).all()


# ---- occupancy


def test_the_highest_of_overlapping_objects_is_named_with_its_own_extent() -> None:
    """A boom (object 1) over a block (object 2), and a cell with the block alone."""
    xyz = np.array([[0.05, 0.05, z] for z in (3.0, 3.2)] + [[0.05, 0.05, z] for z in (0.1, 1.0)]
                   + [[0.15, 0.05, z] for z in (0.1, 0.5, 1.0)] + [[0.25, 0.05, 0.0]])  # fmt: skip
    voxels = voxels_at(xyz, 0.1)
    instance = np.array([1, 1, 2, 2, 2, 2, 2, 0], np.int32)
    cells = Raster()(voxels, flat_local(8))
    named, top, base = Occupancy().rasterize(cells, voxels, instance)
    assert named.tolist() == [[1, 2, 0]]
    assert top[0, :2] == pytest.approx([3.2, 1.0])
    assert base[0, :2] == pytest.approx([3.0, 0.1])
    assert np.isnan([top[0, 2], base[0, 2]]).all()


def test_equal_tops_go_to_the_larger_object() -> None:
    voxels = voxels_at(np.array([[0.05, 0.05, 1.0], [0.05, 0.05, 1.0], [0.15, 0.05, 0.0]]), 0.1)
    cells = Raster()(voxels, flat_local(3))
    for instance in ([1, 2, 0], [2, 1, 0]):
        assert Occupancy().rasterize(cells, voxels, np.array(instance, np.int32))[0].tolist() == [[1, 0]]


def test_outliers_occupy_nothing() -> None:
    voxels = voxels_at(np.array([[0.05, 0.05, 9.0], [0.05, 0.05, 1.0], [0.15, 0.05, 0.0]]), 0.1)
    cells = Raster()(voxels, flat_local(3, np.array([False, True, True])))
    named, top, _ = Occupancy().rasterize(cells, voxels, np.array([2, 1, 0], np.int32))
    assert named.tolist() == [[1, 0]]
    assert top[0, 0] == 1.0


@pytest.mark.parametrize("yaw", [0.0, 35.0])
def test_the_box_of_an_object(yaw: float) -> None:
    rng = np.random.default_rng(0)
    body = rng.uniform([-3, -1, 0], [3, 1, 2], (4000, 3))
    flying = rng.uniform([-9, -9, 0], [9, 9, 6], (8, 3))
    xyz = np.concatenate([body, flying])
    xyz[:, :2] = xyz[:, :2] @ _rotation(yaw).T + [20, 30]
    voxels = voxels_at(xyz + np.array([0, 0, 5.0]), 0.1)
    labels = labels_of(np.full(4008, 5), confidence=0.75)
    terrain = terrain_below(voxels, np.zeros(4008, bool), ground=4.5)
    instance = np.ones(4008, np.int32)
    (box,) = Occupancy()(Raster()(voxels, flat_local(4008)), voxels, labels, terrain, instance).objects
    assert (box.object_id, box.task_class) == (1, TaskClass.OBSTACLE)
    assert box.size == pytest.approx((6, 2, 2.5), rel=0.05)
    assert box.centre == pytest.approx((20, 30, 5.75), abs=0.1)
    assert abs((box.yaw - yaw + 90) % 180 - 90) < 2
    assert box.z_base == pytest.approx(4.5)
    assert box.z_top == pytest.approx(7.0, abs=0.05)
    assert box.confidence == pytest.approx(0.75)
    x, y = box.footprint.T
    assert np.dot(x, np.roll(y, -1)) > np.dot(y, np.roll(x, -1))  # counter-clockwise


def test_a_halo_does_not_widen_the_box_and_a_boom_is_not_cut_off() -> None:
    """A body that eight views find, a skirt around it of one, and a boom of two that stands alone."""
    rng = np.random.default_rng(1)
    body = rng.uniform([-2, -1, 0], [2, 1, 2], (3000, 3))
    skirt = rng.uniform([-2.15, -1.15, 0], [2.15, 1.15, 2], (3000, 3))
    skirt = skirt[(np.abs(skirt[:, 0]) > 2) | (np.abs(skirt[:, 1]) > 1)]
    boom = rng.uniform([3.5, -0.1, 1], [4.5, 0.1, 1.2], (80, 3))
    n = [len(body), len(skirt), len(boom)]
    xyz = np.concatenate([body, skirt, boom])
    seen = np.repeat([8, 1, 2], n)
    voxels = voxels_at(xyz, 0.1, S=8)
    kept = np.repeat(np.arange(8), len(xyz)) < np.tile(seen, 8)
    neighbours = cKDTree(xyz).query(xyz, 25)[1][:, 1:].astype(np.int32)
    voxels = replace(voxels, voxel=voxels.voxel[kept], view=voxels.view[kept], xyz=voxels.xyz[kept],
                     confidence=voxels.confidence[kept], evidence=voxels.evidence[kept],
                     neighbours=neighbours, distances=np.zeros(neighbours.shape, np.float32))  # fmt: skip
    terrain, labels = terrain_below(voxels, np.zeros(len(xyz), bool)), labels_of(np.full(len(xyz), 4))
    instance = np.ones(len(xyz), np.int32)

    def size(stage: Occupancy) -> tuple[float, float, float]:
        weight = witnessed(voxels) ** stage.witnesses
        return stage.box(1, instance == 1, voxels, labels, terrain, weight).size

    length, width, _ = size(Occupancy())
    assert width == pytest.approx(2.0, rel=0.03)
    assert 5.8 < length < 6.5  # its tip is trimmed with the rest, the boom is not
    assert size(Occupancy(witnesses=0))[1] > 2.15  # every voxel alike: the skirt counts


def test_specks_of_one_view_do_not_stretch_a_box_and_a_part_that_few_views_find_keeps_its_length() -> None:
    """A manhole with specks on the ground beside it (caliterra), and a pickup whose bed three views of eight find."""
    rng = np.random.default_rng(2)
    ground = rng.uniform([-5, -2, -0.05], [3, 2, 0.05], (1500, 3))
    manhole = rng.uniform([-1, -0.9, 0.2], [1, 0.9, 1.8], (250, 3))
    specks = rng.uniform([-5, -1.4, 0.17], [-1.5, 1.4, 0.35], (60, 3))
    assert _box_of([(manhole, 4), (specks, 1)], (ground, 4), witnesses=0.0)[0] > 5
    assert _box_of([(manhole, 4), (specks, 1)], (ground, 4))[:2] == pytest.approx((2.0, 1.8), rel=0.08)
    cab = rng.uniform([-3, -1, 0.3], [0, 1, 1.8], (600, 3))
    bed = rng.uniform([0, -1, 0.3], [3, 1, 1.1], (400, 3))
    ground = rng.uniform([-5, -3, -0.05], [5, 3, 0.05], (1500, 3))
    assert _box_of([(cab, 8), (bed, 3)], (ground, 3))[:2] == pytest.approx((6.0, 2.0), rel=0.04)


def _box_of(
    body: list[tuple[np.ndarray, int]], ground: tuple[np.ndarray, int], witnesses: float = Occupancy().witnesses
) -> tuple[float, float, float]:
    """Size of the box of the one object on the ground; every part comes with the number of views that found it."""
    parts = [*body, ground]
    xyz = np.concatenate([part for part, _ in parts])
    seen = np.repeat([views for _, views in parts], [len(part) for part, _ in parts])
    S = int(seen.max())
    kept = np.repeat(np.arange(S), len(xyz)) < np.tile(seen, S)
    neighbours = cKDTree(xyz).query(xyz, 25)[1][:, 1:].astype(np.int32)
    voxels = voxels_at(xyz, 0.1, S=S)
    voxels = replace(voxels, voxel=voxels.voxel[kept], view=voxels.view[kept], xyz=voxels.xyz[kept],
                     confidence=voxels.confidence[kept], evidence=voxels.evidence[kept],
                     neighbours=neighbours, distances=np.zeros(neighbours.shape, np.float32))  # fmt: skip
    member = np.arange(len(xyz)) < len(xyz) - len(ground[0])
    terrain, labels = terrain_below(voxels, ~member), labels_of(np.full(len(xyz), 5))
    return Occupancy().box(1, member, voxels, labels, terrain, witnessed(voxels) ** witnesses).size


@relaxed
@given(seeds, st.sampled_from([0.0, 0.01, 0.1]))
def test_weighted_bounds_against_repetition(seed: int, trim: float) -> None:
    """A point of weight 3 is three points."""
    rng = np.random.default_rng(seed)
    x, weight = rng.normal(size=30), rng.integers(1, 5, 30)
    low, high = weighted_bounds(x, weight.astype(float), trim)
    assert (low, high) == weighted_bounds(np.repeat(x, weight), np.ones(weight.sum()), trim)
    assert weight[x < low].sum() <= trim * weight.sum() + 1e-9
    assert weight[x > high].sum() <= trim * weight.sum() + 1e-9
    if trim == 0:
        assert (low, high) == (x.min(), x.max())


def test_a_map_without_objects() -> None:
    voxels = voxels_at(np.array([[0.05, 0.05, 1.0], [0.15, 0.05, 1.0]]), 0.1)
    cells = Raster()(voxels, flat_local(2))
    occupied = Occupancy()(cells, voxels, labels_of(np.ones(2)), _ground(voxels), np.zeros(2, np.int32))
    assert occupied.objects == ()
    assert not occupied.object_id.any()
    assert np.isnan(occupied.top).all()


# ---- rasters


@relaxed
@given(seeds, st.sampled_from([0.05, 0.25, 0.3]))
def test_grids_lie_at_multiples_of_the_cell(seed: int, cell: float) -> None:
    rng = np.random.default_rng(seed)
    voxels = voxels_at(rng.normal(rng.uniform(-50, 50), 4, (30, 3)), 0.1)
    cells = Raster(cell=cell)(voxels, flat_local(30))
    grid = cells.grid
    for edge in (grid.west, grid.north):
        assert edge / cell == pytest.approx(round(edge / cell), abs=1e-6)
    row, col = np.divmod(cells.of_sample, grid.cols)
    assert (row.min(), col.min()) == (0, 0)  # and no larger than it need be
    assert (row.max(), col.max()) == (grid.rows - 1, grid.cols - 1)
    assert (np.diff(cells.start) == np.bincount(cells.of_sample, minlength=grid.rows * grid.cols)).all()
    assert (cells.member == np.argsort(cells.of_sample, kind="stable")).all()


def test_outliers_do_not_widen_the_map() -> None:
    voxels = voxels_at(np.array([[0.05, 0.05, 0], [0.35, 0.25, 0], [900, 900, 900]]), 0.1)
    cells = Raster()(voxels, flat_local(3, np.array([True, True, False])))
    assert cells.grid.shape == (3, 4)
    assert cells.of_sample.tolist() == [8, 3, -1]


def test_what_is_seen_from_afar_or_flatly_is_no_part_of_the_map() -> None:
    voxels = voxels_at(np.array([[0.05, 0.05, 0], [0.15, 0.05, 0], [60.05, 0.05, 0], [0.25, 0.05, 0]]), 0.1, S=2)
    voxels = replace(voxels, centres=np.array([[0, 0, 10.0], [0, 1, 10.0]]),
                     footprint=np.array([0.05, 0.19, 0.05, 0.21], np.float32))  # fmt: skip
    cells = Raster(max_extent=2.0)(voxels, flat_local(4))
    assert cells.of_sample.tolist() == [0, 1, -1, -1] * 2  # the third under 10 degrees, the fourth by coarse pixels
    assert Raster(max_extent=30.0)(voxels, flat_local(4)).grid.cols == 601
    with pytest.raises(InputError, match="no voxel is seen closely enough"):
        Raster(max_extent=0.1)(voxels, flat_local(4))


@pytest.mark.parametrize(
    ("stage", "message"),
    [
        (Raster(max_cells=11), "cell of 0.1 would make a map of 3 x 4 cells; give a larger cell"),
    ],
)
def test_maps_that_are_not_made(stage: Raster, message: str) -> None:
    voxels = voxels_at(np.array([[0.05, 0.05, 0], [0.35, 0.25, 0]]), 0.1)
    with pytest.raises(InputError, match=message):
        stage(voxels, flat_local(2))


# ---- elevation


def _one_cell(heights: np.ndarray, weight: float = 1.0, size: float = 0.1) -> tuple[float, float]:
    n = len(heights)
    voxels = voxels_at(np.column_stack([np.full((n, 2), size / 2), heights]), size)
    cells = Raster()(voxels, flat_local(n))
    everywhere = terrain_below(voxels, np.ones(n, bool))
    w = np.full(n, weight, np.float32)
    H, sigma = Elevation()(cells, voxels, labels_of(np.ones(n)), everywhere, w)
    return float(H[0, 0]), float(sigma[0, 0])


def test_more_views_make_the_elevation_surer_down_to_a_floor() -> None:
    sigma = [_one_cell(norm.ppf((np.arange(n) + 0.5) / n) * 0.01)[1] for n in (8, 32, 128, 512, 4000)]
    assert (np.diff(sigma) < 0).all()
    assert sigma[-1] > 0.03 * 0.1
    assert sigma[-1] == pytest.approx(0.03 * 0.1, rel=0.2)


def test_one_point_is_as_unsure_as_the_prior_says() -> None:
    H, sigma = _one_cell(np.array([1.25]))
    assert H == 1.25
    assert sigma == pytest.approx(np.sqrt(np.pi / 2 * (0.1 * 0.1) ** 2 / 2 + (0.03 * 0.1) ** 2))


def test_scatter_makes_the_elevation_less_sure_and_weights_alone_do_not() -> None:
    rng = np.random.default_rng(1)
    noise = rng.normal(size=40)
    assert _one_cell(0.05 * noise)[1] > 3 * _one_cell(0.005 * noise)[1]
    assert _one_cell(0.02 * noise, weight=0.1)[1] == pytest.approx(_one_cell(0.02 * noise, weight=1.0)[1], rel=1e-4)
    assert _one_cell(0.2 * noise, size=1.0)[1] == pytest.approx(10 * _one_cell(0.02 * noise, size=0.1)[1], rel=1e-3)


def test_the_standard_deviation_is_that_of_a_median() -> None:
    """Over many cells with independent errors, the medians scatter as widely as the standard deviation says."""
    rng = np.random.default_rng(0)
    n_cells, n = 400, 25
    x = np.repeat(0.05 + 0.1 * np.arange(n_cells), n)
    voxels = voxels_at(np.column_stack([x, 0 * x + 0.05, rng.normal(2, 0.03, len(x))]), 0.1)
    everywhere = terrain_below(voxels, np.ones(len(x), bool))
    stage, weight = Elevation(independent=1.0, floor=0.0), np.ones(len(x), np.float32)
    H, sigma = stage(Raster()(voxels, flat_local(len(x))), voxels, labels_of(np.ones(len(x))), everywhere, weight)
    z = (H - 2) / sigma
    assert 0.8 < np.sqrt((z**2).mean()) < 1.25


def test_only_terrain_by_class_and_support_has_an_elevation() -> None:
    x = 0.05 + 0.1 * np.arange(6)
    voxels = voxels_at(np.column_stack([x, 0 * x + 0.05, np.arange(6.0)]), 0.1)
    labels = labels_of(np.array([1, 2, 3, 4, 0, 1]))
    terrain = terrain_below(voxels, np.array([1, 1, 1, 1, 1, 0], bool))
    H, sigma = Elevation()(Raster()(voxels, flat_local(6)), voxels, labels, terrain, np.ones(6, np.float32))
    assert np.array_equal(H[0], np.array([0, 1] + [np.nan] * 4, np.float32), equal_nan=True)
    assert np.array_equal(np.isnan(sigma), np.isnan(H))


# ---- labels of cells


def _labelled(label: list[int], confidence: list[float], cell: list[int], n_cells: int, **k: float) -> tuple:
    n = len(label)
    x = 0.05 + 0.1 * np.asarray(cell)
    voxels = voxels_at(np.column_stack([x, np.full(n, 0.05), np.zeros(n)]), 0.1)
    labels = replace(labels_of(np.array(label)), confidence=np.array(confidence, np.float32))
    labels = replace(labels, reason=np.where(labels.label > 0, 0, 2 + np.arange(n) % 3).astype(np.uint8))
    cells = Raster()(voxels, flat_local(n))
    assert cells.grid.cols == n_cells
    return tuple(layer[0] for layer in CellLabels(**k)(cells, voxels, labels))


def test_the_votes_of_a_cell_are_weighed_and_unknown_votes_too() -> None:
    label, share, _ = _labelled([1, 1, 4, 0, 4, 0, 0], [0.3, 0.3, 0.9, 0.6, 0.5, 0.2, 0.2], [0, 0, 0, 1, 1, 2, 2], 3)
    assert label.tolist() == [4, 0, 0]
    assert share == pytest.approx([0.9 / 1.5, 0.6 / 1.1, 1.0])


def test_a_vote_never_counts_less_than_the_minimum() -> None:
    label, share, _ = _labelled([1, 1, 1, 4], [0.01, 0.02, 0.03, 0.25], [0, 0, 0, 0], 1, gamma_min=0.1)
    assert label.tolist() == [1]
    assert share == pytest.approx([0.3 / 0.55])


def test_reasons_of_cells() -> None:
    """Voxels 0.. carry the reasons 2, 3, 4, 2, ... where they are unknown; the third cell holds no point."""
    label, share, reason = _labelled([0, 0, 0, 0, 5, 1], [0.9, 0.1, 0.1, 0.1, 0.9, 0.5], [0, 0, 0, 0, 1, 3], 4)
    assert label.tolist() == [0, 5, NOT_OBSERVED, 1]
    assert reason.tolist() == [Reason.INSUFFICIENT, Reason.CLASSIFIED, Reason.UNOBSERVED, Reason.CLASSIFIED]
    assert share[2] == 0


def test_a_cell_with_points_is_observed_whatever_they_say() -> None:
    label, _, reason = _labelled([0, 0], [0.0, 0.0], [0, 1], 2)
    assert label.tolist() == [0, 0]
    assert not (reason == Reason.UNOBSERVED).any()


def test_the_support_of_a_cell_is_that_of_most_of_its_samples() -> None:
    x = 0.05 + 0.1 * np.array([0, 0, 0, 1, 1, 3])
    voxels = voxels_at(np.column_stack([x, 0 * x + 0.05, np.arange(6) * 0.1]), 0.1)
    cells: Cells = Raster()(voxels, flat_local(6))
    support = cell_support(cells, voxels, terrain_below(voxels, np.array([1, 0, 0, 1, 0, 1], bool)))
    assert support.tolist() == [[Support.NON_TERRAIN, Support.TERRAIN, Support.NONE, Support.TERRAIN]]


# ---- the map


def test_the_georeference_and_the_doubts_pass_through(dig_site, dig_site_trace) -> None:
    georeference = Georeference(32632, (500_000.25, 5_300_000.5, 412.0), 0.03)
    told = replace(dig_site, georeference=georeference, doubts=("the lens was guessed.",))
    m = Mapper().trace(told).map
    assert m.georeference is georeference
    assert m.doubts == ("the lens was guessed.",)
    assert m.grid == dig_site_trace.map.grid  # the origin is added by writers only
    assert np.array_equal(m.elevation, dig_site_trace.map.elevation, equal_nan=True)


def test_the_layers_agree_with_each_other(dig_site_trace) -> None:
    m = dig_site_trace.map
    observed = m.observed == 1
    assert (observed == (m.label != NOT_OBSERVED)).all()
    assert (observed == (m.reason != Reason.UNOBSERVED)).all()
    assert (observed == (m.support != Support.NONE)).all()
    assert (np.isfinite(m.elevation) == np.isfinite(m.elevation_std)).all()
    assert (np.isfinite(m.elevation) <= observed).all()
    assert ((m.confidence > 0) == observed).all()
    assert ((m.reason == Reason.CLASSIFIED) == (observed & (m.label > 0))).all()
    occupied = m.object_id > 0
    assert (occupied == np.isfinite(m.object_top)).all()
    assert (m.object_top[occupied] >= m.object_base[occupied]).all()
    assert {o.object_id for o in m.objects} == set(np.unique(m.object_id[occupied]).tolist())
