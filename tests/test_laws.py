"""Laws of the method: what must not change, and what must change in a known way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tiny_site
from excavatwin.errors import InputError
from excavatwin.geometry.voxelize import Voxelize
from excavatwin.mapper import Mapper, rescaled
from excavatwin.mapping.raster import Raster
from excavatwin.scene.frames import rotation_between
from excavatwin.scene.observations import Georeference, Observations, View
from excavatwin.scene.taxonomy import Reason
from excavatwin.semantics.admissibility import AdmitAll
from excavatwin.semantics.consistency import KeepEvidence
from excavatwin.semantics.decision import Decision, decide, score


def moved(observations: Observations, c: float, R: np.ndarray, t: np.ndarray) -> Observations:
    """The same scene in another reconstruction frame: p' = c R p + t."""

    def move(view: View) -> View:
        T = np.eye(4)
        T[:3, :3] = R @ view.T_R_cam[:3, :3]
        T[:3, 3] = c * R @ view.T_R_cam[:3, 3] + t
        points = c * view.points.astype(np.float64) @ R.T + t
        return replace(view, points=points.astype(np.float32), T_R_cam=T)

    return replace(observations, views=tuple(map(move, observations.views)), up=R @ np.array([0, 0, 1.0]))


def test_scale_of_the_reconstruction_is_irrelevant_once_it_is_known(dig_site, dig_site_trace) -> None:
    shrunk = replace(moved(dig_site, 0.25, np.eye(3), np.zeros(3)), metres_per_unit=4.0)
    m, n = dig_site_trace.map, Mapper().trace(shrunk).map
    assert m.grid == n.grid
    assert (m.label == n.label).mean() > 0.999
    assert np.nanmax(np.abs(m.elevation - n.elevation)) < 1e-4


def test_unknown_scale_gives_the_same_map_in_other_units(dig_site) -> None:
    unscaled = replace(dig_site, metres_per_unit=None)
    m = Mapper().trace(unscaled).map
    n = Mapper().trace(replace(moved(dig_site, 8.0, np.eye(3), np.zeros(3)), metres_per_unit=None)).map
    assert not m.metric
    assert any("arbitrary units" in doubt for doubt in m.doubts)
    assert n.grid.cell == pytest.approx(8 * m.grid.cell)
    assert (m.label == n.label).mean() > 0.999
    assert np.nanmedian(np.abs(8 * m.elevation - n.elevation)) < 1e-3


def test_a_turn_by_90_degrees_permutes_the_grid(dig_site, dig_site_trace) -> None:
    R = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    m, n = dig_site_trace.map, Mapper().trace(moved(dig_site, 1.0, R, np.zeros(3))).map
    assert (np.rot90(m.label) == n.label).mean() > 0.99  # samples on cell borders change sides
    difference = np.abs(np.rot90(m.elevation) - n.elevation)
    assert np.nanmedian(difference) < 1e-3
    assert len(m.objects) == len(n.objects)


def test_a_tilted_reconstruction_is_put_upright(dig_site, dig_site_trace) -> None:
    R = rotation_between(np.array([0, 0, 1.0]), np.array([0.3, -0.5, 0.8]))
    tilted = moved(dig_site, 1.0, R, np.array([1.0, 2.0, 3.0]))
    site_map = Mapper().trace(tilted).map
    level = np.nanstd(site_map.elevation)
    assert level == pytest.approx(np.nanstd(dig_site_trace.map.elevation), rel=0.05)


def test_gravity_is_found_from_level_cameras(dig_site) -> None:
    R_G_R, doubts = Mapper().gravity(replace(dig_site, up=None))
    assert np.degrees(np.arccos(R_G_R[2, 2])) < 0.5
    assert "cameras were held level" in doubts[0]


def test_the_order_of_the_views_is_irrelevant(dig_site, dig_site_trace) -> None:
    shuffled = replace(dig_site, views=tuple(dig_site.views[s] for s in (3, 0, 7, 5, 1, 2, 6, 4)))
    m, n = dig_site_trace.map, Mapper().trace(shuffled).map
    assert (m.label == n.label).all()
    assert np.nanmax(np.abs(m.elevation - n.elevation)) < 1e-5


def test_samples_repeated_within_a_view_change_nothing(dig_site, dig_site_trace) -> None:
    """A view at twice the resolution, each pixel four times, has no more say than before."""

    def doubled(view: View) -> View:
        twice = {name: np.repeat(np.repeat(getattr(view, name), 2, 0), 2, 1)
                 for name in ("points", "confidence", "evidence", "image")}  # fmt: skip
        K = np.diag([2.0, 2.0, 1.0]) @ view.K_cam
        K[0, 0] = view.K_cam[0, 0]  # the pixels are copies: what one covers on the ground stays
        return replace(view, **twice, K_cam=K)

    views = tuple(doubled(view) if s % 3 == 0 else view for s, view in enumerate(dig_site.views))
    n = Mapper().trace(replace(dig_site, views=views))
    assert n.voxels.size == dig_site_trace.voxels.size
    assert (n.labels.label == dig_site_trace.labels.label).mean() > 0.9995
    assert np.nanmax(np.abs(n.map.elevation - dig_site_trace.map.elevation)) < 1e-5


evidence = st.integers(0, 2**32 - 1)


@settings(deadline=None, max_examples=50)
@given(evidence, st.floats(0, 1), st.floats(0, 1))
def test_raising_tau_never_shrinks_unknown(seed: int, a: float, b: float) -> None:
    rng = np.random.default_rng(seed)
    q = score(rng.random((40, 5), np.float32), rng.random((40, 5), np.float32), 0.02, 1.0)
    low, high = decide(q, min(a, b)), decide(q, max(a, b))
    assert ((low == 0) <= (high == 0)).all()
    assert (high[high > 0] == low[high > 0]).all()


