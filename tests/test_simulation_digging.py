"""A dig in progress: soil is conserved, nothing else changes, and the truth of a change is that of the terrain."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from excavatwin.errors import InputError
from excavatwin.scene.taxonomy import TaskClass
from excavatwin.simulation import Digging, DigSite, change_truth, digging_series, random_site, site_truth
from excavatwin.simulation.machines import Excavator
from excavatwin.simulation.site import contents, terrain

SEEDS = (100, 103, 108)


@cache
def series(seed: int) -> tuple[DigSite, ...]:
    return digging_series(replace(random_site(seed), cell=0.1), 3)


def height(site: DigSite) -> np.ndarray:
    return terrain(site.earthworks, site.half, site.cell, site.pads, site.seed).height


@pytest.mark.parametrize("seed", SEEDS)
def test_the_heap_takes_the_soil_of_the_cut(seed) -> None:
    states = series(seed)
    for before, after in pairwise(states):
        change = change_truth(before, after)
        assert change.cut > 0.2
        assert change.fill == pytest.approx(1.25 * change.cut, rel=0.005)
        assert change.net == pytest.approx(change.fill - change.cut)
        signed = change.difference.astype(float)
        assert -signed[signed < 0].sum() * change.grid.cell**2 == pytest.approx(change.cut, rel=1e-5)
    whole = change_truth(states[0], states[-1])
    steps = [change_truth(a, b) for a, b in pairwise(states)]
    assert whole.cut == pytest.approx(sum(step.cut for step in steps), rel=1e-4)  # nothing is dug twice
    assert whole.fill == pytest.approx(sum(step.fill for step in steps), rel=1e-4)


def test_the_bulking_factor_is_a_parameter() -> None:
    site = replace(random_site(103), cell=0.05)
    states = digging_series(site, 2, Digging(bulking=1.4))
    change = change_truth(*states)
    assert change.fill == pytest.approx(1.4 * change.cut, rel=0.005)


@pytest.mark.parametrize("seed", SEEDS)
def test_outside_cut_and_heap_the_ground_is_the_same_to_the_last_bit(seed) -> None:
    states = series(seed)
    axis = -states[0].half + states[0].cell * np.arange(height(states[0]).shape[0])
    x, y = np.meshgrid(axis, axis)
    last = states[-1].earthworks
    touched = (last.cuts[0].inside(x, y) > -0.3) | (last.heaps[0].inside(x, y) > -0.7)
    for before, after in pairwise(states):
        same = height(before) == height(after)
        assert same[~touched].all()
        assert (~same).sum() > 100
        assert (height(after) <= height(before))[last.cuts[0].inside(x, y) > -0.3].all()
        assert (height(after) >= height(before))[last.heaps[0].inside(x, y) > -0.7].all()
        assert (after.plants, after.sun, after.seed) == (before.plants, before.sun, before.seed)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_machine_swings_and_people_move(seed) -> None:
    states = series(seed)
    for before, after in pairwise(states):
        assert [p.name for p in before.placements] == [p.name for p in after.placements]
        for a, b in zip(before.placements, after.placements, strict=True):
            if a.category == "person":
                assert np.hypot(a.x - b.x, a.y - b.y) > 1.0
            elif a.category == "excavator":
                assert isinstance(a.model, Excavator)
                assert isinstance(b.model, Excavator)
                assert abs((a.model.swing - b.model.swing + 180) % 360 - 180) > 20
                assert a.model.boom != b.model.boom
                assert (a.x, a.y, a.yaw) == (b.x, b.y, b.yaw)
            else:
                assert a == b
    for state in states:
        for place, box in zip(state.placements, contents(state).objects, strict=True):
            if place.category in ("person", "excavator"):
                ground = height(state)
                k = [round((c + state.half) / state.cell) for c in (place.y, place.x)]
                assert box.z_base == pytest.approx(ground[k[0], k[1]], abs=0.003)


def test_the_first_epoch_is_the_site_with_room_to_stand() -> None:
    site = replace(random_site(103), cell=0.1)
    first = series(103)[0]
    assert replace(first, earthworks=site.earthworks) == site
    assert replace(first.earthworks, levelled=()) == site.earthworks
    assert digging_series(site, 3) == series(103)


def test_the_difference_is_that_of_the_truths() -> None:
    before, after = series(103)[0], series(103)[-1]
    change = change_truth(before, after, cell=0.2)
    a, b = site_truth(before, cell=0.2), site_truth(after, cell=0.2)
    assert change.grid == a.grid
    np.testing.assert_allclose(change.difference, b.height - a.height, atol=1e-4)
    dug = change.difference < -0.2
    assert (b.label[dug & (b.instance == 0)] == TaskClass.CONSTRUCTION_TERRAIN).mean() > 0.99


def test_nothing_changed_is_nothing() -> None:
    site = replace(random_site(103), cell=0.1)
    change = change_truth(site, site)
    assert (change.cut, change.fill, change.net) == (0, 0, 0)
    assert not change.difference.any()


def test_what_cannot_be_dug_is_refused() -> None:
    site = random_site(103)
    with pytest.raises(InputError, match="at least 2"):
        digging_series(site, 1)
    with pytest.raises(InputError, match="no Worksite"):
        digging_series(DigSite(), 3)
    with pytest.raises(InputError, match="plants"):
        digging_series(replace(site, plants=None), 3)
    with pytest.raises(InputError, match="bulking"):
        Digging(bulking=0.8)
    with pytest.raises(InputError, match="extent"):
        change_truth(site, replace(site, extent=20.0))


def test_what_the_page_says_about_sites_and_digging_is_so() -> None:
    page = (Path(__file__).parent.parent / "docs" / "simulator.md").read_text()
    parts = re.split(r"^## ", page, flags=re.MULTILINE)
    told = "".join([parts[0], *(part for part in parts if part.startswith(("What a site", "Digging series")))])
    scope: dict[str, object] = {}
    blocks = re.findall(r"```python\n(.*?)```", told, re.DOTALL)
    assert len(blocks) >= 2
    for block in blocks:
        exec(compile(block, "docs/simulator.md", "exec"), scope)
