"""``excavatwin evaluate`` as a user runs it: a SITE, a data set in the OCES layout, and what is refused."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from excavatwin.cli import main
from excavatwin.export import write_site
from excavatwin.scene.observations import Lattice
from excavatwin.scene.site import MappedView, Site
from excavatwin.scene.truth import Truth
from excavatwin.simulation import save_truth
from scored_site import PLACE, a_map, a_truth, one_point
from test_cli import cli

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """The command line in this process: exit code, stdout, stderr."""

    def ran(*words: str | Path) -> tuple[int, str, str]:
        code = main(["evaluate", *map(str, words)])
        said = capsys.readouterr()
        return code, said.out, said.err

    return ran


def truth_with_cameras(depth: float = 0.0) -> Truth:
    """Four photos; a pit of that depth."""
    truth = a_truth()
    x, y = np.meshgrid(truth.grid.x, truth.grid.y)
    height = truth.height - np.float32(depth) * ((x > -3) & (x < -1) & (y > -2) & (y < -1))
    views = []
    for k, p in enumerate(((-3, 2, 9), (3, 1, 10), (0, -3, 11), (1, 1, 10))):
        T = truth.views[0].T_M_cam.copy()
        T[:3, 3] = p
        views.append(replace(truth.views[0], name=f"{k:06d}.jpg", T_M_cam=T))
    return replace(truth, height=height, surface=height, views=tuple(views))


def write_map_of(truth: Truth, folder: Path, bias: float = 0.0) -> Path:
    """A SITE folder that is right but for a bias of its elevation [m]."""
    m = a_map(truth)
    m = replace(m, elevation=m.elevation + np.float32(bias))
    views = tuple(
        MappedView(v.name, v.label, v.K_cam, v.T_M_cam, lattice=Lattice(80, 60, np.eye(2, 3), v.K_cam))
        for v in truth.views
    )
    write_site(Site(m, one_point(), views), folder)
    return folder


def write_epoch(folder: Path, truth: Truth) -> None:
    """One epoch of the OCES layout; its photos are noise."""
    (folder / "images").mkdir(parents=True)
    save_truth(truth, folder / "truth.npz")
    frames = []
    for k, v in enumerate(truth.views):
        noise = np.random.default_rng(k).integers(0, 255, (60, 80, 3), np.uint8)
        Image.fromarray(noise).save(folder / "images" / v.name)
        K, T = v.K_cam.tolist(), v.T_M_cam.tolist()
        frames.append({"name": v.name, "width": 80, "height": 60, "K": K, "T_map_cam": T, "time_s": 10.0 * k})
    (folder / "cameras.json").write_text(json.dumps({"frames": frames}))
    objects = [
        {
            "object_id": o.object_id,
            "name": name,
            "category": "obstacle",
            "task_class": int(o.task_class),
            "size": o.size,
            "centre": o.centre,
            "yaw": o.yaw,
            "z_base": o.z_base,
            "z_top": o.z_top,
        }
        for o, name in zip(truth.objects, truth.names, strict=True)
    ]
    (folder / "objects.json").write_text(json.dumps(objects))


def write_elevation(path: Path, truth: Truth, bias: float = 0.0) -> Path:
    import rasterio
    from rasterio.transform import Affine

    g, (east, north, up) = truth.grid, PLACE.origin
    rows, cols = g.shape
    with rasterio.open(
        path, "w", driver="GTiff", height=rows, width=cols, count=1, dtype="float32", nodata=np.nan,
        crs="EPSG:32632", transform=Affine(g.cell, 0, east + g.west, 0, -g.cell, north + g.north),
    ) as file:  # fmt: skip
        height = np.where(np.isin(truth.label, (1, 2)), truth.height + up + bias, np.nan)
        file.write(height.astype(np.float32), 1)
    return path


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two sequences with maps, the first with two epochs; and the folder of the sites."""
    root, sites = tmp_path_factory.mktemp("data") / "oces", tmp_path_factory.mktemp("data") / "sites"
    for name, depths, bias in (("site_a", (0.0, 0.5), 0.02), ("site_b", (0.2,), 0.04)):
        epochs = [f"epoch_{k:02d}" for k in range(len(depths))]
        for epoch, depth in zip(epochs, depths, strict=True):
            truth = truth_with_cameras(depth)
            write_epoch(root / name / epoch, truth)
            write_elevation(root / name / epoch / "elevation.tif", truth, 0.01)
            write_map_of(truth, sites / name / epoch, bias)
        told: dict[str, object] = {"name": name, "epsg": 32632, "origin": PLACE.origin, "epochs": epochs}
        told["times"] = [f"2025-06-02T{9 + k:02d}:00:00" for k in range(len(epochs))]
        (root / name / "sequence.json").write_text(json.dumps(told))
    change = [{"from": "epoch_00", "to": "epoch_01", "cut_m3": 1.0, "fill_m3": 0.0, "net_m3": -1.0}]
    (root / "site_a" / "change.json").write_text(json.dumps(change))
    about = {"format": "excavatwin-oces", "version": 1, "name": "tiny", "policy": "task", "categories": ["obstacle"]}
    (root / "dataset.json").write_text(json.dumps(about | {"sequences": ["site_a", "site_b"]}))
    return root, sites