@settings(deadline=None, max_examples=50)
@given(evidence)
def test_zero_support_forbids_a_class(seed: int) -> None:
    rng = np.random.default_rng(seed)
    g = rng.random((40, 5), np.float32)
    g[rng.random((40, 5)) < 0.4] = 0
    labels = Decision(tau=0.0)(rng.random((40, 5), np.float32), g)
    named = labels.label > 0
    assert (g[named, labels.label[named] - 1] > 0).all()
    assert (labels.label[(g == 0).all(axis=1)] == 0).all()
    assert (labels.reason[(g == 0).all(axis=1)] == Reason.INADMISSIBLE).all()


def test_reasons_name_the_cause() -> None:
    v = np.array([[0.9, 0, 0, 0, 0], [0.001, 0, 0, 0, 0], [0.5, 0.5, 0, 0, 0], [0, 0, 0, 0.9, 0]], np.float32)
    g = np.array([[1, 1, 1, 0, 0], [1, 1, 1, 0, 0], [1, 1, 0.3, 0, 0], [1, 1, 0.3, 0, 0]], np.float32)
    labels = Decision(tau=0.6)(v, g)
    expected = [Reason.CLASSIFIED, Reason.INSUFFICIENT, Reason.CONFLICTING, Reason.INADMISSIBLE]
    assert labels.reason.tolist() == expected
    assert labels.label.tolist() == [1, 0, 0, 0]


def test_the_map_is_right_where_the_truth_is_known(dig_site_trace) -> None:
    """Pit floor, pit rim and heap stay in the terrain; machine, block and bush do not."""
    m = dig_site_trace.map
    X, Y = np.meshgrid(m.grid.x, m.grid.y)
    _, label = tiny_site.surface(X, Y)
    truth = tiny_site.terrain(X, Y)
    seen = m.observed.astype(bool)
    assert (m.label == label)[seen].mean() > 0.97
    error = np.abs(m.elevation - truth)
    assert np.nanmedian(error) < 0.02
    pit = (X > -4.6) & (X < -1.4) & (Y > 1.4) & (Y < 4.6)
    heap = np.hypot(X - 4, Y - 4) < 2.5
    assert np.isfinite(m.elevation[pit & seen]).mean() > 0.97
    assert np.isfinite(m.elevation[heap & seen]).mean() > 0.97
    assert np.median(error[pit & seen]) < 0.03
    machine = (X > 1.3) & (X < 3.7) & (Y > -4.1) & (Y < -2.9)
    assert np.isnan(m.elevation[machine]).all()
    assert (m.object_id[machine] == 1).all()
    excavator, block = m.objects
    assert excavator.size == pytest.approx((3.0, 1.8, 2.2), rel=0.1)
    assert block.size == pytest.approx((1.2, 1.0, 1.0), rel=0.1)


def test_geometry_suppresses_what_voting_cannot(dig_site) -> None:
    """An error that sticks to the ground, the same in every view, survives voting but not the geometry."""

    def painted(view: View) -> View:
        p = view.points
        patch = np.hypot(p[..., 0] - 4, p[..., 1] + 0.5) < 1.0
        e = view.evidence.copy()
        e[patch] = [0, 0, 0, 0.9, 0]
        return replace(view, evidence=e)

    fooled = replace(dig_site, views=tuple(map(painted, dig_site.views)))
    X, Y = np.meshgrid(*(getattr(Mapper().trace(dig_site).map.grid, a) for a in "xy"))
    patch = np.hypot(X - 4, Y + 0.5) < 0.7
    voted = replace(Mapper(), consistency=KeepEvidence(), admissibility=AdmitAll()).trace(fooled).map
    guided = Mapper().trace(fooled).map
    assert (voted.label[patch] == 4).mean() > 0.95
    assert (guided.label[patch] == 4).mean() < 0.05


def test_standard_deviation_is_honest(dig_site_trace) -> None:
    """On open ground the errors are no larger than the map says, and not much smaller: here every pixel errs on its
    own, which the map does not assume (docs/decisions/elevation-std.md has the calibration on photos)."""
    m = dig_site_trace.map
    X, Y = np.meshgrid(m.grid.x, m.grid.y)
    open_ground = (np.abs(X + 6.5) < 1.5) & (Y < 0) & (Y > -3) & np.isfinite(m.elevation)
    z = (m.elevation - tiny_site.terrain(X, Y))[open_ground] / m.elevation_std[open_ground]
    assert 0.15 < np.sqrt(np.mean(z**2)) < 1.0


def test_a_reference_length_against_gps_shows_in_the_residual(dig_site) -> None:
    tie = Georeference(32632, (690000.0, 5330000.0, 500.0), residual=0.5)
    tied = replace(dig_site, georeference=tie)
    assert rescaled(tied, 1.0) == tie
    moved = 0.1 * np.sqrt(np.mean([(view.centre**2).sum() for view in tied.views]))
    assert rescaled(tied, 1.1).residual == pytest.approx(np.hypot(0.5, moved))
    assert rescaled(dig_site, 1.1) is None


@pytest.mark.parametrize(
    ("stage", "name", "value"),
    [(Decision, "tau", 7.0), (Decision, "tau", float("nan")), (Raster, "cell", 0.0), (Voxelize, "size", -1.0)],
)
def test_a_parameter_out_of_range_is_refused(stage, name: str, value: float) -> None:
    with pytest.raises(InputError, match=rf"{stage.__name__}\.{name} is .*; expected"):
        stage(**{name: value})
