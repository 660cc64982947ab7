"""The conformance suite: green for the backbones that ship, and the right sentence for each broken promise."""

from __future__ import annotations

import socket
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import broken_backbones as broken
import test_backbones_imports_cloud as cloud
import test_backbones_imports_colmap as colmap
import test_backbones_imports_sequences as sequences
from excavatwin.backbones.appearance import Appearance
from excavatwin.backbones.catalogue import entries, make
from excavatwin.backbones.conformance import Outcome, check_reconstructor, check_segmenter, light
from excavatwin.backbones.photogrammetry import Photogrammetry
from excavatwin.backbones.protocols import Picture
from excavatwin.backbones.reconstructors.cloud import Cloud
from excavatwin.backbones.reconstructors.colmap import Colmap
from excavatwin.backbones.reconstructors.nerfstudio import Nerfstudio
from excavatwin.backbones.reconstructors.rgbd import Rgbd
from excavatwin.backbones.segmenters.masks import Masks
from excavatwin.capture import find_photos
from excavatwin.cli import main
from excavatwin.cli.rendered_site import render, truth_rows
from excavatwin.scene.progress import silent
from finished_site import shots, write_photos


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    """The first photos of the finished site."""
    return write_photos(tmp_path_factory.mktemp("site"))[:4]


@pytest.fixture(scope="module")
def pictures():
    return [Picture(shot.image, shot.name) for shot in shots()[:3]]


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    """The site that `excavatwin check-backbone` renders, with its truth."""
    folder = tmp_path_factory.mktemp("rendered") / "photos"
    return folder, render(folder, silent)


def green(report) -> None:
    assert not report.failed, str(report)


# --- what ships -----------------------------------------------------------------------------------------------------


def test_photogrammetry_is_green_and_true(rendered, tmp_path):
    from excavatwin.backbones.conformance.reconstructing import examine

    folder, known = rendered
    found = examine(Photogrammetry(lattice=320), find_photos(folder)[:5], tmp_path, silent)
    green(found.report)
    assert not found.report.not_checkable
    rows = truth_rows(found.observations, known)
    assert [row.outcome for row in rows] == [Outcome.PASSED] * 3


def test_appearance_is_green(pictures):
    report = check_segmenter(Appearance(), pictures)
    green(report)
    assert [row.name for row in report.not_checkable] == ["prepare: input of the network"]


def _nerfstudio(folder):
    photos = sequences.write_transforms(folder, lens=False, depth="npy")
    return Nerfstudio(source=str(folder)), photos


def _rgbd(folder):
    photos = sequences.write_scannet(folder)
    return Rgbd(source=str(folder), up="z"), photos


def _colmap(folder):
    photos, workspace = colmap.workspace(folder)
    return Colmap(source=str(workspace), up="z"), photos


def _cloud(folder):
    photos = write_photos(folder / "photos")
    cloud.write_cloud(folder / "scan" / "scan.laz", cloud.points(cloud.ORIGIN), 32632)
    cloud.write_cameras(folder / "scan", "csv")
    return Cloud(source=str(folder / "scan" / "scan.laz")), photos


@pytest.mark.parametrize("write", [_nerfstudio, _rgbd, _colmap, _cloud])
def test_finished_reconstructions_are_green(tmp_path, write):
    (tmp_path / "set").mkdir()
    one, photos = write(tmp_path / "set")
    report = check_reconstructor(one, photos, tmp_path / "scratch")
    green(report)
    assert report.row("validated").outcome == Outcome.PASSED, str(report)


def test_finished_labels_are_green(tmp_path, photos):
    for photo, shot in zip(photos, shots(), strict=False):
        ids = np.where(shot.image[..., 1] > shot.image[..., 0], 3, 1).astype(np.uint8)
        Image.fromarray(ids).save(tmp_path / f"{Path(photo.name).stem}.png")
    named = [Picture(shot.image, p.name, None, p.path) for p, shot in zip(photos[:3], shots(), strict=False)]
    green(check_segmenter(Masks(source=str(tmp_path)), named))


