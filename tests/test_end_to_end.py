"""From photos to a SITE as a user does it: the sample against its truth, and a folder as messy as real ones."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from excavatwin.evaluation import evaluate_site, load_truth
from test_cli import cli, sentence

SAMPLE = Path(__file__).parent.parent / "sample"
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (SAMPLE / "truth.npz").exists(), reason="sample/ is not in this checkout"),
]
SMALL = ("--photogrammetry.lattice", "320")


def run_record(site: Path) -> dict[str, Any]:
    return dict(json.loads((site / "run.json").read_text()))


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    site = tmp_path_factory.mktemp("demo") / "site"
    result = cli("demo", "-o", site)
    assert result.returncode == 0, result.stderr
    return site, result.stdout


def test_demo_maps_every_photo_and_prints_its_accuracy(demo: tuple[Path, str]) -> None:
    site, said = demo
    count = len(list((SAMPLE / "photos").glob("*.jpg")))
    assert f"mapped {count} of {count} photos" in said
    assert "elevation_mae" in said
    assert f"results saved to {site}" in said


def test_demo_is_as_accurate_as_promised(demo: tuple[Path, str]) -> None:
    metrics = {m.name: m.value for m in evaluate_site(demo[0], load_truth(SAMPLE / "truth.npz"))}
    assert metrics["elevation_mae_gsd"] <= 1.0
    assert metrics["elevation_tilt"] < 0.2
    assert metrics["map_coverage"] > 85


def test_another_fusion_parameter_does_not_touch_the_photos(demo: tuple[Path, str]) -> None:
    site, _ = demo
    before = run_record(site)
    result = cli("map", SAMPLE / "photos", "-o", site, "--mapper.decision.tau", "0.7")
    assert result.returncode == 0, result.stderr
    after = run_record(site)
    assert after["config"]["mapper"]["decision"]["tau"] == 0.7
    for stage in ("place", "densify"):
        assert not before["stages"][stage]["cached"]
        assert after["stages"][stage]["cached"]
    assert after["stages"]["segment"]["cached"] == after["photos"]["placed"]


def overlapping_noise(folder: Path) -> list[str]:
    """Four photos of another place: crops of one random texture."""
    rng = np.random.default_rng(3)
    coarse = Image.fromarray(rng.integers(0, 255, (90, 120, 3), np.uint8)).resize(
        (1600, 1200), Image.Resampling.BICUBIC
    )
    names = []
    for i in range(4):
        names.append(f"elsewhere_{i}.png")
        coarse.crop((60 * i, 40 * i, 60 * i + 800, 40 * i + 600)).save(folder / names[-1])
    return names


@pytest.fixture(scope="module")
def messy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six photos without EXIF, four of another place, a corrupt JPEG and a text file."""
    folder = tmp_path_factory.mktemp("messy") / "photos"
    folder.mkdir()
    originals = sorted((SAMPLE / "photos").glob("*.jpg"))
    for path in originals[:6]:
        with Image.open(path) as photo:
            photo.convert("RGB").save(folder / path.name, quality=92)
    overlapping_noise(folder)
    (folder / "torn.jpg").write_bytes(originals[0].read_bytes()[:5000])
    (folder / "notes.txt").write_text("north gate closed")
    return folder


def test_interrupted_run_says_so_and_resumes(messy: Path) -> None:
    site = messy.parent / "site"
    command = [sys.executable, "-m", "excavatwin", "map", str(messy), "-o", str(site), *SMALL]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        said = []
        for line in process.stderr:
            said.append(line)
            if "undistortion" in line or "dense depth" in line:
                process.send_signal(signal.SIGINT)
                break
        out, rest = process.communicate(timeout=300)
    result = subprocess.CompletedProcess(command, process.returncode, out, "".join(said) + rest)
    assert "same command resumes" in sentence(result, 130)
    assert not site.exists()

    again = cli("map", messy, "-o", site, *SMALL)
    assert again.returncode == 0, again.stderr
    stages = run_record(site)["stages"]
    assert stages["place"]["cached"]
    assert not stages["densify"]["cached"]


def test_messy_folder_is_mapped_and_everything_left_out_is_named(messy: Path) -> None:
    site = messy.parent / "site"
    result = cli("map", messy, "-o", site, *SMALL)
    assert result.returncode == 0, result.stderr
    record = run_record(site)
    left_out = {row["name"] for row in record["photos"]["unplaced"]}
    assert left_out == {"torn.jpg", *(f"elsewhere_{i}.png" for i in range(4))}
    assert all(name in result.stdout for name in left_out)
    assert record["photos"]["placed"] == 6
    assert record["map"]["unit"] == "unit"  # no GPS: arbitrary, and said so
    assert "--reference" in result.stdout
    assert record["warnings"]


def test_reference_length_makes_metres(messy: Path) -> None:
    site, name = messy.parent / "site", sorted(messy.glob("*.jpg"))[0].name
    with Image.open(messy / name) as photo:
        W, H = photo.size
    reference = f"{name}:{W // 3},{H // 2}:{2 * W // 3},{H // 2}=12.5"
    result = cli("map", messy, "-o", site, *SMALL, "--reference", reference)
    assert result.returncode == 0, result.stderr
    record = run_record(site)
    assert record["map"]["unit"] == "m"
    assert record["stages"]["densify"]["cached"]


def test_two_sets_without_overlap_are_not_glued_together(tmp_path: Path) -> None:
    overlapping_noise(tmp_path)
    for path in sorted((SAMPLE / "photos").glob("*.jpg"))[:2]:
        shutil.copy(path, tmp_path)
    result = cli("map", tmp_path, "-o", tmp_path.parent / f"{tmp_path.name}_site", *SMALL)
    assert result.returncode in (0, 2), result.stderr
    if result.returncode == 2:
        sentence(result)
    else:  # the crops hang together as a plane; then the two photos are named
        assert all(path.name in result.stdout for path in tmp_path.glob("*.jpg"))


def test_full_disk_keeps_the_finished_stages(messy: Path) -> None:
    resource = pytest.importorskip("resource")
    site = messy.parent / "small_disk"

    def small_disk() -> None:  # no file may grow over 3 MB: the placement fits, the dense depth does not
        resource.setrlimit(resource.RLIMIT_FSIZE, (3_000_000, 3_000_000))

    assert "disk is full" in sentence(cli("map", messy, "-o", site, preexec_fn=small_disk))
    assert not site.exists()
    assert not list((messy.parent / ".small_disk.cache").rglob("*.part"))
    assert os.listdir(messy.parent / ".small_disk.cache" / "place")
