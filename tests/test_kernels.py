"""The loops against naive twins, numpy and scipy."""

from __future__ import annotations

from collections.abc import Callable

import numba
import numpy as np
import pytest
import scipy.ndimage
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from excavatwin import topology
from excavatwin.kernels import cells, covariance, lattice, morphology, voxel_hash

relaxed = settings(deadline=None, max_examples=25)
seeds = st.integers(0, 2**32 - 1)


# ---- voxel_hash


def test_packed_keys_order_as_the_voxels_do() -> None:
    ijk = np.array([[0, 0, 0], [0, 0, 2**21 - 1], [0, 1, 0], [0, 2**21 - 1, 5], [1, 0, 0], [2**21 - 1] * 3])
    key = voxel_hash.pack(ijk)
    assert (np.diff(key) > 0).all()
    assert key[0] == 0
    assert key[-1] == 2**63 - 1


@relaxed
@given(seeds, st.integers(0, 400), st.sampled_from([1, 7, 300, 2**62]))
def test_group_keys(seed: int, n: int, variety: int) -> None:
    key = np.random.default_rng(seed).integers(0, variety, n)
    group, distinct = voxel_hash.group_keys(key)
    expected, inverse = np.unique(key, return_inverse=True)
    assert distinct.tolist() == expected.tolist()
    assert group.tolist() == inverse.tolist()


def test_group_keys_that_collide() -> None:
    """Keys whose hashes differ in no low bit share one chain of slots."""
    key = np.arange(600, dtype=np.int64) << 56
    group, distinct = voxel_hash.group_keys(np.concatenate([key, key[::-1]]))
    expected, inverse = np.unique(np.concatenate([key, key[::-1]]), return_inverse=True)
    assert (distinct == expected).all()
    assert (group == inverse).all()


@relaxed
@given(seeds)
def test_group_by_view(seed: int) -> None:
    rng = np.random.default_rng(seed)
    voxel, view = rng.integers(0, 5, 60).astype(np.int32), np.sort(rng.integers(0, 4, 60)).astype(np.int32)
    sample, sample_voxel, sample_view = voxel_hash.group_by_view(voxel, view, 5)
    pairs = list(dict.fromkeys(zip(view.tolist(), voxel.tolist(), strict=True)))  # in order of first appearance
    assert list(zip(sample_view.tolist(), sample_voxel.tolist(), strict=True)) == pairs
    assert sample.tolist() == [pairs.index((s, j)) for s, j in zip(view, voxel, strict=True)]


@relaxed
@given(seeds)
def test_group_means(seed: int) -> None:
    rng = np.random.default_rng(seed)
    values, group = rng.normal(1e4, 1, (50, 3)).astype(np.float32), rng.integers(0, 9, 50).astype(np.int32)
    means = voxel_hash.group_means(values, group, 10)
    for g in range(10):
        members = [values[i].astype(float) for i in range(50) if group[i] == g]
        assert means[g] == pytest.approx(sum(members) / len(members) if members else np.zeros(3), rel=1e-7)


# ---- lattice


def test_valid_points() -> None:
    rng = np.random.default_rng(0)
    p = rng.normal(size=(40, 3)).astype(np.float32)
    for at, bad in ((3, (np.nan, 0, 0)), (8, (0, np.inf, 0)), (21, (0, 0, -np.inf)), (39, (np.nan,) * 3)):
        p[at] = bad
    A, centre = rng.normal(size=(3, 4)), np.array([1.0, 2.0, 30.0])
    at, xyz, footprint = lattice.valid_points(p, A, centre, 50.0)
    expected = [i for i in range(40) if i not in (3, 8, 21, 39)]
    mapped = p[expected].astype(float) @ A[:, :3].T + A[:, 3]
    assert at.tolist() == expected
    assert xyz == pytest.approx(mapped, rel=1e-6, abs=1e-6)
    assert footprint == pytest.approx(np.linalg.norm(mapped - centre, axis=1) / 50, rel=1e-6)


def test_a_lattice_without_points() -> None:
    at, xyz, footprint = lattice.valid_points(np.full((6, 3), np.nan, np.float32), np.eye(3, 4), np.zeros(3), 1.0)
    assert (at.shape, xyz.shape, footprint.shape) == ((0,), (0, 3), (0,))


# ---- neighbours


