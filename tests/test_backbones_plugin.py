"""The worked plugin: installed into a folder of its own, found by its entry points, and green in the suite."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from finished_site import shots

PLUGIN = Path(__file__).parent.parent / "docs" / "examples" / "excavatwin-plugin"


def install(target: Path) -> None:
    """By pip where the build backend is at hand, else by hand: the package and the dist-info that pip would write."""
    if importlib.util.find_spec("hatchling") and importlib.util.find_spec("pip"):
        pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation", "--no-index"]
        subprocess.run([*pip, "--target", str(target), str(PLUGIN)], check=True)
        return
    import shutil

    project = tomllib.loads((PLUGIN / "pyproject.toml").read_text())
    (package,) = project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]
    shutil.copytree(PLUGIN / package, target / Path(package).name)
    meta = project["project"]
    about = target / f"{meta['name'].replace('-', '_')}-{meta['version']}.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {meta['name']}\nVersion: {meta['version']}\n")
    groups = meta["entry-points"].items()
    rows = [f"[{group}]\n" + "".join(f"{name} = {home}\n" for name, home in one.items()) for group, one in groups]
    (about / "entry_points.txt").write_text("\n".join(rows))


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> Path:
    target = tmp_path_factory.mktemp("site-packages")
    install(target)
    return target


def excavatwin(installed: Path, *words: str) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": str(installed), "COLUMNS": "200"}
    command = [sys.executable, "-m", "excavatwin", *words]
    return subprocess.run(command, capture_output=True, text=True, env=environment, check=False)


def scan(folder: Path) -> Path:
    """The finished site as the plugin reads it."""
    (folder / "photos").mkdir(parents=True)
    cameras = {}
    for shot in shots():
        Image.fromarray(shot.image).save(folder / "photos" / shot.name)
        np.save(folder / f"{Path(shot.name).stem}.npy", np.nan_to_num(shot.depth, posinf=0))
        cameras[shot.name] = {"T_world_cam": shot.T.tolist(), "K": shot.K.tolist()}
    (folder / "poses.json").write_text(json.dumps(cameras))
    return folder


def test_both_are_listed(installed):
    done = excavatwin(installed, "backbones")
    assert done.returncode == 0, done.stderr
    for name in ("greenness", "posed-depth"):
        (line,) = (line for line in done.stdout.splitlines() if line.split()[:1] == [name])
        assert "from package excavatwin-plugin" in line
    assert "posed-depth" not in excavatwin(installed.parent, "backbones").stdout


def test_greenness_keeps_its_promises(installed):
    done = excavatwin(installed, "check-backbone", "greenness", "--greenness.threshold", "0.05")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "greenness: 12 passed, 1 not checkable here." in done.stdout
    assert "render" in done.stderr


def test_posed_depth_keeps_its_promises(installed, tmp_path):
    folder = scan(tmp_path / "scan")
    done = excavatwin(installed, "check-backbone", f"posed-depth:{folder}", "--photos", str(folder / "photos"))
    assert done.returncode == 0, done.stdout + done.stderr
    assert "FAILED" not in done.stdout
    assert "passed         points on their pixels" in done.stdout


def test_poses_of_the_wrong_direction_are_found(installed, tmp_path):
    folder = scan(tmp_path / "scan")
    cameras = json.loads((folder / "poses.json").read_text())
    for camera in cameras.values():
        camera["T_world_cam"] = np.linalg.inv(camera["T_world_cam"]).tolist()
    (folder / "poses.json").write_text(json.dumps(cameras))
    done = excavatwin(installed, "check-backbone", f"posed-depth:{folder}", "--photos", str(folder / "photos"))
    assert done.returncode == 2, done.stdout + done.stderr
    assert "world-to-camera" in " ".join(done.stdout.split())


def test_its_own_tests_pass(installed):
    environment = os.environ | {"PYTHONPATH": str(installed)}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(PLUGIN / "tests")]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False, cwd=PLUGIN)
    assert done.returncode == 0, done.stdout
