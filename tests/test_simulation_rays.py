"""The ray caster against analytic answers and against brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from excavatwin.kernels.ray_casting import body_normal, hit_bodies
from excavatwin.kernels.ray_ground import BLOCK, GroundArrays, height_at, hit_ground
from excavatwin.simulation.bodies import Body, Kind, Material, body_arrays
from excavatwin.simulation.models import turn_z

POINTS = st.tuples(*[st.floats(-1, 1)] * 3)


def one(kind: Kind, half=(1.0, 1.0, 1.0), centre=(0.0, 0.0, 0.0), axes=None) -> Body:
    return Body(kind, np.array(centre, float), np.eye(3) if axes is None else axes, np.array(half), Material.CONCRETE)


def arrays(*bodies: Body):
    return body_arrays(list(bodies), [5] * len(bodies), list(range(1, len(bodies) + 1)))


def ground_of(height: np.ndarray, cell: float) -> GroundArrays:
    half = cell * (height.shape[1] - 1) / 2
    cells = height.shape[0] - 1
    blocks = np.array(
        [
            [height[j : j + BLOCK + 1, i : i + BLOCK + 1].max() for i in range(0, cells, BLOCK)]
            for j in range(0, cells, BLOCK)
        ],
        np.float32,
    )
    return GroundArrays(height.astype(np.float32), blocks, -half, -half, cell, float(height.max()), np.zeros(3))


@pytest.mark.parametrize(
    ("kind", "origin", "direction", "expected"),
    [
        (Kind.BOX, (0, 0, 10), (0, 0, -1), 9.0),
        (Kind.BOX, (5, 0.2, 0.3), (-1, 0, 0), 4.0),
        (Kind.CYLINDER, (5, 0, 0), (-1, 0, 0), 4.0),
        (Kind.CYLINDER, (0.5, 0, 9), (0, 0, -1), 8.0),
        (Kind.TUBE, (0, 0, 9), (0, 0, -1), np.inf),  # through the bore
        (Kind.TUBE, (0.9, 0, 9), (0, 0, -1), 8.0),
        (Kind.TUBE, (0, 0, 0), (1, 0, 0), 0.82),  # from inside
        (Kind.CONE, (0, 0, 9), (0, 0, -1), 8.0),
        (Kind.CONE, (5, 0, 0), (-1, 0, 0), 4.5),
        (Kind.CONE, (0.5, 0, -9), (0, 0, 1), 8.0),
        (Kind.ELLIPSOID, (0, 7, 0), (0, -1, 0), 6.0),
        (Kind.ELLIPSOID, (1.01, 0, 9), (0, 0, -1), np.inf),
    ],
)
def test_a_ray_meets_a_unit_shape_where_geometry_says(kind, origin, direction, expected) -> None:
    t, index = hit_bodies(arrays(one(kind)), np.array(origin, float), np.array(direction, float), 100.0)
    assert t == pytest.approx(expected)
    assert index == (0 if np.isfinite(expected) else -1)


@settings(deadline=None, max_examples=60)
@given(eye=POINTS, aim=POINTS, kind=st.sampled_from(list(Kind)), yaw=st.floats(-3, 3))
def test_a_hit_lies_on_the_surface_with_its_normal_against_the_ray(eye, aim, kind, yaw) -> None:
    body = one(kind, (0.7, 0.4, 1.2), (0.3, -0.2, 0.1), turn_z(yaw))
    o = np.array(eye) + np.array([0, 0, 6.0])
    d = np.array(aim) + body.centre - o
    packed = arrays(body)
    t, index = hit_bodies(packed, o, d, 100.0)
    if index < 0:
        return
    local = (o + t * d - body.centre) @ body.axes / body.half
    r = np.hypot(local[0], local[1])
    surface = {
        Kind.BOX: np.abs(local).max(),
        Kind.ELLIPSOID: np.linalg.norm(local),
        Kind.CYLINDER: max(r, abs(local[2])),
        Kind.CONE: max(r + (1 + local[2]) / 2, -local[2]),
        Kind.TUBE: max(r, abs(local[2])) if r > 0.83 else r / 0.82 if abs(local[2]) < 1 - 1e-9 else 1.0,
    }[kind]
    assert surface == pytest.approx(1.0, abs=1e-6)
    n = body_normal(packed, index, o + t * d, d)
    assert np.linalg.norm(n) == pytest.approx(1.0)
    assert n @ d <= 1e-9


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 1000))
def test_the_tree_finds_the_nearest_of_many_bodies(seed) -> None:
    rng = np.random.default_rng(seed)
    bodies = [
        one(Kind(int(rng.integers(0, 5))), rng.uniform(0.05, 0.5, 3), rng.uniform(-3, 3, 3), turn_z(rng.uniform(-3, 3)))
        for _ in range(30)
    ]
    packed = arrays(*bodies)
    for _ in range(20):
        o, d = rng.uniform(-6, 6, 3), rng.normal(size=3)
        alone = [hit_bodies(arrays(body), o, d, 50.0)[0] for body in bodies]
        t, index = hit_bodies(packed, o, d, 50.0)
        assert t == pytest.approx(min(alone))
        assert index == (int(np.argmin(alone)) if np.isfinite(min(alone)) else -1)


def test_nothing_is_met_where_there_are_no_bodies() -> None:
    assert hit_bodies(body_arrays([], [], []), np.zeros(3), np.array([0, 0, 1.0]), 9.0) == (np.inf, -1)


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 1000), steep=st.floats(0.05, 3))
def test_a_ray_meets_the_terrain_where_small_steps_find_it(seed, steep) -> None:
    rng = np.random.default_rng(seed)
    height = rng.normal(0, 0.3, (41, 41))
    height[[0, -1]] = height[:, [0, -1]] = 0
    ground = ground_of(height, 0.25)
    o = np.array([*rng.uniform(-4, 4, 2), 4.0])
    d = np.array([*rng.normal(size=2), -steep])
    t = hit_ground(ground, o, d, 500.0)
    steps = np.arange(0, min(t, 60.0), 0.002)
    above = [o[2] + s * d[2] - height_at(ground, o[0] + s * d[0], o[1] + s * d[1]) for s in steps]
    assert min(above[:-1], default=1.0) > -1e-6  # nothing was passed through
    p = o + t * d
    assert p[2] == pytest.approx(height_at(ground, p[0], p[1]), abs=1e-5)


@pytest.mark.parametrize("direction", [(0, 0, -1), (1, 0, -1), (0, -1, -1), (1e-12, 0, -1), (1, 1, -1e-3)])
def test_rays_along_grid_lines_end(direction) -> None:
    ground = ground_of(np.zeros((33, 33)), 0.25)
    o, d = np.array([0.5, -0.25, 2.0]), np.array(direction, float)
    assert hit_ground(ground, o, d, 1e4) == pytest.approx(-2.0 / d[2], rel=1e-6)


def test_a_ray_upwards_meets_no_terrain() -> None:
    assert (
        hit_ground(ground_of(np.zeros((17, 17)), 0.5), np.array([0, 0, 1.0]), np.array([0.1, 0, 0.5]), 99.0) == np.inf
    )