def _clouds(rng: np.random.Generator) -> dict[str, np.ndarray]:
    sheet = np.column_stack([rng.uniform(0, 6, (900, 2)), rng.normal(0, 0.02, 900)])
    clump = rng.normal(3, 0.01, (300, 3))
    return {
        "sheet": sheet,
        "far from the origin": sheet + np.array([4000, -2500, 800]),
        "clump and stragglers": np.concatenate([clump, rng.uniform(-40, 40, (60, 3))]),
        "duplicates": np.repeat(sheet[:40], 9, axis=0),
        "all in one place": np.zeros((30, 3)),
        "lattice": np.stack(np.meshgrid(*[np.arange(9) * 0.1] * 3), -1).reshape(-1, 3),
        "line": np.column_stack([np.arange(80) * 0.1, np.zeros(80), np.zeros(80)]),
    }


@pytest.mark.parametrize("name", _clouds(np.random.default_rng(0)))
@pytest.mark.parametrize("k", [1, 8, 24])
def test_neighbours_are_the_nearest(name: str, k: int) -> None:
    xyz = _clouds(np.random.default_rng(1))[name].astype(np.float32)
    who, distance = topology.nearest_neighbours(xyz, k, 0.1)
    expected = cKDTree(xyz).query(xyz, k + 1)[0][:, 1:]  # the first is the point itself, or a twin of it
    assert who.shape == distance.shape == (len(xyz), k)
    rounding = 4 * np.finfo(np.float32).eps * np.ptp(xyz, axis=0).max()  # of positions from the corner of the cloud
    assert np.allclose(distance, expected, rtol=1e-5, atol=rounding)
    rows = np.arange(len(xyz))[:, None]
    assert (who != rows).all()
    assert all(len(set(row)) == k for row in who.tolist())
    assert np.allclose(np.linalg.norm(xyz[who] - xyz[rows], axis=2), distance, rtol=1e-5, atol=rounding)
    assert (np.diff(distance, axis=1) >= 0).all()


@pytest.mark.parametrize(("J", "k", "expected"), [(1, 24, 0), (2, 24, 1), (5, 24, 4), (25, 24, 24), (24, 24, 23)])
def test_neighbours_of_few_points(J: int, k: int, expected: int) -> None:
    xyz = np.random.default_rng(J).random((J, 3)).astype(np.float32)
    who, distance = topology.nearest_neighbours(xyz, k, 0.01)
    assert who.shape == distance.shape == (J, expected)
    if expected == J - 1:
        assert (np.sort(np.column_stack([np.arange(J), who]), axis=1) == np.arange(J)).all()


def test_a_search_cell_far_too_small_is_named() -> None:
    with pytest.raises(ValueError, match="too small a cell"):
        topology.nearest_neighbours(np.array([[0, 0, 0], [1e6, 0, 0]], np.float32), 1, 1e-3)


# ---- clusters within a radius


@relaxed
@given(seeds, st.floats(0.02, 0.5), st.booleans(), st.sampled_from([0.0, 300.0]))
def test_radius_clusters(seed: int, radius: float, kinds: bool, shift: float) -> None:
    rng = np.random.default_rng(seed)
    xyz = (rng.random((120, 3)) + shift).astype(np.float32)
    kind = rng.integers(1, 4, 120).astype(np.int32) if kinds else None
    cluster, size = topology.radius_clusters(xyz, radius, kind)
    apart = np.linalg.norm(xyz[:, None].astype(float) - xyz[None], axis=2)
    linked = apart <= radius
    if kind is not None:
        linked &= kind[:, None] == kind[None]
    _, expected = connected_components(coo_matrix(linked), directed=False)
    assert (cluster[:, None] == cluster[None]).tolist() == (expected[:, None] == expected[None]).tolist()
    first = [cluster.tolist().index(c) for c in range(len(size))]
    assert first == sorted(first)
    assert size.tolist() == np.bincount(cluster).tolist()


def test_radius_clusters_of_nothing_and_of_one() -> None:
    cluster, size = topology.radius_clusters(np.zeros((0, 3), np.float32), 1.0)
    assert (len(cluster), len(size)) == (0, 0)
    cluster, size = topology.radius_clusters(np.ones((1, 3), np.float32), 1.0)
    assert (cluster.tolist(), size.tolist()) == ([0], [1])


# ---- morphology


def _holed(rng: np.random.Generator, shape: tuple[int, int], share: float) -> np.ndarray:
    H = rng.normal(size=shape).astype(np.float32)
    H[rng.random(shape) < share] = np.nan
    return H