def read(path: Path) -> dict[tuple[str, str, str], dict[str, str]]:
    with path.open() as file:
        return {(r["sequence"], r["epoch"], r["metric"]): r for r in csv.DictReader(file)}


def test_help_has_examples_that_no_terminal_wraps(run: Run) -> None:
    code, shown, _ = run("--help")
    examples = [line for line in shown.splitlines() if line.startswith("  excavatwin evaluate")]
    assert code == 0
    assert len(examples) >= 4
    assert max(map(len, examples)) < 80


def test_a_site_is_scored_on_screen_as_json_and_as_csv(tmp_path: Path) -> None:
    truth = truth_with_cameras()
    save_truth(truth, tmp_path / "truth.npz")
    site = write_map_of(truth, tmp_path / "site", 0.03)
    result = cli("evaluate", site, "--truth", tmp_path / "truth.npz", "-o", tmp_path / "scores")
    assert result.returncode == 0, result.stderr
    shown = {line.split()[0]: line for line in result.stdout.splitlines() if line.strip()}
    assert "0.03 m" in shown["elevation_mae"]
    assert "strict" in shown["map_miou"]
    assert "'task'" in shown["map_miou"]
    assert "the map lies" in result.stdout  # 3 cm as a whole
    table = json.loads((tmp_path / "scores" / "metrics.json").read_text())
    found = {m["name"]: m for m in table["rows"][0]["metrics"]}
    assert found["elevation_mae"]["value"] == pytest.approx(0.03, abs=1e-4)
    assert found["elevation_fitted_mae"]["value"] == pytest.approx(0, abs=1e-4)
    assert found["elevation_mae"]["paper"] is None
    curve = table["rows"][0]["risk_coverage"]
    assert len(curve["coverage"]) == len(curve["risk"]) <= 101
    row = read(tmp_path / "scores" / "metrics.csv")["site", "", "elevation_mae"]
    assert float(row["value"]) == pytest.approx(0.03, abs=1e-4)
    assert sorted(p.name for p in (tmp_path / "scores").iterdir()) == ["metrics.csv", "metrics.json"]


def test_a_scanner_raster_is_a_reference_for_elevation_alone(run: Run, tmp_path: Path) -> None:
    truth = truth_with_cameras()
    site = write_map_of(truth, tmp_path / "site", 0.03)
    raster = write_elevation(tmp_path / "elevation.tif", truth, 0.01)
    code, _, complaint = run(site, "--truth", raster, "--csv", tmp_path / "m.csv")
    assert code == 0, complaint
    found = read(tmp_path / "m.csv")
    assert float(found["site", "", "elevation_bias"]["value"]) == pytest.approx(0.02, abs=2e-4)
    assert not any(name.startswith("map_") for _, _, name in found)
    save_truth(truth, tmp_path / "truth.npz")
    assert run(site, "--truth", tmp_path / "truth.npz", "--reference", "lidar", "--json", tmp_path / "m.json")[0] == 0
    figures = {m["name"]: m["value"] for m in json.loads((tmp_path / "m.json").read_text())["rows"][0]["metrics"]}
    assert figures["elevation_bias"] == pytest.approx(0.02, abs=2e-4)
    assert figures["map_miou"] == pytest.approx(100)