def test_cards_and_parameters_of_all_that_ship():
    every = [(kind, entry) for kind in ("reconstructor", "segmenter") for entry in entries(kind)]
    for kind, entry in every:
        one = make(kind, entry.name)
        rows = [light._frozen(one), light._documented(type(one))]
        assert not [row for row in rows if row.outcome == Outcome.FAILED], (entry.name, rows)
        assert not list(light._card_mistakes(one, kind)), entry.name
    modules = sorted({entry.home.partition(":")[0] for _, entry in every})
    assert light._imported(", ".join(modules)) == ((), "")


def test_what_is_not_here_is_not_checkable(photos, tmp_path):
    missing = check_reconstructor(make("reconstructor", "mast3r"), photos, tmp_path)
    green(missing)
    assert "mast3r" in missing.row("runs").sentence
    assert "pip install" in missing.row("deterministic").sentence or "weights" in missing.row("deterministic").sentence
    assert "masks:SOURCE" in check_segmenter(Masks(), []).row("runs").sentence


# --- broken promises ------------------------------------------------------------------------------------------------


def test_the_exact_one_is_green(photos, tmp_path):
    report = check_reconstructor(broken.Exact(), photos, tmp_path)
    green(report)
    assert "refused" in report.row("odd size 517 x 391").sentence
    assert report.row("unreadable photo").outcome == Outcome.PASSED


@pytest.mark.parametrize(
    ("reconstructor", "row", "sentence"),
    [
        (broken.InvertedPose, "points on their pixels", "world-to-camera"),
        (broken.SwappedSides, "output contract", "rows and columns are swapped"),
        (broken.BgrImages, "lattice in the photo", "BGR"),
        (broken.ForgottenCrop, "lattice in the photo", "offset"),
        (broken.Segments, "no evidence of its own", "leave it zero"),
        (broken.DoublePoints, "output contract", "float64"),
        (broken.Drifting, "deterministic", "differ in confidence"),
        (broken.Calling, "no network", "telemetry.example"),
        (broken.Mute, "progress", "never told"),
        (broken.Losing, "names", "neither a view nor unplaced"),
        (broken.Losing, "provenance", "reconstructor"),
        (broken.Fragile, "one photo", "IndexError"),
    ],
)
def test_broken_reconstructors(reconstructor, row, sentence, photos, tmp_path):
    report = check_reconstructor(reconstructor(), photos, tmp_path)
    assert report.row(row).outcome == Outcome.FAILED, str(report)
    assert sentence in report.row(row).sentence
    assert "FAILED" in str(report).splitlines()[-1]


def test_the_colours_are_green(pictures):
    report = check_segmenter(broken.Colours(), pictures)
    green(report)
    assert not report.not_checkable


@pytest.mark.parametrize(
    ("segmenter", "row", "sentence"),
    [
        (broken.BgrPrepare, "prepare: input of the network", "BGR"),
        (broken.BgrOrder, "prepare: input of the network", "BGR"),
        (broken.SwappedPrepare, "prepare: input of the network", "H and W are swapped"),
        (broken.SquareTransposed, "prepare: input of the network", "H and W are swapped"),
        (broken.Mirrored, "prepare: input of the network", "left and right"),
        (broken.Negative, "prepare: input of the network", "negative slope"),
        (broken.Squared, "prepare: input of the network", "not normalised"),
        (broken.TooMuch, "output contract", "adds up to"),
        (broken.Logits, "output contract", "logits"),
        (broken.Turned, "output contract", "H and W are swapped"),
        (broken.UpsideDown, "evidence on the picture", "edges of the picture"),
        (broken.Dropout, "deterministic", "differ in evidence"),
        (broken.Downloading, "no network", "192.0.2.1"),
        (broken.OneSize, "odd size 517 x 391", "ValueError"),
    ],
)
def test_broken_segmenters(segmenter, row, sentence, pictures):
    report = check_segmenter(segmenter(), pictures)
    assert report.row(row).outcome == Outcome.FAILED, str(report)
    assert sentence in report.row(row).sentence