def _naive_window(H: np.ndarray, radius: int, maximum: bool) -> np.ndarray:
    out = np.full_like(H, np.nan)
    for y, x in np.ndindex(H.shape):
        window = H[max(0, y - radius) : y + radius + 1, max(0, x - radius) : x + radius + 1]
        if np.isfinite(window).any():
            out[y, x] = np.nanmax(window) if maximum else np.nanmin(window)
    return out


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (23, 17), (5, 140)])  # 140: more than one strip of columns
@pytest.mark.parametrize("radius", [0, 1, 2, 7, 30])
def test_windowed_extremes(shape: tuple[int, int], radius: int) -> None:
    H = _holed(np.random.default_rng(radius), shape, 0.4)
    for maximum in (False, True):
        assert np.array_equal(
            morphology.windowed_extreme(H, radius, maximum), _naive_window(H, radius, maximum), equal_nan=True
        )


def test_a_map_of_nothing_stays_nothing() -> None:
    assert np.isnan(morphology.opening(np.full((6, 7), np.nan, np.float32), 2)).all()


@pytest.mark.parametrize("radius", [1, 3, 10])
def test_opening_without_holes_is_scipys(radius: int) -> None:
    H = np.random.default_rng(radius).normal(size=(40, 150)).astype(np.float32)
    eroded = scipy.ndimage.minimum_filter(H, 2 * radius + 1, mode="constant", cval=np.inf)
    expected = scipy.ndimage.maximum_filter(eroded, 2 * radius + 1, mode="constant", cval=-np.inf)
    assert (morphology.opening(H, radius) == expected).all()


@relaxed
@given(seeds, st.integers(1, 4), st.floats(0, 0.9))
def test_laws_of_opening(seed: int, radius: int, holes: float) -> None:
    H = _holed(np.random.default_rng(seed), (15, 12), holes)
    opened = morphology.opening(H, radius)
    assert (np.isnan(opened) == np.isnan(H)).all()
    seen = np.isfinite(H)
    assert (opened[seen] <= H[seen]).all()
    with np.errstate(invalid="ignore"):
        assert morphology.opening(H + 2, radius)[seen] == pytest.approx(opened[seen] + 2, abs=1e-5)
    if not holes:
        assert (morphology.opening(opened, radius) == opened).all()


@relaxed
@given(seeds, st.integers(1, 4))
def test_disc_drop(seed: int, reach: int) -> None:
    rng = np.random.default_rng(seed)
    H = _holed(rng, (9, 11), 0.2)
    outside = (rng.random(H.shape) < 0.5) & np.isfinite(H)
    drop = morphology.disc_drop(H, outside, reach)
    for y, x in np.ndindex(H.shape):
        near = [H[v, u] for v, u in np.ndindex(H.shape)
                if outside[v, u] and (v - y) ** 2 + (u - x) ** 2 <= reach**2]  # fmt: skip
        expected = max(0.0, float(H[y, x]) - float(min(near))) if near and np.isfinite(H[y, x]) else 0.0
        assert drop[y, x] == pytest.approx(expected, rel=1e-6)


@relaxed
@given(seeds, st.integers(1, 4))
def test_step_across(seed: int, reach: int) -> None:
    rng = np.random.default_rng(seed)
    H = rng.normal(size=(8, 9)).astype(np.float32)
    region = rng.choice([-1, 0, 0, 0, 1, 2], H.shape).astype(np.int32)
    region[:, :3] = 0
    step = morphology.step_across(H, region, reach)
    for y, x in np.ndindex(H.shape):
        own = region[y, x]
        rim = (region[max(0, y - 1) : y + 2, max(0, x - 1) : x + 2] != own).any()
        far = {(v, u): (v - y) ** 2 + (u - x) ** 2 for v, u in np.ndindex(H.shape)}
        others = {at: d for at, d in far.items() if d <= reach**2 and region[at] >= 0 and region[at] != own}
        if own < 0 or not rim or not others:
            assert np.isnan(step[y, x])
        else:
            nearest = min(others.values())
            allowed = [H[y, x] - H[at] for at, d in others.items() if d == nearest]
            assert any(step[y, x] == a for a in allowed)


