"""Sites drawn from a seed: the same every time, different from seed to seed, and possible."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from excavatwin.errors import InputError
from excavatwin.scene.taxonomy import TaskClass
from excavatwin.simulation import DigSite, models, random_site, render_view, site_truth
from excavatwin.simulation.bodies import Body, Kind, Material
from excavatwin.simulation.camera import Camera, look_at
from excavatwin.simulation.machines import Dumper, Excavator, Truck
from excavatwin.simulation.people import Block, Person, Pipes
from excavatwin.simulation.site import CATEGORIES, contents, describe, terrain

TUNING = range(100, 120)


@cache
def coarse(seed: int) -> DigSite:
    return replace(random_site(seed), cell=0.1)


def parts_of(site: DigSite) -> dict[int, list[Body]]:
    inside = contents(site)
    groups: dict[int, list[Body]] = {}
    for body, instance in zip(inside.bodies, inside.instances, strict=True):
        if instance:
            groups.setdefault(instance, []).append(body)
    return groups


class Solid:
    """The upright prism about a body."""

    def __init__(self, body: Body) -> None:
        self.points = body.outline(24)
        hull = self.points[ConvexHull(self.points[:, :2], qhull_options="QJ").vertices, :2]
        edges = np.roll(hull, -1, axis=0) - hull
        self.normals = np.stack([edges[:, 1], -edges[:, 0]], -1)
        self.low, self.high = self.points.min(0), self.points.max(0)

    def touches(self, other: Solid) -> bool:
        """By separating axes of the footprints, and heights."""
        if (self.high < other.low).any() or (other.high < self.low).any():
            return False
        for solid in (self, other):
            u, v = solid.normals @ self.points[:, :2].T, solid.normals @ other.points[:, :2].T
            if ((u.max(1) < v.min(1)) | (v.max(1) < u.min(1))).any():
                return False
        return True


def test_a_seed_gives_one_site() -> None:
    a, b = (replace(random_site(101), cell=0.2) for _ in range(2))
    assert a == b
    assert hash(a) == hash(b)
    contents.cache_clear()
    camera = Camera(80, 60, 70.0, look_at(np.array([14.0, -14, 12]), np.zeros(3)))
    np.testing.assert_array_equal(render_view(a, camera).image, render_view(b, camera).image)


def test_seeds_differ_in_everything_that_is_drawn() -> None:
    sites = [coarse(seed) for seed in TUNING]
    works = [site.earthworks for site in sites]
    for values in (
        [site.sun for site in sites],
        [w.slope for w in works],
        [w.relief for w in works],
        [w.area for w in works],
        [w.cuts[0].depth for w in works],
        [w.heaps[0].height for w in works],
        [site.placements[0] for site in sites],
        [site.plants for site in sites],
    ):
        assert len(set(values)) == len(sites)
    assert {len(w.cuts) for w in works} == {1, 2}
    assert {len(w.heaps) for w in works} == {1, 2}
    assert {w.track is None for w in works} == {True, False}
    assert {w.cuts[0].size[1] > 2.2 for w in works} == {True, False}  # pits and trenches
    assert {sum(p.category == "person" for p in site.placements) for site in sites} == {1, 2, 3}


@pytest.mark.parametrize("seed", TUNING)
def test_every_site_is_possible(seed) -> None:
    site = coarse(seed)
    works, inside = site.earthworks, contents(site)
    assert {p.category for p in site.placements} == set(CATEGORIES)
    assert [p.task_class == TaskClass.EXCAVATOR for p in site.placements].count(True) == 1
    for box in inside.objects:
        assert np.abs(box.footprint).max() <= site.extent / 2 - 1.0
    layers = works.layers(np.linspace(-15, 15, 301), np.linspace(-15, 15, 301), site.half, site.pads, seed)
    assert (layers.taken > 0.5).sum() > 100
    assert (layers.added > 0.3).sum() > 100
    assert not ((layers.added > 0) & (layers.taken > 0)).any()
    volume = [float(part.sum()) * 0.01 for part in (layers.taken, layers.added)]
    assert 2 < volume[0] < 60
    assert 2 < volume[1] < 60
    for cut in works.cuts:
        assert 45 <= cut.wall <= 85
    objects_are_level(site)
    objects_are_apart(site)


def objects_are_level(site: DigSite) -> None:
    ground = terrain(site.earthworks, site.half, site.cell, site.pads, site.seed)
    axis = ground.west + ground.cell * np.arange(ground.height.shape[0])
    for place, box in zip(site.placements, contents(site).objects, strict=True):
        near = np.hypot(axis[None, :] - place.x, axis[:, None] - place.y) < place.pad
        assert np.ptp(ground.height[near]) < 0.002
        assert box.z_base == pytest.approx(ground.height[near].mean(), abs=0.002)


def objects_are_apart(site: DigSite) -> None:
    groups = [[Solid(body) for body in parts] for parts in parts_of(site).values()]
    for one, other in combinations(groups, 2):
        assert not any(a.touches(b) for a in one for b in other)


def test_the_bucket_hangs_free_over_the_excavation() -> None:
    for seed in TUNING:
        site = coarse(seed)
        works, machine = site.earthworks, site.placements[0]
        assert isinstance(machine.model, Excavator)
        teeth = machine.model.joints()[-1]
        turn = np.deg2rad(machine.yaw + machine.model.swing)
        x, y = machine.x + teeth[0] * np.cos(turn), machine.y + teeth[0] * np.sin(turn)
        at = works.layers(np.array([x]), np.array([y]), site.half, site.pads, seed)
        base = works.layers(np.array([machine.x]), np.array([machine.y]), site.half, site.pads, seed).natural
        assert base[0, 0] + teeth[1] > (at.natural + at.added - at.taken)[0, 0] + 0.2
        assert works.cuts[0].inside(np.array([x]), np.array([y]))[0] > -0.5


def test_every_class_is_on_a_site() -> None:
    truth = site_truth(coarse(103), cell=0.2)
    assert set(np.unique(truth.label)) == {1, 2, 3, 4, 5}
    assert len(truth.objects) == len(truth.names) == len(np.unique(truth.instance)) - 1


angles = st.floats(-180, 180)


@given(angles, angles, angles, st.floats(-3, 3), st.floats(-3, 3))
@settings(deadline=None, max_examples=40)
def test_a_box_contains_its_bodies_to_the_last_micrometre(yaw, roll, lean, x, y) -> None:
    rng = np.random.default_rng(int(abs(1000 * (yaw + roll + lean))))
    parts = []
    for kind in Kind:
        q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        parts.append(
            Body(kind, rng.uniform(-1, 1, 3) + np.array([x, y, 0]), q, rng.uniform(0.1, 0.8, 3), Material.CONCRETE)
        )
    box = describe(1, TaskClass.OBSTACLE, parts)
    turn = models.turn_z(np.deg2rad(-box.yaw))
    half = np.array(box.size) / 2 + 1e-9
    gap = np.inf
    for body in parts:
        local = (body.outline(180) - box.centre) @ turn.T
        assert (np.abs(local) <= half).all()
        gap = min(gap, float((half - np.abs(local)).min()))
    assert gap < 1e-3  # and it is tight


@pytest.mark.parametrize(
    ("model", "size"),
    [
        (Truck(5.4, 2.1, 2.3), (5.4, 2.1, 2.3)),
        (Dumper(4.0, 1.8, 2.6, load=0.9), (4.0, 1.8, 2.6)),
        (Pipes(4, 0.6, 3.0), (3.0, 2.4, 0.6)),
        (Block(1.5, 0.8, 0.7), (1.5, 0.8, 0.7)),
    ],
)
def test_things_have_the_size_that_was_asked_for(model, size) -> None:
    assert describe(1, TaskClass.OBSTACLE, model()).size == pytest.approx(size, abs=1e-9)


def test_people_are_as_tall_as_they_say() -> None:
    for height in (1.6, 1.75, 1.9):
        box = describe(1, TaskClass.OBSTACLE, Person(height)())
        assert (box.z_base, box.z_top) == pytest.approx((0.0, height))
        assert 0.4 < box.size[1] < box.size[0] < 0.9


def test_the_machine_has_the_proportions_of_three_tonnes() -> None:
    folded = describe(1, TaskClass.EXCAVATOR, Excavator(boom=70, arm=-150, bucket=-60)())
    assert folded.size[1] == pytest.approx(1.55, abs=0.01)
    poses = [Excavator(boom=float(b), arm=-20.0, bucket=0.0) for b in range(-40, 80, 5)]
    teeth = np.array([pose.joints()[-1] for pose in poses])
    at_ground = np.interp(0.0, teeth[:, 1], teeth[:, 0])
    assert 4.7 < at_ground < 5.2
    deepest = min(Excavator(boom=b, arm=a, bucket=-20.0).joints()[-1, 1] for b in (-45, -35) for a in (-20, -40, -60))
    assert -3.2 < deepest < -2.5


@given(st.floats(2.9, 3.9), st.floats(0.2, 1.4), angles, st.floats(-100, -65))
@settings(deadline=None, max_examples=60)
def test_the_machine_reaches_where_it_is_told(reach, height, swing, attack) -> None:
    machine = Excavator.reaching(reach, height, swing, attack)
    np.testing.assert_allclose(machine.joints()[-1], (reach, height), atol=1e-9)
    assert machine.swing == swing


def test_joints_have_limits() -> None:
    with pytest.raises(InputError, match="boom is at 120 degrees"):
        Excavator(boom=120)
    with pytest.raises(InputError, match="cannot get to 9 m"):
        Excavator.reaching(9.0, 1.0)
