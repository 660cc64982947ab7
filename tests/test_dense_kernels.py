"""Kernels of dense stereo against naive twins and laws."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from excavatwin.backbones.photogrammetry.sweep import bilateral
from excavatwin.kernels import depth_maps, plane_sweep, semi_global

NOISE = np.float32(1.0)


def bilinear(image: np.ndarray, u: float, v: float) -> float:
    """Value at pixel index (u, v), NaN outside."""
    h, w = image.shape
    if not (0 <= u < w - 1 and 0 <= v < h - 1):
        return math.nan
    j, i = int(u), int(v)
    a, b = u - j, v - i
    upper = (1 - a) * image[i, j] + a * image[i, j + 1]
    lower = (1 - a) * image[i + 1, j] + a * image[i + 1, j + 1]
    return float((1 - b) * upper + b * lower)


def naive_cost(reference, source, M, t, slope, w, r, c, tone, space) -> float:
    """1 - ZNCC of one window with bilateral weights, window by window."""
    rows, cols = reference.shape
    values = []
    for i in range(-2, 3):
        for j in range(-2, 3):
            rr, cc = min(max(r + i, 0), rows - 1), min(max(c + j, 0), cols - 1)
            p = M @ np.array([cc + 0.5, rr + 0.5, 1.0]) + w * slope[rr, cc] * t
            s = bilinear(source, p[0] / p[2] - 0.5, p[1] / p[2] - 0.5)
            weight = tone[int(abs(reference[rr, cc] - reference[r, c]))] * space[i + 2, j + 2]
            values.append((weight, reference[rr, cc], s))
    g, a, b = np.array(values, float).T
    g /= g.sum()
    a, b = a - (g * a).sum(), b - (g * b).sum()
    return 1 - (g * a * b).sum() / math.sqrt(((g * a * a).sum() + NOISE) * ((g * b * b).sum() + NOISE))


def scene(seed: int = 0, rows: int = 19, cols: int = 37):
    rng = np.random.default_rng(seed)
    reference = rng.uniform(60, 190, (rows, cols)).astype(np.float32)
    shifted = [np.roll(reference, shift, (0, 1)) for shift in ((0, 2), (0, 3), (1, 0))]
    sources = np.array(shifted, np.float32) + rng.normal(0, 4, (3, rows, cols)).astype(np.float32)
    M = np.array([np.eye(3)] * 3) + rng.normal(0, 1e-4, (3, 3, 3)) * [[1, 1, 20], [1, 1, 20], [0.01, 0.01, 0]]
    t = np.array([[1.0, 0, 0], [1.5, 0.01, 0], [0, 0.5, 0.001]])
    slope = rng.uniform(0.95, 1.05, (rows, cols)).astype(np.float32)
    return reference, sources, M.astype(np.float32), t.astype(np.float32), slope


def run_costs(reference, sources, M, t, slope, start, first, keep=2):
    rows, cols = sources.shape[1:]
    sizes = np.array([[rows, cols, cols]] * len(sources), np.int64)
    tone, space = bilateral(12.0, 2.0)
    return plane_sweep.band_costs(
        plane_sweep.pad_to_tiles(reference), sources.reshape(len(sources), -1), sizes, M, t,
        plane_sweep.pad_to_tiles(slope), 0.5, 0.4, start, first, tone, space, NOISE, keep,
    )  # fmt: skip


def full_bands(rows: int, cols: int, planes: int):
    return np.arange(rows * cols + 1, dtype=np.int64) * planes, np.zeros((rows, cols), np.int32)


def test_costs_are_the_mean_of_the_best_correlations():
    reference, sources, M, t, slope = scene()
    rows, cols = reference.shape
    start, first = full_bands(rows, cols, 7)
    costs = run_costs(reference, sources, M, t, slope, start, first).reshape(rows, cols, 7)
    tone, space = bilateral(12.0, 2.0)
    for r, c, k in [(9, 18, 3), (0, 0, 2), (18, 36, 1), (5, 30, 6), (17, 3, 0), (16, 31, 4), (16, 32, 4), (3, 10, 5)]:
        each = [
            naive_cost(reference, s, M[i], t[i], slope, 0.5 + 0.4 * k, r, c, tone, space) for i, s in enumerate(sources)
        ]
        best = sorted(value for value in each if math.isfinite(value))[:2]
        expected = min(np.mean(best) * 250, 250) if best else 250
        assert costs[r, c, k] == pytest.approx(expected, abs=1.5)


def test_a_band_holds_the_same_costs_as_the_full_sweep():
    reference, sources, M, t, slope = scene(3)
    rows, cols = reference.shape
    start, first = full_bands(rows, cols, 9)
    full = run_costs(reference, sources, M, t, slope, start, first).reshape(rows * cols, 9)
    rng = np.random.default_rng(0)
    begin, count = rng.integers(0, 5, rows * cols), rng.integers(0, 5, rows * cols)
    banded = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    part = run_costs(reference, sources, M, t, slope, banded, begin.reshape(rows, cols).astype(np.int32))
    for p in range(rows * cols):
        np.testing.assert_array_equal(part[banded[p] : banded[p + 1]], full[p, begin[p] : begin[p] + count[p]])


def test_no_source_costs_the_worst():
    reference, sources, M, t, slope = scene()
    rows, cols = reference.shape
    start, first = full_bands(rows, cols, 3)
    assert (run_costs(reference, np.full_like(sources, np.nan), M, t, slope, start, first) == plane_sweep.WORST).all()
    behind = M * np.array([1, 1, -1], np.float32)[:, None]
    assert (run_costs(reference, sources, behind, t, slope, start, first) == plane_sweep.WORST).all()


def naive_aggregate(costs, image, P1, P2, least, contrast):
    rows, cols, planes = costs.shape
    total = np.zeros(costs.shape)
    for dr, dc in [(0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1)]:
        path = np.zeros(costs.shape)
        order = [(r, c) for r in range(rows)[:: 1 if dr >= 0 else -1] for c in range(cols)[:: 1 if dc >= 0 else -1]]
        for r, c in order:
            q = (r - dr, c - dc)
            path[r, c] = costs[r, c]
            if not (0 <= q[0] < rows and 0 <= q[1] < cols):
                continue
            price = max(P2 / (1 + abs(image[r, c] - image[q]) / contrast), least)
            for k in range(planes):
                best = path[q].min() + price
                for m in range(planes):
                    if abs(m - k) <= 1:
                        best = min(best, path[q][m] + P1 * abs(m - k))
                path[r, c, k] += best - path[q].min()
        total += path
    return total


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 10_000), st.integers(2, 6), st.integers(2, 6), st.integers(1, 6))
def test_aggregation_follows_its_naive_twin(seed, rows, cols, planes):
    rng = np.random.default_rng(seed)
    costs = rng.integers(0, 251, (rows, cols, planes)).astype(np.uint8)
    image = rng.uniform(0, 255, (rows, cols)).astype(np.float32)
    start, first = full_bands(rows, cols, planes)
    total = semi_global.aggregate(costs.ravel(), start, first.ravel(), image, 7.0, 60.0, 20.0, 10.0)
    np.testing.assert_allclose(
        total.reshape(costs.shape), naive_aggregate(costs, image, 7.0, 60.0, 20.0, 10.0), rtol=1e-4
    )


def test_shifted_bands_aggregate_like_the_full_volume_restricted_to_them():
    rng = np.random.default_rng(1)
    rows, cols, planes = 5, 6, 12
    costs = np.full((rows, cols, planes), 250, np.uint8)
    begin = rng.integers(0, 8, rows * cols).astype(np.int32)
    start = np.arange(rows * cols + 1, dtype=np.int64) * 4
    band = rng.integers(0, 200, (rows * cols, 4)).astype(np.uint8)
    for p in range(rows * cols):
        costs[p // cols, p % cols, begin[p] : begin[p] + 4] = band[p]
    image = np.zeros((rows, cols), np.float32)
    total = semi_global.aggregate(band.ravel(), start, begin, image, 0.0, 0.0, 0.0, 10.0)
    np.testing.assert_allclose(
        total.reshape(-1, 4), 8 * band.astype(float)
    )  # free changes: every path keeps its own cost
    dear = semi_global.aggregate(band.ravel(), start, begin, image, 5.0, 90.0, 90.0, 10.0)
    assert (dear >= total - 1e-3).all()


def test_the_winner_is_the_vertex_of_the_parabola():
    k = np.arange(7)
    total = np.concatenate([(k - 2.3) ** 2, (k - 4.75) ** 2]).astype(np.float32)
    start = np.array([0, 7, 14, 14], np.int64)
    plane, cost = semi_global.winners(total, np.arange(14).astype(np.uint8), start, np.array([0, 10, 0], np.int32))
    np.testing.assert_allclose(plane, [2.3, 14.75, np.nan], rtol=1e-5)
    np.testing.assert_allclose(cost, [2, 12, np.nan])


def test_bands_enclose_the_coarse_neighbourhood():
    plane = np.full((4, 5), 10.0, np.float32)
    plane[1, 2] = 13.0
    plane[3, 4] = np.nan
    allowed = np.ones((8, 10), bool)
    allowed[0, 0] = False
    start, first = semi_global.narrow_bands(plane, 2.0, 8, 10, 3, 40, 100, allowed)
    first, count = first.reshape(8, 10), np.diff(start).reshape(8, 10)
    assert count[0, 0] == 0
    assert (first[7, 0], count[7, 0]) == (17, 7)
    assert (first[2, 4], count[2, 4]) == (17, 13)
    start, first = semi_global.narrow_bands(plane, 2.0, 8, 10, 3, 8, 100, allowed)
    assert np.diff(start).max() == 8


def test_surfaces_are_counted_as_flood_fill_would():
    depth = np.full((6, 7), 10.0, np.float32)
    depth[:, 3] = np.nan
    depth[2:4, 5:7] = 12.0
    size = depth_maps.surface_sizes(depth, 0.01)
    assert size[0, 0] == 18
    assert size[2, 5] == size[3, 6] == 4
    assert size[0, 4] == 14
    assert (size[:, 3] == 0).all()