@relaxed
@given(seeds, st.floats(-0.5, 1.5))
def test_growing_without_rising(seed: int, rise: float) -> None:
    rng = np.random.default_rng(seed)
    H = rng.normal(size=(9, 10)).astype(np.float32)
    region = np.zeros(H.shape, np.int32)
    region[0, 0], region[5, 6] = 1, 2
    allowed = rng.random(H.shape) < 0.7
    grown = morphology.grow_without_rising(H, region, allowed, rise)
    reached = region > 0
    while True:  # the plainest flood there is: sweep until nothing changes
        before = reached.copy()
        for y, x in np.argwhere(allowed & ~reached):
            for v in range(max(0, y - 1), min(9, y + 2)):
                for u in range(max(0, x - 1), min(10, x + 2)):
                    if reached[v, u] and H[y, x] <= H[v, u] + rise:
                        reached[y, x] = True
        if (before == reached).all():
            break
    assert ((grown > 0) == reached).all()
    assert (grown[0, 0], grown[5, 6]) == (1, 2)
    assert (grown[~allowed & (region == 0)] == 0).all()


# ---- covariance


def _matrices() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    A, (Q, _) = rng.normal(size=(3, 3)), np.linalg.qr(rng.normal(size=(3, 3)))
    return {
        "zero": np.zeros((3, 3)),
        "identity": np.eye(3),
        "diagonal, descending": np.diag([3.0, 2.0, 1.0]),
        "full": A @ A.T,
        "rank one": np.outer(A[0], A[0]),
        "rank two": A[:2].T @ A[:2],
        "twin eigenvalues": Q @ np.diag([1.0, 1.0, 5.0]) @ Q.T,
        "nearly flat": Q @ np.diag([1e-12, 1.0, 1.0 + 1e-9]) @ Q.T,
        "tiny": 1e-30 * A @ A.T,
        "huge": 1e30 * A @ A.T,
        "all equal": np.ones((3, 3)),
        "indefinite": A + A.T,
    }


@pytest.mark.parametrize("name", _matrices())
def test_symmetric_eigen(name: str) -> None:
    C = _matrices()[name]
    C = (C + C.T) / 2
    values, vectors = np.empty(3), np.empty((3, 3))
    covariance.symmetric_eigen(C.copy(), values, vectors)
    scale = np.abs(C).max()
    assert values == pytest.approx(np.linalg.eigvalsh(C), rel=1e-9, abs=1e-13 * scale)
    assert vectors.T @ vectors == pytest.approx(np.eye(3), abs=1e-12)
    assert vectors @ np.diag(values) @ vectors.T == pytest.approx(C, abs=1e-12 * scale)


@relaxed
@given(seeds)
def test_symmetric_eigen_of_any_covariance(seed: int) -> None:
    p = np.random.default_rng(seed).normal(size=(4, 3)) * 10.0 ** np.random.default_rng(seed + 1).integers(-4, 4, 3)
    C = np.cov(p.T)
    values, vectors = np.empty(3), np.empty((3, 3))
    covariance.symmetric_eigen(C.copy(), values, vectors)
    assert values == pytest.approx(np.linalg.eigvalsh(C), rel=1e-7, abs=1e-13 * np.abs(C).max())


def test_features_of_points_without_extent() -> None:
    xyz, alone = np.ones((5, 3), np.float32), np.zeros((5, 0), np.int32)
    for neighbours in (alone, np.array([[1, 2]] * 5, np.int32)):
        normal, eigenvalue, height_variance, residual = covariance.local_features(xyz, neighbours)
        assert np.linalg.norm(normal, axis=1) == pytest.approx(1.0)
        assert not eigenvalue.any()
        assert not height_variance.any()
        assert not residual.any()


# ---- cells


