"""``excavatwin compare``: laws, naive twins of its figures, frames, refusals, and its folder as others read it."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from PIL import Image

from excavatwin.cli import main
from excavatwin.errors import InputError
from excavatwin.evaluation.comparison import Comparison, compare
from excavatwin.evaluation.comparison_frame import Motion
from excavatwin.evaluation.comparison_grid import common_grid, layers_of_b
from excavatwin.evaluation.comparison_heights import figures
from excavatwin.evaluation.comparison_labels import NAMES, VALUES, cross_table, kappa, label_figures, overlap
from excavatwin.evaluation.comparison_objects import moved
from excavatwin.evaluation.comparison_runs import run_differences
from excavatwin.evaluation.comparison_site import ComparedSite, read_compared
from excavatwin.evaluation.objects import rectangle
from excavatwin.export import write_site
from excavatwin.scene.elevation_map import ElevationMap
from excavatwin.scene.grid import Grid
from excavatwin.scene.observations import Georeference
from excavatwin.scene.site import MappedView, Site
from scored_site import one_point
from site_example import UTM, example_map, surface, terrain
from test_cli import cli, sentence

CAMERAS = {f"{k}.jpg": np.array(p, float) for k, p in enumerate(((-9, -8, 14), (9, -7, 15), (1, 9, 12), (4, 2, 18)))}
RUN: dict[str, Any] = {
    "config": {"stage": "Plan", "mapper": {"stage": "Mapper", "decision": {"stage": "Decision", "tau": 0.4}}},
    "source": {"reconstructor": "photogrammetry", "segmenter": "appearance"},
    "input": {"files": {"0.jpg": "aa", "1.jpg": "bb"}},
    "photos": {"placed": 4},
}


def compared(m: ElevationMap, name: str = "a", cameras: dict[str, np.ndarray] | None = None) -> ComparedSite:
    """A map in memory as a side of a comparison."""
    return ComparedSite(Path(name), m, CAMERAS if cameras is None else cameras, RUN)


def disturbed(m: ElevationMap, seed: int = 0) -> ElevationMap:
    """Another opinion about the same cells: rough heights, other classes, other gaps, an object less."""
    rng = np.random.default_rng(seed)
    z = m.elevation + rng.normal(0.02, 0.05, m.grid.shape).astype(np.float32)
    z[rng.random(m.grid.shape) < 0.1] = np.nan
    label = np.where(rng.random(m.grid.shape) < 0.2, rng.integers(0, 6, m.grid.shape), m.label).astype(np.uint8)
    seen = (m.observed > 0) & (rng.random(m.grid.shape) < 0.9)
    label, z = np.where(seen, label, 255).astype(np.uint8), np.where(seen, z, np.nan).astype(np.float32)
    first = replace(m.objects[0], centre=tuple(np.add(m.objects[0].centre, (0.3, 0, 0.1))), size=(5.5, 2.4, 3.0))
    return replace(m, elevation=z, label=label, observed=seen.astype(np.uint8), objects=(first,))


def part(m: ElevationMap, rows: slice, cols: slice, by_coordinates: bool = True) -> ElevationMap:
    """A piece of a map, at its own place (or, wrongly, at the whole map's corner)."""
    top, left = (rows.start, cols.start) if by_coordinates else (0, 0)
    g = m.grid
    cut = {name: layer[rows, cols] for name, layer in m.layers().items()}
    shape = cut["label"].shape
    return replace(m, grid=Grid(g.west + left * g.cell, g.north - top * g.cell, g.cell, *shape), **cut)


def seen_from(frame: Motion, cell: float, **changes: Any) -> tuple[ElevationMap, dict[str, np.ndarray]]:
    """The example's terrain and classes in another upright frame, and its cameras there."""
    rows, cols = round(20 / frame.scale / cell), round(24 / frame.scale / cell)
    x, y = frame.to_b(np.zeros(1), np.zeros(1))
    grid = Grid(float(x[0]) - cols * cell / 2, float(y[0]) + rows * cell / 2, cell, rows, cols)
    u, v = frame.to_a(*np.meshgrid(grid.x, grid.y))
    z, label = (terrain(u, v) - frame.shift[2]) / frame.scale, surface(u, v)[1]
    m = example_map(cell=0.25)
    like = {name: np.zeros(grid.shape, layer.dtype) for name, layer in m.layers().items()}
    like |= {"elevation": z.astype(np.float32), "label": label, "observed": np.ones(grid.shape, np.uint8)}
    cameras = {
        name: np.array([*np.concatenate(frame.to_b(p[:1], p[1:2])), (p[2] - frame.shift[2]) / frame.scale])
        for name, p in CAMERAS.items()
    }
    return replace(m, grid=grid, objects=(), **like, **changes), cameras


# ---- laws


def test_a_map_is_equal_to_itself() -> None:
    m = example_map(cell=0.2)
    c = compare(compared(m), compared(m))
    known = c.difference[np.isfinite(c.difference)]
    assert len(known) == np.isfinite(m.elevation).sum()
    assert not known.any()
    for family in ("declared", "shifted", "levelled", "similarity"):
        assert c.value(f"elevation_{family}_rmse") == pytest.approx(0, abs=1e-6)
        assert c.value(f"elevation_{family}_cells") == pytest.approx(len(known), rel=0.01)
    assert np.array_equal(c.counts, np.diag(np.diag(c.counts)))
    assert c.value("label_agreement") == c.value("label_iou_excavator") == c.value("label_miou") == 100
    assert c.value("label_kappa") == 1
    for layer in ("observed", "terrain", "classified"):
        assert c.value(f"coverage_{layer}_only_a") == c.value(f"coverage_{layer}_only_b") == 0
        assert c.value(f"coverage_{layer}_shared") == 100
    assert [pair.a.object_id for pair in c.pairs] == [1, 2]
    assert c.value("object_overlap") == pytest.approx(100)
    assert c.value("object_length_difference") == c.value("frame_residual") == 0
    assert c.runs == c.notes == ()


def test_swapping_the_maps_flips_signs_and_transposes_the_confusion() -> None:
    whole = example_map(cell=0.2)
    a, b = (
        compared(part(whole, slice(0, 80), slice(10, 120))),
        compared(disturbed(part(whole, slice(6, 100), slice(0, 97)))),
    )
    c, d = compare(a, b), compare(b, a)
    assert c.grid.shape == d.grid.shape == whole.grid.shape
    assert np.isfinite(c.difference).sum() > 2000
    assert np.array_equal(c.difference, -d.difference, equal_nan=True)
    assert np.array_equal(c.counts, d.counts.T)
    for kind in ("mean", "median"):
        assert c.value(f"elevation_declared_{kind}") == pytest.approx(-d.value(f"elevation_declared_{kind}"))
    for kind in ("nmad", "p95", "rmse"):
        for family in ("declared", "shifted", "levelled"):
            name = f"elevation_{family}_{kind}"
            assert c.value(name) == pytest.approx(d.value(name), rel=1e-4)
    for name in ("label_agreement", "label_kappa", "label_iou_obstacle", "object_distance", "object_overlap"):
        assert c.value(name) == pytest.approx(d.value(name))
    assert c.value("object_only_a") == d.value("object_only_b") == 1
    assert c.value("coverage_terrain_only_a") == d.value("coverage_terrain_only_b") > 0
    assert c.pairs[0].record()["size_difference"] == pytest.approx([0.5, -0.2, 0.2])
    assert d.pairs[0].record()["size_difference"] == pytest.approx([-0.5, 0.2, -0.2])


def test_a_shift_by_whole_cells_is_found_by_coordinates_not_by_index() -> None:
    whole = example_map(cell=0.2)
    rows, cols = slice(7, 90), slice(12, 101)
    c = compare(compared(whole), compared(part(whole, rows, cols)))
    inner = part(whole, rows, cols)
    assert np.isfinite(c.difference).sum() == np.isfinite(inner.elevation).sum()
    assert np.nanmax(np.abs(c.difference)) == 0
    by_index = compare(compared(whole), compared(part(whole, rows, cols, by_coordinates=False)))
    assert by_index.value("elevation_declared_rmse") > 0.3
    # The same piece, its place told by the origin of its georeference instead of its grid.
    west, north, up = UTM.origin
    moved = replace(part(whole, rows, cols, by_coordinates=False), elevation=inner.elevation - 3)
    place = Georeference(UTM.epsg, (west + 12 * 0.2, north - 7 * 0.2, up + 3), 0.1)
    told = compare(compared(whole), compared(replace(moved, georeference=place), cameras={}))
    assert np.isfinite(told.difference).sum() == np.isfinite(inner.elevation).sum()
    assert np.nanmax(np.abs(told.difference)) < 1e-5


# ---- naive twins


def test_figures_of_a_difference_against_loops() -> None:
    d = np.random.default_rng(1).normal(0.3, 1, 401)
    found = {m.name.removeprefix("x_"): m.value for m in figures("x", d, "m", "")}
    ordered = sorted(d)
    median = ordered[200]
    assert found["mean"] == pytest.approx(sum(d) / 401)
    assert found["median"] == pytest.approx(median)
    assert found["nmad"] == pytest.approx(1.4826 * sorted(abs(v - median) for v in d)[200])
    assert found["p95"] == pytest.approx(sorted(abs(v) for v in d)[380])
    assert found["rmse"] == pytest.approx((sum(v * v for v in d) / 401) ** 0.5)
    assert all(np.isnan(m.value) for m in figures("x", d[:0], "m", "")[:-1])


def test_classes_against_loops() -> None:
    rng = np.random.default_rng(2)
    a, b = (rng.choice(np.array(VALUES, np.uint8), 500, p=[0.3, 0.2, 0.1, 0.1, 0.1, 0.1, 0.1]) for _ in "ab")
    b[:300] = a[:300]
    counts = cross_table(a, b)
    found = {m.name: m.value for m in label_figures(counts)}
    pairs = list(zip(a.tolist(), b.tolist(), strict=True))
    for i, p in enumerate(VALUES):
        for j, q in enumerate(VALUES):
            expected = 0 if p == q == 255 else sum(pair == (p, q) for pair in pairs)
            assert counts[i, j] == expected, (p, q)
    classified = [(p, q) for p, q in pairs if 1 <= p <= 5 and 1 <= q <= 5]
    same = sum(p == q for p, q in classified) / len(classified)
    chance = (
        sum(sum(p == k for p, _ in classified) * sum(q == k for _, q in classified) for k in range(1, 6))
        / len(classified) ** 2
    )
    assert found["label_agreement"] == pytest.approx(100 * same)
    assert found["label_kappa"] == pytest.approx((same - chance) / (1 - chance))
    observed = [(p, q) for p, q in pairs if p != 255 and q != 255]
    for k in range(1, 6):
        either = sum(k in pair for pair in observed)
        assert found[f"label_iou_{NAMES[k - 1]}"] == pytest.approx(100 * sum(v == (k, k) for v in observed) / either)
    assert found["label_unknown_b"] == pytest.approx(100 * sum(q == 0 for _, q in observed) / len(observed))
    assert np.isnan(kappa(np.zeros((5, 5), np.int64)))
    assert np.isnan(overlap(np.zeros((2, 2), np.int64))).all()


def test_no_height_is_invented_between_cells() -> None:
    """Coarser cells with gaps, off A's centres by a fraction: bilinear where all cells that count have a height."""
    a, rng = example_map(cell=0.1), np.random.default_rng(3)
    g = Grid(-10.03, 9.71, 0.25, 60, 70)
    z = rng.normal(0, 1, g.shape).astype(np.float32)
    z[rng.random(g.shape) < 0.15] = np.nan
    like = {name: np.zeros(g.shape, layer.dtype) for name, layer in a.layers().items()}
    like |= {
        "elevation": z,
        "observed": np.ones(g.shape, np.uint8),
        "label": rng.integers(0, 6, g.shape).astype(np.uint8),
    }
    b = compared(replace(a, grid=g, **like))
    still = Motion("declared", 0.0, np.zeros(3))
    grid, _ = common_grid(compared(a), b, still)
    layers = layers_of_b(b.map, grid, still)
    for i, j in rng.integers(0, grid.shape, (400, 2)):
        u, v = (grid.x[j] - g.west) / g.cell - 0.5, (g.north - grid.y[i]) / g.cell - 0.5
        col, row = int(np.floor(u)), int(np.floor(v))
        expected = np.nan
        if 0 <= col < g.cols - 1 and 0 <= row < g.rows - 1:
            p, q = u - col, v - row
            expected = (z[row, col] * (1 - p) + z[row, col + 1] * p) * (1 - q)
            expected += (z[row + 1, col] * (1 - p) + z[row + 1, col + 1] * p) * q
        assert layers.elevation[i, j] == pytest.approx(expected, abs=1e-5, nan_ok=True)
        col, row = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
        inside = 0 <= col < g.cols and 0 <= row < g.rows
        assert layers.label[i, j] == (b.map.label[row, col] if inside else 255)


def test_objects_are_brought_into_the_frame_of_a_corner_by_corner() -> None:
    frame = Motion("cameras", 0.7, np.array([5.0, -3.0, 2.0]), scale=2.5)
    for o in example_map(cell=0.5).objects:
        there = moved(o, frame)
        corners = np.stack(frame.to_a(*o.footprint.T), axis=-1)
        assert there.footprint == pytest.approx(corners)
        again = rectangle(there, np.zeros(3))  # from its centre, size and yaw
        apart = np.linalg.norm(again[:, None] - corners[None], axis=-1)
        assert apart.min(axis=1) == pytest.approx(0, abs=1e-9)
        assert there.size[2] == pytest.approx(2.5 * o.size[2])
        assert there.z_top == pytest.approx(2.5 * o.z_top + 2)
        assert there.centre[2] == pytest.approx((there.z_top + there.z_base) / 2)
        assert -90 <= there.yaw < 90
    x, y = frame.to_b(*frame.to_a(np.array([1.0, -4.0]), np.array([2.0, 7.0])))
    assert np.stack([x, y]) == pytest.approx(np.array([[1.0, -4.0], [2.0, 7.0]]))


def test_runs_differ_in_parameters_stages_backbones_and_photos() -> None:
    other = json.loads(json.dumps(RUN))
    other["config"]["mapper"]["decision"]["tau"] = 0.5
    other["config"]["mapper"]["reliability"] = {"stage": "Uniform"}
    other["source"]["reconstructor"] = "vggt"
    other["input"]["files"] = {"renamed.jpg": "aa", "1.jpg": "cc"}
    first = json.loads(json.dumps(RUN))
    first["config"]["mapper"]["reliability"] = {"stage": "Reliability", "floor": 0.05}
    assert [(d.name, d.a, d.b) for d in run_differences(first, other)] == [
        ("mapper.decision.tau", "0.4", "0.5"),
        ("mapper.reliability", "Reliability", "Uniform"),
        ("source.reconstructor", "photogrammetry", "vggt"),
        ("input.files", "2 files, 1 of them in both", "2 files, 1 of them in both"),
    ]
    assert run_differences(RUN, {**RUN, "seconds": 4.0, "started": "later"}) == ()


# ---- frames


LOCAL: dict[str, Any] = {"georeference": None}


def test_local_frames_meet_by_their_cameras_without_touching_a_metric_scale() -> None:
    frame = Motion("cameras", 0.6, np.array([3.0, -2.0, 5.0]))
    m, cameras = seen_from(frame, 0.1)
    a = compared(replace(example_map(cell=0.1), **LOCAL))
    b = compared(replace(m, **LOCAL), "b", cameras)
    c = compare(a, b)
    assert c.placement.way == "cameras"
    assert c.value("frame_residual") < 1e-9
    assert c.value("elevation_declared_p95") < 0.01
    assert c.value("label_agreement") > 98
    assert c.value("elevation_declared_cells") > 25_000
    # Lengths of B off by 3 %: a metric map is not stretched, but the cameras tell.
    off = compared(
        replace(b.map, grid=replace(m.grid, west=1.03 * m.grid.west, north=1.03 * m.grid.north, cell=0.103)), "b",
        {name: 1.03 * p for name, p in cameras.items()},
    )  # fmt: skip
    stretched = compare(a, off)
    assert np.isnan(stretched.value("frame_scale"))
    assert stretched.value("frame_residual") > 0.1
    assert stretched.value("frame_similarity_scale") == pytest.approx(100 * (1 / 1.03 - 1), abs=1e-6)


def test_a_map_without_scale_gets_it_from_the_cameras_and_it_is_said() -> None:
    frame = Motion("cameras", -1.1, np.array([-40.0, 7.0, 2.0]), scale=2.5)
    m, cameras = seen_from(frame, 0.04)
    a = compared(replace(example_map(cell=0.1), **LOCAL))
    b = compared(replace(m, metric=False, **LOCAL), "b", cameras)
    c = compare(a, b)
    assert c.placement.scale == pytest.approx(2.5)
    assert c.value("elevation_declared_p95") < 0.01
    assert c.unit == "m"
    assert any("B has no metric scale" in note for note in c.notes)
    d = compare(b, a)
    assert d.unit == "unit"
    assert d.placement.scale == pytest.approx(0.4)
    assert d.value("elevation_declared_p95") < 0.004
    assert any("A has no metric scale" in note and "with B first" in note for note in d.notes)
    assert {m.unit for m in d.metrics if m.name.startswith("coverage") and m.name[-6:] != "shared"} == {"unit2"}


def test_the_similarity_of_the_cameras_finds_a_lean_and_a_scale() -> None:
    """B's surface is A's, brought into a frame that leans by 2 degrees and is 2 % too large."""
    a = compared(replace(example_map(cell=0.1), **LOCAL))
    lean, s, t = np.radians(2.0), 1.02, np.array([0.4, -0.3, 0.8])
    R = np.array([[1, 0, 0], [0, np.cos(lean), -np.sin(lean)], [0, np.sin(lean), np.cos(lean)]])  # p_B = s R p_A + t
    g = Grid(-12.0, 11.0, 0.1, 205, 245)
    X, Y = np.meshgrid(g.x, g.y)
    z = np.zeros(g.shape)
    for _ in range(40):  # the height over (X, Y) in the leaning frame
        p = (np.stack([X, Y, z], axis=-1) - t) @ R / s
        z = (s * (np.stack([p[..., 0], p[..., 1], terrain(p[..., 0], p[..., 1])], axis=-1) @ R.T) + t)[..., 2]
    m = example_map(cell=0.1)
    like = {name: np.zeros(g.shape, layer.dtype) for name, layer in m.layers().items()}
    like |= {"elevation": z.astype(np.float32), "observed": np.ones(g.shape, np.uint8), "label": like["label"] + 1}
    b = compared(replace(m, grid=g, objects=(), **like, **LOCAL), "b", {n: s * R @ p + t for n, p in CAMERAS.items()})
    c = compare(a, b)
    assert c.value("frame_similarity_residual") < 1e-9
    assert c.value("frame_similarity_scale") == pytest.approx(100 * (1 / 1.02 - 1), abs=1e-6)
    assert c.value("frame_similarity_tilt") == pytest.approx(2.0, abs=1e-6)
    assert c.value("elevation_tilt") == pytest.approx(2.0, abs=0.3)
    assert c.value("elevation_declared_rmse") > 0.15
    assert c.value("elevation_similarity_p95") < 0.01
    assert c.value("elevation_similarity_cells") > 0.9 * np.isfinite(a.map.elevation).sum()


def test_another_utm_zone_is_reprojected() -> None:
    from pyproj import Transformer

    a = compared(example_map(cell=0.2))
    there = Transformer.from_crs(UTM.epsg, 32616, always_xy=True)
    east, north = there.transform(*UTM.origin[:2])
    origin = (round(east), round(north), 200.0)
    g = Grid(-14.0, 14.0, 0.1, 280, 280)
    back = Transformer.from_crs(32616, UTM.epsg, always_xy=True)
    X, Y = np.meshgrid(g.x, g.y)
    u, v = back.transform(X + origin[0], Y + origin[1])
    u, v = u - UTM.origin[0], v - UTM.origin[1]
    like = {name: np.zeros(g.shape, layer.dtype) for name, layer in a.map.layers().items()}
    z = terrain(u, v) + UTM.origin[2] - origin[2]
    like |= {"elevation": z.astype(np.float32), "observed": np.ones(g.shape, np.uint8), "label": surface(u, v)[1]}
    other = replace(a.map, grid=g, objects=(), georeference=Georeference(32616, origin, 0.1), **like)
    c = compare(a, compared(other, "b", {}))
    assert c.placement.way == "reprojected"
    assert c.value("elevation_declared_cells") == np.isfinite(a.map.elevation).sum()
    assert c.value("elevation_declared_p95") < 0.01
    assert c.value("label_agreement") > 98
    assert "reprojected from EPSG:32616 to EPSG:32617" in c.notes[0]
    degrees = replace(other, georeference=Georeference(4326, origin, 0.1))
    with pytest.raises(InputError, match="EPSG:4326, which is no projected CRS in metres"):
        compare(a, compared(degrees, "b", {}))


@pytest.mark.parametrize(
    ("change", "cameras", "way", "message"),
    [
        (LOCAL, {}, "auto", "share 0 placed photos by name and are not both georeferenced; map photos with GPS"),
        (LOCAL, dict.fromkeys(CAMERAS, CAMERAS["0.jpg"]), "auto", "taken from one place"),
        (LOCAL, CAMERAS, "declared", "b has no georeference to align by"),
        ({"georeference": Georeference(UTM.epsg, (455_000.0, *UTM.origin[1:]), 0.1)}, {}, "auto", "do not overlap"),
        ({"observed": "left"}, {}, "auto", "observe no cell in common"),
        ({}, CAMERAS, "icp", "no way to align"),
    ],
)  # fmt: skip
def test_maps_that_cannot_be_compared(change: dict[str, Any], cameras: Any, way: str, message: str) -> None:
    a, b = example_map(cell=0.5), example_map(cell=0.5)
    if change.get("observed") == "left":
        left = np.arange(a.grid.cols) < 20
        a = replace(a, observed=(a.observed * left).astype(np.uint8))
        change = {"observed": (b.observed * ~left).astype(np.uint8)}
    with pytest.raises(InputError, match=message):
        compare(compared(a), compared(replace(b, **change), "b", cameras), way)


# ---- the folder, as a user gets it


def write(folder: Path, m: ElevationMap, run: dict[str, Any] = RUN) -> Path:
    """A SITE folder with the cameras of the tests."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    views = []
    for name, p in CAMERAS.items():
        T = pose.copy()
        T[:3, 3] = p
        views.append(MappedView(name, np.ones((3, 4), np.uint8), np.diag([4.0, 4.0, 1.0]), T))
    write_site(Site(m, one_point(), tuple(views), run=run), folder)
    return folder


@pytest.fixture(scope="module")
def sites(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder, m = tmp_path_factory.mktemp("sites"), example_map(cell=0.2)
    other = json.loads(json.dumps(RUN))
    other["config"]["mapper"]["decision"]["tau"] = 0.5
    return write(folder / "a", m), write(folder / "b", disturbed(part(m, slice(6, 100), slice(0, 97))), other)


@pytest.fixture(scope="module")
def result(sites: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder of a comparison and what was said."""
    folder = tmp_path_factory.mktemp("out") / "deep" / "comparison"
    ran = cli("compare", *sites, "-o", folder)
    assert ran.returncode == 0, ran.stderr
    assert ran.stderr == ""
    return folder, ran.stdout


def of(sites: tuple[Path, Path]) -> Comparison:
    return compare(*map(read_compared, sites))


def test_the_difference_is_a_geotiff_on_the_grid_of_a(sites: tuple[Path, Path], result: tuple[Path, str]) -> None:
    c = of(sites)
    with rasterio.open(result[0] / "difference.tif") as raster, rasterio.open(sites[0] / "elevation.tif") as of_a:
        assert raster.dtypes == ("float32",)
        assert np.isnan(raster.nodata)
        assert raster.crs == of_a.crs
        assert raster.transform.almost_equals(of_a.transform, 1e-9)
        assert raster.shape == of_a.shape
        assert raster.units == ("m",)
        assert "B minus A" in raster.tags()["meaning"]
        values, heights = raster.read(1), of_a.read(1)
    assert np.array_equal(values, c.difference[c.own], equal_nan=True)
    with rasterio.open(sites[1] / "elevation.tif") as of_b:
        there = of_b.read(1)
    assert values[6:, :97] == pytest.approx(there - heights[6:, :97], abs=1e-4, nan_ok=True)
    assert np.isnan(values[:6]).all()
    assert np.isnan(values[:, 97:]).all()


def test_json_csv_and_screen_tell_the_same(sites: tuple[Path, Path], result: tuple[Path, str]) -> None:
    c, (folder, said) = of(sites), result
    assert sorted(p.name for p in folder.iterdir()) == [
        "comparison.csv", "comparison.json", "comparison.png", "difference.tif",
    ]  # fmt: skip
    table = json.loads((folder / "comparison.json").read_text())
    figures = {row["name"]: row["value"] for row in table["figures"]}
    with (folder / "comparison.csv").open() as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        if row["name"] in figures:
            assert float(row["value"]) == pytest.approx(figures[row["name"]])
    assert {row["name"] for row in rows} >= set(figures)
    assert figures["elevation_declared_nmad"] == pytest.approx(c.value("elevation_declared_nmad"))
    cells = np.array(table["confusion"]["cells"])
    assert np.array_equal(cells, c.counts)
    assert np.array(table["confusion"]["area"]) == pytest.approx(cells * 0.04)
    assert cells.sum() == (c.layers_a.observed | c.layers_b.observed).sum()
    areas = sum(float(row["value"]) for row in rows if row["section"] == "confusion_area")
    assert areas == pytest.approx(cells.sum() * 0.04)
    assert [o["object_id"] for o in table["objects"]["only_a"]] == [2]
    assert table["objects"]["matched"][0]["class_a"] == "excavator"
    assert table["runs"] == [{"name": "mapper.decision.tau", "a": "0.4", "b": "0.5"}]
    assert "mapper.decision.tau 0.4 | 0.5" in said
    assert "Objects: 1 in both maps, 1 in A only, 0 in B only" in said
    assert f"Classes: {c.value('label_agreement'):.3g} %" in said
    assert "both georeferences, as declared" in said
    assert all(len(line) <= 130 for line in said.splitlines())


def test_the_picture_shows_both_maps_and_the_difference(result: tuple[Path, str]) -> None:
    with Image.open(result[0] / "comparison.png") as image:
        assert image.width == 1950
        rgb = np.asarray(image.convert("RGB")).astype(int)
    third = rgb.shape[1] // 3
    yellow = (rgb[..., 0] > 150) & (rgb[..., 1] > 110) & (rgb[..., 2] < 60)  # the excavator, lit
    body = slice(80, rgb.shape[0] - 140)
    assert yellow[body, :third].sum() > 300
    assert yellow[body, third : 2 * third].sum() > 100
    right = rgb[body, 2 * third :]
    red, blue = right[..., 0] - right[..., 2] > 40, right[..., 2] - right[..., 0] > 40
    assert min(red.sum(), blue.sum()) > 2000


def test_the_folder_is_replaced_as_a_whole_and_keeps_what_is_the_users(
    sites: tuple[Path, Path], result: tuple[Path, str], tmp_path: Path
) -> None:
    folder = shutil.copytree(result[0], tmp_path / "comparison")
    (folder / "notes.txt").write_text("mine")
    (folder / "difference.tif.aux.xml").write_text("stale")
    assert main(["compare", *map(str, sites[::-1]), "-o", str(folder)]) == 0
    assert (folder / "notes.txt").read_text() == "mine"
    assert not (folder / "difference.tif.aux.xml").exists()
    assert json.loads((folder / "comparison.json").read_text())["a"]["folder"] == str(sites[1])


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda site: shutil.rmtree(site), "does not exist; give the SITE folder"),
        (lambda site: (site / "map.nc").unlink(), "is no SITE (no map.nc)"),
        (lambda site: (site / "objects.geojson").unlink(), "lacks objects.geojson"),
        (lambda site: (site / "run.json").write_text("{"), "is damaged (JSONDecodeError"),
        (lambda site: (site / "run.json").write_text("[]"), "holds no table of a run"),
        (lambda site: (site / "cameras.json").write_text('{"cameras": [{}]}'), "is damaged (KeyError"),
        (lambda site: (site / "map.nc").write_bytes(b"no netcdf"), "is damaged"),
    ],
)
def test_a_spoilt_site_is_one_sentence(
    sites: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str],
    spoil: Callable[[Path], object], message: str,
) -> None:  # fmt: skip
    site = shutil.copytree(sites[1], tmp_path / "b")
    spoil(site)
    assert main(["compare", str(sites[0]), str(site), "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert message in said.err
    assert said.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_site_is_never_overwritten_and_help_can_be_copied(sites: tuple[Path, Path]) -> None:
    before = sorted(p.name for p in sites[1].iterdir())
    assert "already holds something else" in sentence(cli("compare", *sites, "-o", sites[1]))
    assert sorted(p.name for p in sites[1].iterdir()) == before
    said = cli("compare", "--help").stdout
    assert "excavatwin compare site_a site_b -o comparison" in said
    assert "-o FOLDER" in cli("compare", *sites).stdout
