"""The terrain envelope on shapes whose ground is known: what is dug and heaped stays, what stands on it goes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from excavatwin.geometry.envelope import bridge_gaps, fill_ground, progressive_filter, raised_rims, steep_rims
from excavatwin.geometry.local_geometry import CovarianceFeatures
from excavatwin.geometry.terrain import PointwiseTerrain, TerrainEnvelope
from excavatwin.scene.support import Terrain
from excavatwin.scene.voxels import Voxels
from hand_built import Surface, surface_points, terrain_of, voxelized

CELL = 0.25
#: The site is 20 m x 20 m.
EDGE = 20.0
#: The lowest voxels of a side cannot be told from the ground at its foot.
FOOT = 3 * CELL


def block(x0: float, x1: float, y0: float, y1: float, height: float) -> Surface:
    """A height with vertical sides; a pit when it is negative."""
    return lambda x, y: height * ((x > x0) & (x < x1) & (y > y0) & (y < y1))


def together(*surfaces: Surface) -> Surface:
    return lambda x, y: np.sum([s(x, y) for s in surfaces], axis=0)


def inside(terrain: Terrain, x0: float, x1: float, y0: float, y1: float, margin: float = 0.0) -> np.ndarray:
    """Cells of a rectangle, less a margin [m]."""
    X, Y = np.meshgrid(terrain.grid.x, terrain.grid.y)
    across = np.minimum(X - x0, x1 - X)
    return (across > margin) & (np.minimum(Y - y0, y1 - Y) > margin)


def share_kept(terrain: Terrain, where: np.ndarray) -> float:
    assert where.any()
    return float((terrain.region[where] > 0).mean())


def members_above(voxels: Voxels, terrain: Terrain, height: float) -> int:
    return int((terrain.member & (voxels.centre[:, 2] > height)).sum())


# ---- what is dug stays


@pytest.mark.parametrize(
    "box",
    [(6, 13, 7, 12), (3, 17, 9.5, 10.5), (9, 10.25, 9, 10.25)],
    ids=["pit", "trench", "sounding hole"],
)
@pytest.mark.parametrize("depth", [1.0, 3.0])
def test_a_pit_with_vertical_walls_is_terrain_to_its_floor(box: tuple[float, ...], depth: float) -> None:
    _, terrain = terrain_of(block(*box, -depth))
    assert (terrain.region > 0).all()
    floor = inside(terrain, *box, margin=CELL)
    assert terrain.ground[floor] == pytest.approx(-depth, abs=0.1)
    assert terrain.ground[~inside(terrain, *box, margin=-CELL)] == pytest.approx(0.0, abs=0.1)
    assert terrain.member.all()  # floor, walls and rim


def test_a_bench_around_a_pit_is_terrain() -> None:
    _, terrain = terrain_of(together(block(6.5, 13.5, 6.5, 13.5, -1.2), block(8.5, 11.5, 8.5, 11.5, -1.2)))
    assert (terrain.region > 0).all()


# ---- what is heaped stays


@pytest.mark.parametrize("height", [0.8, 2.0, 4.5])
def test_a_heap_at_its_angle_of_repose_is_terrain(height: float) -> None:
    def heap(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.maximum(0, height - np.tan(np.radians(35)) * np.hypot(x - 10, y - 10))

    _, terrain = terrain_of(heap)
    assert (terrain.region > 0).all()
    assert terrain.member.mean() > 0.99
    assert terrain.ground.max() > height - 0.3


def test_a_long_heap_is_terrain() -> None:
    _, terrain = terrain_of(lambda x, y: np.maximum(0, 2 - 0.7 * np.abs(x + 0.3 * y - 13)))
    assert (terrain.region > 0).all()


def test_a_hillside_is_terrain() -> None:
    _, terrain = terrain_of(lambda x, y: 0.45 * x + 0.3 * np.sin(y))
    assert (terrain.region > 0).all()


@pytest.mark.parametrize(
    "pit",
    [(1.5, 9, 7, 13), (1, 12, 1, 13), (5, 15, 5, 15), (1.5, 18.5, 1.5, 12)],
    ids=["at an edge", "in a corner", "in the middle", "near three edges"],
)
def test_narrow_ground_between_a_pit_and_the_edge_of_the_map_is_terrain(pit: tuple[float, ...]) -> None:
    _, terrain = terrain_of(block(*pit, -1.8))
    assert (terrain.region > 0).all()


@pytest.mark.xfail(strict=True, reason="no way is known yet to tell ground around a pit, smaller than its floor and"
                   " less than two windows wide, from a body that the edge of the map cuts")  # fmt: skip
def test_the_rest_of_the_ground_around_a_pit_that_fills_the_map_is_terrain() -> None:
    _, terrain = terrain_of(block(2, 18, 2, 18, -1.8))
    assert (terrain.region > 0).all()


def test_spoil_along_the_rim_of_a_trench_is_terrain() -> None:
    def site(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return block(11, 12.5, 4, 16, -1.5)(x, y) + np.maximum(0, 1.4 - 0.65 * np.abs(x - 8.5))

    _, terrain = terrain_of(site)
    assert (terrain.region > 0).all()


def test_a_terrace_larger_than_any_body_is_terrain() -> None:
    _, terrain = terrain_of(lambda x, y: 1.5 * (x > 10), stage=TerrainEnvelope(window=4.0))
    assert (terrain.region > 0).all()
    assert terrain.region.max() == 2


def test_a_terrace_with_a_ramp_is_one_region() -> None:
    def terrace(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        ramp = np.clip((x - 8) / 4, 0, 1)
        return 1.5 * np.where(np.abs(y - 10) < 3, ramp, x > 10)

    _, terrain = terrain_of(terrace)
    assert share_kept(terrain, inside(terrain, 0, EDGE, 0, EDGE)) > 0.97
    assert (terrain.region[inside(terrain, 12.5, EDGE, 0, EDGE)] == 1).all()


# ---- what stands on the ground goes


@pytest.mark.parametrize(
    "box",
    [(8, 11, 9, 11), (4, 14, 6, 15), (9, 10, 9, 10), (0, 2.5, 8, 12), (0, 3, 0, 3)],
    ids=["machine", "hall", "post", "at an edge of the map", "in its corner"],
)
def test_a_body_with_steep_sides_is_no_terrain(box: tuple[float, ...]) -> None:
    voxels, terrain = terrain_of(block(*box, 2.2))
    body = inside(terrain, *box, margin=CELL / 2)  # a cell on its side holds the foot of the side: ground
    top = body & (terrain.reference > 2)
    assert top.sum() >= 0.4 * body.sum()
    assert share_kept(terrain, top) == 0
    assert members_above(voxels, terrain, FOOT) == 0
    assert share_kept(terrain, ~inside(terrain, *box, margin=-CELL)) == 1
    assert terrain.ground.max() < FOOT / 2
    assert terrain.height.max() == pytest.approx(2.2, abs=FOOT / 2)


@pytest.mark.parametrize("cells", [1, 2, 3])
def test_a_body_whose_sides_stereo_has_smeared_is_no_terrain(cells: int) -> None:
    def smeared(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        depth_inside = np.minimum.reduce([x - 7, 13 - x, y - 8, 12 - y])
        return 2.2 * np.clip(depth_inside / (cells * CELL), 0, 1)

    voxels, terrain = terrain_of(smeared)
    assert share_kept(terrain, inside(terrain, 7, 13, 8, 12, margin=(cells + 0.5) * CELL)) == 0
    assert members_above(voxels, terrain, 1.0) == 0
    assert share_kept(terrain, ~inside(terrain, 7, 13, 8, 12)) == 1


def test_the_ground_between_bodies_in_a_row_stays() -> None:
    starts = [3, 6, 9, 12, 15]
    voxels, terrain = terrain_of(together(*(block(x, x + 2, 8, 11, 1.8) for x in starts)))
    for x in starts:
        assert share_kept(terrain, inside(terrain, x, x + 2, 8, 11, margin=1.1 * CELL)) == 0
        assert share_kept(terrain, inside(terrain, x + 2, x + 3, 8, 11)) == 1
    assert members_above(voxels, terrain, FOOT) == 0


def test_a_body_beside_a_pit_goes_and_the_pit_stays() -> None:
    box, pit = (13.5, 16.5, 8, 11), (6, 13, 7, 12)
    voxels, terrain = terrain_of(together(block(*pit, -1.8), block(*box, 2.0)))
    assert share_kept(terrain, inside(terrain, *box, margin=CELL)) == 0
    assert share_kept(terrain, ~inside(terrain, *box)) == 1
    assert terrain.ground[inside(terrain, *pit, margin=CELL)] == pytest.approx(-1.8, abs=0.1)
    assert members_above(voxels, terrain, FOOT) == 0


def test_a_body_in_a_pit_goes_and_the_pit_stays() -> None:
    box, pit = (9, 11, 9, 11), (6.25, 13.75, 6.25, 13.75)
    _, terrain = terrain_of(together(block(*pit, -2.5), block(*box, 1.5)))
    assert share_kept(terrain, inside(terrain, *box, margin=CELL)) == 0
    assert share_kept(terrain, ~inside(terrain, *box)) == 1
    assert terrain.ground[inside(terrain, *box, margin=CELL)] == pytest.approx(-2.5, abs=0.1)


def test_a_body_on_a_slope_goes() -> None:
    box = (8, 11, 9, 11)
    _, terrain = terrain_of(lambda x, y: np.where(block(*box, 1)(x, y) > 0, 0.3 * 9.5 + 2, 0.3 * x))
    assert share_kept(terrain, inside(terrain, *box, margin=CELL)) == 0
    assert share_kept(terrain, ~inside(terrain, *box)) > 0.999
    assert terrain.ground[inside(terrain, *box)] == pytest.approx(0.3 * 9.5, abs=0.5)


# ---- gaps, scale, twins


def test_sparse_cells_are_bridged() -> None:
    rng = np.random.default_rng(0)
    seen = rng.random((80, 80)) < 0.6
    box = (13, 16, 13, 16)
    voxels, terrain = terrain_of(together(block(*box, 2.0), block(6.5, 10, 6.5, 10, -1.5)), seen=seen)
    observed = np.isfinite(terrain.reference)
    assert (observed <= np.isfinite(bridge_gaps(terrain.reference, 2.0))).all()
    assert (terrain.region[~observed] == 0).all()  # bridged for reasoning, not mapped
    assert share_kept(terrain, inside(terrain, *box, margin=CELL) & observed) < 0.03
    assert share_kept(terrain, ~inside(terrain, *box) & observed) > 0.97
    assert members_above(voxels, terrain, FOOT) == 0


def test_bridging_reaches_as_far_as_it_says() -> None:
    H = np.full((5, 12), np.nan, np.float32)
    H[:, 0], H[:, -1] = 1.0, 5.0
    bridged = bridge_gaps(H, 2.0)
    expected = [1, 1, 1, np.nan, np.nan, np.nan, np.nan, np.nan, np.nan, 5, 5, 5]
    assert np.array_equal(bridged, np.tile(np.float32(expected), (5, 1)), equal_nan=True)
    assert bridge_gaps(H, 0.0) is H
    nothing = np.full((3, 3), np.nan, np.float32)
    assert np.isnan(bridge_gaps(nothing, 2.0)).all()


@pytest.mark.parametrize("metric", [True, False])
def test_the_window_is_in_metres_or_a_share_of_the_scene(metric: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    windows: list[float] = []
    raised = TerrainEnvelope.raised

    def noted(self: TerrainEnvelope, H: np.ndarray, size: float, window: float) -> np.ndarray:
        windows.append(window)
        return raised(self, H, size, window)

    monkeypatch.setattr(TerrainEnvelope, "raised", noted)
    stage = TerrainEnvelope(window=3.0, window_share=0.15)
    terrain_of(lambda x, y: 0 * x, rows=40, cols=40, stage=stage, metric=metric)
    assert windows == [pytest.approx(3.0 if metric else 0.15 * 40 * CELL)]


def test_the_pointwise_twin_keeps_islands() -> None:
    """A roof too wide for the filter is an island behind steep faces; without continuity nothing discards it."""
    roof = block(4, 16, 5, 15, 2.0)
    stage = TerrainEnvelope(window=6.0)
    _, whole = terrain_of(roof, stage=stage)
    _, pointwise = terrain_of(roof, stage=PointwiseTerrain(window=6.0))
    top = inside(whole, 4, 16, 5, 15, margin=CELL)
    assert share_kept(whole, top) == 0
    assert share_kept(pointwise, top) == 1
    assert set(np.unique(pointwise.region)) <= {0, 1}


# ---- laws


def _mixed(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    heap = np.maximum(0, 1.5 - 0.7 * np.hypot(x - 15, y - 15))
    return together(block(2, 6, 3, 8, -1.5), block(9, 12, 9, 11, 2.0))(x, y) + heap + 0.05 * x


def test_a_constant_offset_of_the_heights_changes_nothing_else() -> None:
    _, terrain = terrain_of(_mixed)
    _, lifted = terrain_of(lambda x, y: _mixed(x, y) + 64 * CELL)
    assert (lifted.region == terrain.region).all()
    assert (lifted.member == terrain.member).all()
    assert lifted.ground == pytest.approx(terrain.ground + 64 * CELL, abs=1e-4)
    assert np.quantile(np.abs(lifted.height - terrain.height), 0.99) < 1e-4


@pytest.mark.parametrize("factor", [0.01, 8.0])
def test_everything_scales_with_the_scene_when_its_scale_is_unknown(factor: float) -> None:
    xyz = surface_points(_mixed, CELL, 80, 80)
    voxels, scaled = voxelized(xyz, CELL), voxelized(factor * xyz, factor * CELL)
    terrain, other = (TerrainEnvelope()(v, CovarianceFeatures()(v), False) for v in (voxels, scaled))
    assert other.region.shape == terrain.region.shape
    assert (other.region == terrain.region).mean() > 0.999
    assert np.median(np.abs(other.ground / factor - terrain.ground)) < 1e-4
    assert len(scaled) == pytest.approx(len(voxels), rel=0.01)
    assert other.member.mean() == pytest.approx(terrain.member.mean(), abs=0.005)


seeds = st.integers(0, 2**32 - 1)


def _random_ground(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    H = np.cumsum(rng.normal(0, 0.05, (24, 26)), axis=1)
    for _ in range(3):
        y, x = rng.integers(0, 20, 2)
        H[y : y + rng.integers(1, 9), x : x + rng.integers(1, 9)] += rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 2)
    H[rng.random(H.shape) < 0.15] = np.nan
    return H.astype(np.float32)


def _regions(stage: TerrainEnvelope, H: np.ndarray, size: float, window: float) -> np.ndarray:
    bridged = bridge_gaps(H, stage.gap)
    return stage.regions(bridged, ~stage.raised(bridged, size, window), size, window)


@settings(deadline=None, max_examples=20)
@given(seeds, st.integers(-40, 40))
def test_regions_do_not_know_the_datum_nor_the_unit(seed: int, offset: int) -> None:
    H, stage = _random_ground(seed), TerrainEnvelope()
    H = np.round(H * 256) / 256  # sums and multiples of these are exact
    region = _regions(stage, H, 0.2, 3.0)
    assert (_regions(stage, H + np.float32(offset), 0.2, 3.0) == region).all()
    assert (_regions(stage, H * np.float32(4), 0.8, 12.0) == region).all()


@settings(deadline=None, max_examples=20)
@given(seeds, st.integers(0, 3), st.booleans())
def test_regions_turn_and_mirror_with_the_map(seed: int, turns: int, mirrored: bool) -> None:
    def turned(A: np.ndarray) -> np.ndarray:
        A = np.rot90(A, turns)
        return np.ascontiguousarray(A[::-1] if mirrored else A)

    H, stage = _random_ground(seed), TerrainEnvelope()
    raised = progressive_filter(H, 0.2, 3.0, 0.08, 0.3)
    other_raised = progressive_filter(turned(H), 0.2, 3.0, 0.08, 0.3)
    assert (other_raised == turned(raised)).all()
    assert (turned(stage.faces(H, 0.2)) == stage.faces(turned(H), 0.2)).all()
    assert (turned(stage.raised(H, 0.2, 3.0)) == stage.raised(turned(H), 0.2, 3.0)).all()


@settings(deadline=None, max_examples=25)
@given(seeds, st.floats(0, 1))
def test_the_ground_is_everywhere_finite_and_is_the_terrain_where_there_is_some(seed: int, share: float) -> None:
    H = _random_ground(seed)
    terrain = np.isfinite(H) & (np.random.default_rng(seed).random(H.shape) < share)
    ground = fill_ground(H, terrain)
    assert np.isfinite(ground).all()
    assert (ground[terrain] == H[terrain]).all()
    known = H[terrain] if terrain.any() else H[np.isfinite(H)]
    assert ground.min() >= known.min() - 1e-4
    assert ground.max() <= known.max() + 1e-4


def test_the_ground_of_a_map_without_heights_is_zero() -> None:
    nothing = np.full((3, 4), np.nan, np.float32)
    assert (fill_ground(nothing, np.zeros((3, 4), bool)) == 0).all()


def test_the_ground_below_a_body_on_a_slope_lies_between_its_sides() -> None:
    H = np.tile(np.arange(30, dtype=np.float32) * 0.1, (30, 1))
    terrain = np.ones(H.shape, bool)
    terrain[10:18, 10:18] = False
    ground = fill_ground(np.where(terrain, H, np.float32(9)), terrain)
    assert np.abs(ground - H).max() < 0.2


# ---- rims


def test_the_rims_of_a_blob() -> None:
    H = np.zeros((9, 9), np.float32)
    blob = np.full((9, 9), -1, np.int32)
    blob[1:4, 1:4], blob[5:8, 5:8] = 0, 1
    H[1:4, 1:4] = 2.0
    H[5:8, 5:8] = 0.2
    assert steep_rims(H, blob, 2, 0.5).tolist() == [1.0, 0.0]
    half = np.where(np.arange(9)[:, None] < 2, 0.0, H).astype(np.float32)  # the ground rises to the top on one side
    half[:, 4:] = np.where(blob[:, 4:] < 0, 2.0, half[:, 4:])
    assert 0 < steep_rims(half, blob, 1, 0.5)[0] < 1
    assert steep_rims(H, np.full((9, 9), -1, np.int32), 2, 0.5).shape == (0,)
    assert steep_rims(H[:, 2:], blob[:, 2:], 2, 0.5)[0] == pytest.approx(5 / 6)  # one of its six cells at the edge


def test_the_edge_of_the_map_is_where_nothing_is_seen() -> None:
    """A rim that faces unseen cells counts like one at the frame of the raster, as level."""
    H = np.zeros((8, 8), np.float32)
    blob = np.full((8, 8), -1, np.int32)
    blob[2:6, 3:5], H[2:6, 3:5] = 0, 2.0
    assert steep_rims(H, blob, 1, 0.5)[0] == 1
    H[:, 5:] = np.nan
    assert steep_rims(H, blob, 1, 0.5)[0] == pytest.approx(6 / 8)
    H[:2], H[6:], H[:, :3] = np.nan, np.nan, np.nan
    assert steep_rims(H, blob, 1, 0.5)[0] == 0


def test_rims_look_down_from_a_body_up_from_a_pit_and_both_ways_from_a_bench() -> None:
    H = np.repeat(np.float32([0, 1, 2]), 5)[None].repeat(12, axis=0)  # three steps of a stair
    region = np.repeat(np.int32([0, 1, 2]), 5)[None].repeat(12, axis=0)
    assert raised_rims(H, region, 3, 0.5) == pytest.approx([0, 0.5, 1])
    assert raised_rims(H, region, 3, 5.0) == pytest.approx([0, 0, 0])  # no step is that high


def test_small_regions_are_discarded_but_never_the_largest() -> None:
    H = np.full((12, 12), np.nan, np.float32)
    H[0, 0:2] = 0.0
    H[6:8, 6:8] = 0.0
    stage = TerrainEnvelope(gap=0.0)
    region = stage.regions(H, np.isfinite(H), 0.25, 3.0)
    assert (region[6:8, 6:8] == 1).all()
    assert (region > 0).sum() == 4
    assert not stage.regions(H, np.zeros(H.shape, bool), 0.25, 3.0).any()


def test_outliers_shape_no_terrain() -> None:
    voxels = voxelized(surface_points(lambda x, y: 0 * x, CELL, 20, 20), CELL)
    local = CovarianceFeatures()(voxels)
    flying = voxels.centre[:, 0] > 4
    terrain = TerrainEnvelope()(voxels, replace(local, inlier=~flying), True)
    assert (terrain.member == ~flying).all()
    X = np.broadcast_to(terrain.grid.x, terrain.grid.shape)
    assert np.isnan(terrain.reference[X > 4]).all()