def _grouped(rng: np.random.Generator, n: int, n_cells: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    cell = rng.integers(-1, n_cells, n).astype(np.int32)
    return cell, *cells.group_rows(cell, n_cells)


@relaxed
@given(seeds)
def test_group_rows(seed: int) -> None:
    cell, start, member = _grouped(np.random.default_rng(seed), 60, 12)
    for c in range(12):
        assert member[start[c] : start[c + 1]].tolist() == np.flatnonzero(cell == c).tolist()
    assert start[-1] == len(member) == (cell >= 0).sum()


@relaxed
@given(seeds, st.floats(0, 1))
def test_cell_quantile(seed: int, q: float) -> None:
    rng = np.random.default_rng(seed)
    cell, start, member = _grouped(rng, 50, 15)
    value = rng.normal(100, 1, 50).astype(np.float32)
    found = cells.cell_quantile(value, start, member, q)
    for c in range(15):
        own = value[cell == c].astype(float)
        if len(own):
            assert found[c] == pytest.approx(np.quantile(own, q), rel=1e-6)
        else:
            assert np.isnan(found[c])


@relaxed
@given(seeds)
def test_cell_spread(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cell, start, member = _grouped(rng, 50, 15)
    value, weight = rng.normal(size=50).astype(np.float32), rng.random(50).astype(np.float32)
    weight[cell == 3] = 0
    centre = rng.normal(size=15).astype(np.float32)
    spread, effective = cells.cell_spread(value, weight, centre, start, member)
    for c in range(15):
        own, w = value[cell == c].astype(float), weight[cell == c].astype(float)
        if len(own) == 0:
            assert np.isnan(spread[c])
            assert effective[c] == 0
            continue
        assert spread[c] == pytest.approx(1.4826 * np.median(np.abs(own - centre[c])), rel=1e-5)
        assert effective[c] == pytest.approx(w.sum() ** 2 / (w**2).sum() if w.any() else 0.0, rel=1e-5)


def test_equal_weights_count_as_points() -> None:
    cell = np.zeros(7, np.int32)
    start, member = cells.group_rows(cell, 1)
    _, effective = cells.cell_spread(np.zeros(7), np.full(7, 0.3), np.zeros(1, np.float32), start, member)
    assert effective[0] == pytest.approx(7)


@relaxed
@given(seeds)
def test_weighted_votes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cell, label, weight = rng.integers(-1, 6, 40).astype(np.int32), rng.integers(0, 4, 40), rng.random(40)
    votes = cells.weighted_votes(cell, label, weight, 6, 4)
    for c, k in np.ndindex(6, 4):
        assert votes[c, k] == pytest.approx(weight[(cell == c) & (label == k)].sum())


# ---- threads


def _parallel_results() -> list[np.ndarray]:
    rng = np.random.default_rng(5)
    xyz = np.column_stack([rng.uniform(0, 9, (3000, 2)), rng.normal(0, 0.05, 3000)]).astype(np.float32)
    who, distance = topology.nearest_neighbours(xyz, 10, 0.15)
    H = _holed(rng, (90, 200), 0.1)
    region = rng.integers(-1, 4, H.shape).astype(np.int32)
    _, start, member = _grouped(rng, 3000, 400)
    weight = rng.random(3000).astype(np.float32)
    quantile = cells.cell_quantile(xyz[:, 2], start, member, 0.3)
    return [
        who, distance, *covariance.local_features(xyz, who), morphology.opening(H, 5),
        morphology.disc_drop(H, np.isfinite(H), 3), morphology.step_across(H, region, 3),
        quantile, *cells.cell_spread(xyz[:, 2], weight, quantile, start, member),
    ]  # fmt: skip


def test_results_do_not_depend_on_the_number_of_threads() -> None:
    before = numba.get_num_threads()

    def with_threads(n: int) -> list[np.ndarray]:
        numba.set_num_threads(n)
        try:
            return _parallel_results()
        finally:
            numba.set_num_threads(before)

    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("this machine has one core")
    for one, many in zip(with_threads(1), with_threads(numba.config.NUMBA_NUM_THREADS), strict=True):
        assert np.array_equal(one, many, equal_nan=one.dtype.kind == "f")


def test_loops_give_the_same_uncompiled() -> None:
    """Each loop run by the interpreter, where an index out of bounds is an error and not a wrong number."""
    rng = np.random.default_rng(9)
    H = _holed(rng, (7, 6), 0.2)
    region, outside = rng.integers(-1, 2, H.shape).astype(np.int32), np.isfinite(H)
    cell = rng.integers(-1, 5, 20).astype(np.int32)
    value = rng.random(20)
    start, member = cells.group_rows(cell, 5)
    loops: list[tuple[Callable[..., object], tuple[object, ...]]] = [
        (morphology.disc_drop, (H, outside, 2)),
        (morphology.step_across, (H, region, 2)),
        (morphology.grow_without_rising, (H, np.maximum(region, 0), outside, 0.1)),
        (cells.group_rows, (cell, 5)),
        (cells.cell_quantile, (value, start, member, 0.37)),
        (cells.weighted_votes, (cell, rng.integers(0, 3, 20), value, 5, 3)),
        (voxel_hash.group_by_view, (cell[cell >= 0], np.zeros((cell >= 0).sum(), np.int32), 5)),
        (voxel_hash.group_means, (rng.random((20, 2)), np.maximum(cell, 0), 5)),
    ]
    for loop, given_ in loops:
        compiled, plain = loop(*given_), loop.py_func(*given_)  # type: ignore[attr-defined]
        if not isinstance(compiled, tuple):
            compiled, plain = (compiled,), (plain,)
        for a, b in zip(compiled, plain, strict=True):
            assert np.allclose(a, b, equal_nan=True)