def test_a_class_that_is_no_frozen_dataclass(pictures):
    report = check_segmenter(broken.Thawed(), pictures)
    said = {row.name: row.sentence for row in report.failed}
    assert "small letters" in said["card"]
    assert "no line that installs" in said["card"]
    assert "says reconstructor" in said["card"]
    assert "frozen=True" in said["frozen dataclass"]
    assert "threshold" in said["parameters documented"]
    assert "changes from" in said["identity"]
    assert "no_such_module is not installed" in report.row("runs").sentence


def test_anything_at_all_can_be_checked(pictures, photos, tmp_path):
    class Nothing:
        __module__ = "__main__"

    for report in (check_segmenter(Nothing(), pictures), check_reconstructor(Nothing(), photos, tmp_path)):
        assert {row.name for row in report.failed} == {"card", "frozen dataclass", "identity"}
        assert report.row("runs").sentence == "it has no card."


def test_import_of_a_heavy_library(tmp_path, monkeypatch, pictures):
    (tmp_path / "tensorflow.py").write_text("")
    (tmp_path / "heavy_plugin.py").write_text(
        "import tensorflow\nfrom broken_backbones import Colours\nclass Heavy(Colours):\n    pass\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    import heavy_plugin

    for name in ("heavy_plugin", "tensorflow"):
        del sys.modules[name]  # for good: einops asks a module of that name what it can
    row = check_segmenter(heavy_plugin.Heavy(), pictures).row("light import")
    assert row.outcome == Outcome.FAILED
    assert "tensorflow" in row.sentence


def test_the_network_is_open_again(pictures):
    check_segmenter(broken.Downloading(), pictures)
    assert "connect" not in vars(socket.socket)
    assert socket.getaddrinfo("127.0.0.1", 80)


# --- command line ---------------------------------------------------------------------------------------------------


def test_command(rendered, capsys):
    assert main(["check-backbone", "appearance", "--photos", str(rendered[0]), "--appearance.work-side", "200"]) == 0
    said = capsys.readouterr()
    assert "passed         deterministic" in said.out
    assert "appearance: 12 passed, 1 not checkable here." in said.out
    assert "check" in said.err


def test_command_with_a_broken_promise(rendered, capsys, monkeypatch):
    from excavatwin.backbones import catalogue

    monkeypatch.setitem(catalogue.SHIPPED["segmenter"], "colours", "broken_backbones:TooMuch")
    assert main(["check-backbone", "colours", "--photos", str(rendered[0])]) == 2
    assert "FAILED         output contract" in capsys.readouterr().out


def test_gross_errors_fail_against_the_truth(rendered):
    from dataclasses import replace

    from excavatwin.scene.observations import Observations, View

    _, known = rendered
    views = []
    for name, one in known.items():
        H, W = one.points.shape[:2]
        K = np.array([[250.0, 0, W / 2], [0, 250, H / 2], [0, 0, 1]])
        views.append(View(name, one.points, np.ones((H, W), np.float32), np.zeros((H, W, 5), np.float32), one.T, K))
    exact = Observations(tuple(views), metres_per_unit=1.0)
    assert all(row.outcome == Outcome.PASSED for row in truth_rows(exact, known))
    turned = replace(views[0], T_R_cam=views[0].T_R_cam @ np.diag([1.0, -1, -1, 1]))
    rows = truth_rows(replace(exact, views=(turned, *views[1:])), known)
    assert "not the cameras" in rows[0].sentence
    noise = np.random.default_rng(0).normal(0, 20, views[0].points.shape).astype(np.float32)
    shaken = tuple(replace(view, points=view.points + noise) for view in views)
    assert "not this surface" in truth_rows(replace(exact, views=shaken), known)[1].sentence