def test_a_data_set_is_scored_over_its_sequences(run: Run, dataset: tuple[Path, Path], tmp_path: Path) -> None:
    root, sites = dataset
    words = (root, "--sites", sites, "-o", tmp_path / "scores", "--no-map")
    code, shown, complaint = run(*words)
    assert code == 0, complaint
    found = read(tmp_path / "scores" / "metrics.csv")
    mae = found["mean", "", "elevation_mae"]
    assert float(mae["value"]) == pytest.approx(0.03, abs=1e-4)  # epochs of one sequence count once
    assert (float(mae["low"]), float(mae["high"])) == pytest.approx((0.02, 0.04), abs=1e-4)
    assert float(mae["paper"]) == pytest.approx(0.1261)
    assert float(found["mean", "", "photo_miou_pooled"]["value"]) == pytest.approx(100)
    assert float(found["mean", "", "sites_mapped"]["value"]) == 100
    dimension = found["mean", "", "dimension_camera_baseline_relative_error"]
    assert float(dimension["value"]) == pytest.approx(0, abs=0.1)
    assert float(dimension["paper"]) == pytest.approx(10.43)
    assert float(found["site_a", "epoch_01", "volume_cut_error"]["value"]) == pytest.approx(0, abs=0.01)
    assert float(found["site_a", "epoch_01", "final_terrain_mae"]["value"]) == pytest.approx(0.02, abs=1e-4)
    assert float(found["site_a", "epoch_01", "update_interval_mean"]["value"]) == 3600
    assert ("site_a", "epoch_00", "volume_cut") not in found
    assert "site_b" in shown
    assert run(*words, "--seed", "0")[1] == shown
    assert run(root, "--sites", sites, "--reference", "lidar", "--csv", tmp_path / "lidar.csv")[0] == 0
    bias = read(tmp_path / "lidar.csv")["mean", "", "elevation_bias"]
    assert float(bias["value"]) == pytest.approx(0.02, abs=2e-4)


def test_a_site_without_a_map_is_scored_as_an_empty_one(run: Run, dataset: tuple[Path, Path], tmp_path: Path) -> None:
    root, sites = dataset
    shutil.copytree(sites, tmp_path / "sites")
    shutil.rmtree(tmp_path / "sites" / "site_b")
    code, shown, complaint = run(root, "--sites", tmp_path / "sites", "--csv", tmp_path / "m.csv")
    assert code == 0, complaint
    found = read(tmp_path / "m.csv")
    assert float(found["mean", "", "sites_mapped"]["value"]) == pytest.approx(200 / 3)
    assert float(found["site_b", "epoch_00", "photo_miou"]["value"]) == 0
    assert float(found["mean", "", "photo_miou"]["value"]) == pytest.approx(50)
    assert "1 of 2 sequences" in found["mean", "", "elevation_mae"]["meaning"]
    assert "no map of site_b/epoch_00: " in shown


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nowhere"], "does not exist"),
        (["{site}"], "--truth"),
        (["{site}", "--truth", "{root}/nowhere.npz"], "cannot be read as a truth file"),
        (["{site}", "--truth", "{root}/nowhere.tif"], "cannot be read as an elevation raster"),
        (["{site}", "--truth", "{root}/site_a/epoch_00/truth.npz", "--sites", "x"], "belong to data sets"),
        (["{site}", "--truth", "{root}/site_a/epoch_00/truth.npz", "--align", "icp"], "icp"),
        (["{site}", "--mapper.decision.tau", "0.5"], "is mapped already"),
        (["{root}", "--truth", "t.npz"], "drop --truth"),
        (["{root}", "--sites", "elsewhere", "--no-map"], "map them with `excavatwin evaluate"),
        (["{site}", "--truth", "{site}/run.json"], "no .npz file"),
        (["{site}", "--truth", "{site}/label.tif"], "whole numbers"),
        (["{site}", "--truth", "t.npz", "--json", "a", "--csv", "a"], "same file"),
        (["{site}", "--truth", "t.npz", "--seed", "-1"], "--seed is -1"),
        (["{root}/site_a/epoch_00/images"], "no known data set"),
        (["{root}", "--sites", "{sites}", "-o", "{root}"], "will not be overwritten"),
        (["{root}", "--sites", "{sites}", "--csv", "{root}"], "is a folder"),
        (["{root}", "--sites", "{swapped}", "--no-map"], "not made from photos of"),
    ],
)
def test_wrong_words_are_answered_with_one_sentence(
    run: Run, dataset: tuple[Path, Path], words: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    root, sites = dataset
    swapped = tmp_path / "swapped" / "site_a" / "epoch_00"
    if "{swapped}" in words:
        other = truth_with_cameras()
        write_map_of(replace(other, views=tuple(replace(v, name=f"DJI{v.name}") for v in other.views)), swapped)
    places = {"site": sites / "site_a" / "epoch_00", "root": root, "sites": sites, "swapped": tmp_path / "swapped"}
    code, shown, complaint = run(*(w.format(**places) for w in words))
    lines = [line for line in complaint.splitlines() if not line.startswith("[")]
    assert (code, shown, len(lines)) == (2, "", 1), complaint
    assert said in lines[0]
    assert not (tmp_path / "elsewhere").exists()
