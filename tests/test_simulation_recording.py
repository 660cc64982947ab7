"""Recordings on disk: complete, read back by others, resumed after a stop, and scanned as a laser would."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio
from PIL import Image

from excavatwin.capture import find_photos
from excavatwin.cli import main
from excavatwin.datasets.oces import open_oces
from excavatwin.errors import InputError, OutputError
from excavatwin.evaluation import load_truth
from excavatwin.scene.taxonomy import TaskClass
from excavatwin.simulation import change_truth, digging_series, random_site, render_view
from excavatwin.simulation.change import heights
from excavatwin.simulation.flights import FLIGHTS
from excavatwin.simulation.recording import Scanner, Shoot, elevation, record_dataset, record_sequence, sequence
from excavatwin.simulation.recording.drone_photo import PLACE
from excavatwin.simulation.recording.epoch import objects_of
from excavatwin.simulation.site import CATEGORIES, contents

SHOOT = Shoot(views=2, width=64, epochs=2)


def coarse(seed: int):
    """A site that is made in a second."""
    return replace(random_site(seed), cell=0.1)


@pytest.fixture(scope="module")
def root(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("recording") / "oces"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sequence, "random_site", coarse)
        record_dataset(folder, [(104, SHOOT)])
    return folder


def test_the_reader_of_data_sets_finds_everything(root) -> None:
    dataset = open_oces([root])
    assert dataset.names == ("site_104/epoch_00", "site_104/epoch_01")
    assert "every photo has its truth." in dataset.checks
    assert dataset.categories == CATEGORIES
    site = digging_series(coarse(104), 2)[1]
    recording = dataset.recording("site_104/epoch_01")
    frame = recording.frames[1]
    camera = FLIGHTS["orbit"](2, 64, 104 * 101 + 1)[1]
    view = render_view(site, camera, samples=0)
    np.testing.assert_array_equal(frame.label(), view.label)
    np.testing.assert_array_equal(frame.instance(), view.instance)
    np.testing.assert_array_equal(frame.depth(), view.depth)
    np.testing.assert_allclose(frame.world_points(), view.points, atol=1e-4)
    assert frame.image().shape == (48, 64, 3)
    assert frame.image().std() > 10
    assert {thing.category for thing in recording.objects} <= set(CATEGORIES)
    truth = load_truth(recording.truth)
    assert truth.names == tuple(place.name for place in site.placements)
    np.testing.assert_array_equal(truth.views[1].label, view.label)
    reference = recording.elevation()
    bare = heights(contents(site).ground, reference.grid)
    assert np.nanmean(np.abs(reference.height - bare)) < 0.03
    (change,) = dataset.changes
    moved = change_truth(*digging_series(coarse(104), 2))
    assert (change.cut, change.fill) == pytest.approx((moved.cut, moved.fill))
    assert change.net == pytest.approx(change.fill - change.cut)


def test_photos_tell_where_they_were_taken(root) -> None:
    epoch = root / "site_104" / "epoch_00"
    photos = find_photos(epoch / "images")
    frames = json.loads((epoch / "cameras.json").read_text())["frames"]
    assert [photo.path.name for photo in photos] == [frame["name"] for frame in frames]
    for photo, frame in zip(photos, frames, strict=True):
        assert photo.focal == pytest.approx(frame["K"][0][0], rel=1e-6)
        assert photo.gps is not None
        true = np.array(frame["T_map_cam"])[2, 3] + PLACE.origin[2]
        assert photo.gps.altitude == pytest.approx(true, abs=0.15)
        assert photo.gps.altitude != pytest.approx(true, abs=1e-4)  # as noisy as it says
        assert photo.gps.sigma_vertical == pytest.approx(0.03)


def test_foreign_readers_open_the_files(root) -> None:
    epoch = root / "site_104" / "epoch_00"
    with rasterio.open(epoch / "elevation.tif") as raster:
        assert raster.crs.to_epsg() == PLACE.epsg
        assert raster.bounds.left == PLACE.origin[0] - 15
        assert np.isnan(raster.nodata)
        assert abs(float(np.nanmedian(raster.read(1))) - PLACE.origin[2]) < 3
    cloud = laspy.read(epoch / "lidar.laz")
    assert cloud.header.parse_crs().to_epsg() == PLACE.epsg
    assert set(np.unique(cloud.classification)) == {2, 67, 68, 69}
    assert (np.asarray(cloud.task_class)[np.asarray(cloud.classification) == 68] == TaskClass.EXCAVATOR).all()
    with Image.open(epoch / "instances" / "000000.png") as image:
        assert image.mode.startswith("I;16")
    with Image.open(epoch / "labels" / "000000.png") as image:
        assert image.mode == "L"
    told = json.loads((root / "site_104" / "sequence.json").read_text())
    assert told["epochs"] == ["epoch_00", "epoch_01"]
    assert told["seed"] == 104
    assert told["conditions"]["dust"] == 0


def test_a_stopped_recording_goes_on_where_it_was(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(sequence, "random_site", coarse)

    def stop(stage: str, done: int, total: int) -> None:
        if stage == "epoch 01" and done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record_dataset(tmp_path, [(105, SHOOT)], progress=stop)
    folder = tmp_path / "site_105"
    assert [p.name for p in folder.iterdir()] == ["epoch_00"]  # whole or not at all
    assert not (tmp_path / "dataset.json").exists()
    written = (folder / "epoch_00" / "cameras.json").stat().st_mtime_ns
    (folder / ".epoch_01.0badcafe.part").mkdir()  # what a killed process leaves
    record_dataset(tmp_path, [(105, SHOOT)])
    assert (folder / "epoch_00" / "cameras.json").stat().st_mtime_ns == written
    assert sorted(p.name for p in folder.iterdir()) == ["change.json", "epoch_00", "epoch_01", "sequence.json"]
    record_dataset(tmp_path, [(105, replace(SHOOT, epochs=1, width=96))])  # another plan: made anew
    with Image.open(folder / "epoch_00" / "images" / "000000.jpg") as image:
        assert image.size == (96, 72)
    assert json.loads((folder / "sequence.json").read_text())["epochs"] == ["epoch_00"]
    assert not (folder / "change.json").exists()
    assert json.loads((tmp_path / "dataset.json").read_text())["sequences"] == ["site_105"]


def test_folders_of_others_are_left_alone(tmp_path) -> None:
    (tmp_path / "thesis.docx").write_text("years of work")
    with pytest.raises(OutputError, match=r"thesis\.docx"):
        record_dataset(tmp_path, [(104, SHOOT)])
    (tmp_path / "dataset.json").write_text('{"format": "coco"}')
    with pytest.raises(OutputError, match="stays untouched"):
        record_dataset(tmp_path, [(104, SHOOT)])
    (tmp_path / "epoch_00").mkdir()
    (tmp_path / "epoch_00" / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"notes\.txt"):
        record_sequence(tmp_path, coarse(104), replace(SHOOT, epochs=1))


@pytest.mark.parametrize(
    "wrong", [{"flight": "zigzag"}, {"renderer": "blender"}, {"views": 1}, {"width": 8}, {"epochs": 0}]
)
def test_impossible_shoots_are_refused(wrong) -> None:
    with pytest.raises(InputError, match=str(next(iter(wrong)))):
        replace(SHOOT, **wrong)


def test_a_scan_has_its_noise_its_gaps_and_its_classes() -> None:
    site = coarse(106)
    scan = Scanner(advance=0.2, beam=0.3)(site, seed=1)
    exact = Scanner(advance=0.2, beam=0.3, noise=0, lost=0)(site, seed=1)
    assert len(scan.xyz) < len(exact.xyz)
    ground = contents(site).ground
    terrain = (exact.label == TaskClass.CONSTRUCTION_TERRAIN) | (exact.label == TaskClass.OTHER_TERRAIN)
    grid, height = elevation(exact, site.extent, cell=0.2)
    bare = heights(ground, grid)
    assert np.nanmax(np.abs(height - bare)) < 1.5  # a wall within a cell
    assert np.nanmedian(np.abs(height - bare)) < 0.01
    machine = exact.xyz[exact.instance == 1]
    box = next(thing for thing in objects_of(site) if thing["object_id"] == 1)
    assert box["category"] == "excavator"
    assert machine[:, 2].max() <= box["z_top"] + 1e-3
    place = site.placements[0]
    under = np.linalg.norm(exact.xyz[:, :2] - [place.x, place.y], axis=1) < 0.3
    assert under.any()
    assert not (under & terrain).any()  # it hides the ground below it
    assert 0.02 < np.isnan(height).mean() < 0.6
    _, noisy = elevation(scan, site.extent, cell=0.2)
    both = np.isfinite(noisy) & np.isfinite(height)
    assert 0.003 < np.median(np.abs(noisy - height)[both]) < 0.02


def test_the_command_records_and_tells_what_to_type_next(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    for words, told in (
        ((), "--output"),
        (("-o", "x", "--views", "1"), "Shoot.views is 1"),
        (("-o", "x", "--flight", "zigzag"), "zigzag"),
        (("-o", "x", "--sequences", "0"), "--sequences is 0"),
        (("-o", "x", "--dust", "-1"), "dust is -1"),
        (("-o", "x", "--gps-error", "nan"), "--gps-error is nan"),
        (("-o", "x", "--gps-error", "-1"), "--gps-error is -1"),
        (("-o", "x", "--seed", "99999999999999999999"), "--seed is 999"),
    ):
        assert main(["simulate", *words]) == 2
        assert told in capsys.readouterr().err
        assert not (tmp_path / "x").exists()
    command = [sys.executable, "-m", "excavatwin", "simulate", "-o", "x", "--renderer", "photoreal"]
    environment = os.environ | {"DRJIT_LIBLLVM_PATH": "/nowhere/libLLVM.so"}
    run = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path, env=environment)
    assert run.returncode == 2
    assert "apt install libllvm19" in run.stderr or "excavatwin[sim]" in run.stderr
    assert not (tmp_path / "x").exists()
    words = ("-o", "out", "--seed", "107", "--views", "2", "--width", "64", "--flight", "lawnmower")
    command = [sys.executable, "-m", "excavatwin", "simulate", *words]
    run = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path, timeout=300)
    assert run.returncode == 0, run.stderr
    assert "fast renderer" in run.stdout
    assert "excavatwin map out/site_107/epoch_00/images -o site_107_map" in run.stdout
    assert "excavatwin evaluate site_107_map --truth out/site_107/epoch_00/truth.npz" in run.stdout
    assert len(find_photos(tmp_path / "out" / "site_107" / "epoch_00" / "images")) == 2
