"""The command line as a user runs it: a process of its own, its exit code, and what it says."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import excavatwin
from excavatwin.cli import main
from excavatwin.cli.console import consent
from excavatwin.cli.flags import merge, split_stage_flags
from excavatwin.cli.plans import Choice, backbone_tables, read_plan, to_toml
from excavatwin.cli.references import format_reference, parse_reference
from excavatwin.cli.settings import parameters
from excavatwin.errors import InputError
from excavatwin.scene.elevation_map import LAYERS
from excavatwin.survey.plan import Plan

Result = subprocess.CompletedProcess[str]


def cli(*words: str | Path, **options: Any) -> Result:
    """Run ``python -m excavatwin`` with plain output."""
    command = [sys.executable, "-m", "excavatwin", *map(str, words)]
    environment = os.environ | {"COLUMNS": "100", "NO_COLOR": "1"}
    return subprocess.run(command, capture_output=True, text=True, env=environment, check=False, timeout=600, **options)


def sentence(result: Result, code: int = 2) -> str:
    """The one sentence of a refusal: exit code, no traceback, nothing but progress beside it."""
    assert result.returncode == code, result.stderr
    assert "Traceback" not in result.stderr
    said = [line for line in result.stderr.splitlines() if not line.startswith("[")]
    assert len(said) == 1, said
    assert said[0].startswith("excavatwin: ")
    assert result.stdout == ""
    return said[0]


# --- what needs no photos -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "command", [(), ("map",), ("fuse",), ("config",), ("doctor",), ("demo",), ("simulate",), ("layers",)]
)
def test_help_has_examples_that_can_be_copied(command: tuple[str, ...]) -> None:
    result = cli(*command, "--help")
    assert result.returncode == 0
    assert "Usage: excavatwin" in result.stdout
    if command != ("layers",):
        examples = [line for line in result.stdout.splitlines() if line.startswith("  excavatwin ")]
        assert examples
        assert max(map(len, examples)) < 80  # no terminal wraps them


def test_help_imports_nothing_heavy() -> None:
    code = "import sys; from excavatwin.cli import main; main(['map', '--help']); print(sorted(sys.modules))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = result.stdout.rsplit("[", 1)[1]
    for name in ("numpy", "numba", "scipy", "cv2", "xarray", "rasterio", "matplotlib", "pycolmap", "pandas"):
        assert f"'{name}'" not in loaded


def test_version() -> None:
    assert cli("--version").stdout.strip() == f"excavatwin {excavatwin.__version__}"


def test_layers_lists_the_registry() -> None:
    result = cli("layers")
    assert result.returncode == 0
    assert all(layer.name in result.stdout for layer in LAYERS)
    assert "excavator" in result.stdout


def test_doctor_estimates_memory() -> None:
    result = cli("doctor", "--photos", "75", "--lattice", "640")
    assert result.returncode == 0
    assert "75 photos" in result.stdout
    assert "pycolmap" in result.stdout
    assert "at least 1" in sentence(cli("doctor", "--photos", "0")) or ">= 1" in sentence(
        cli("doctor", "--photos", "0")
    )


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["mpa"], 'Did you mean "map"'),
        (["map"], "PHOTOS"),
        (["map", "photos"], "--output"),
        (["map", "photos", "-o", "site", "--mapper.decision.tua", "1"], "did you mean mapper.decision.tau?"),
        (["map", "photos", "-o", "site", "--mapper.decision.tau", "high"], "give a number"),
        (["map", "photos", "-o", "site", "--mapper.decision.tau"], "needs a value"),
        (["map", "photos", "-o", "site", "--reference", "IMG.JPG=3"], "PHOTO:x1,y1:x2,y2=METRES"),
        (["map", "nowhere", "-o", "site"], "nowhere does not exist"),
        (["map", "photos", "-o", "site", "--segmenter", "masks"], "say which: --segmenter masks:PATH"),
        (["map", "photos", "-o", "site", "--reconstructor", "colmap:none"], "none, which does not exist"),
        (["map", "photos", "-o", "site", "--reconstructor", ""], "there is no reconstructor ''"),
        (["fuse", "nowhere.npz", "-o", "site"], "nowhere.npz"),
        (["layers", "--mapper.decision.tau", "1"], "belong to"),
        (["config", "--config", "nowhere.toml"], "cannot be read"),
        (["fuse", "o.npz", "-o", "site", "--photogrammetry.lattice", "320"], "no stage photogrammetry"),
    ],
)
def test_wrong_words_are_answered_with_one_sentence(words: list[str], said: str, tmp_path: Path) -> None:
    assert said in sentence(cli(*words, cwd=tmp_path))
    assert list(tmp_path.iterdir()) == []


def test_config_prints_toml_that_config_takes_back(tmp_path: Path) -> None:
    first = cli("config", "--mapper.decision.tau", "0.61", "--mapper.reliability", "uniform")
    assert first.returncode == 0
    assert tomllib.loads(first.stdout)["mapper"]["decision"]["tau"] == 0.61
    file = tmp_path / "settings.toml"
    file.write_text(first.stdout)
    assert cli("config", "--config", file).stdout == first.stdout
    file.write_text("[mapper.decision]\ntoo = 1\n")
    assert "no parameter mapper.decision.too" in sentence(cli("config", "--config", file))
    file.write_text("[mapper")
    assert "not valid TOML" in sentence(cli("config", "--config", file))


# --- parameters -----------------------------------------------------------------------------------------------------


def test_every_parameter_has_a_meaning_and_survives_toml(tmp_path: Path) -> None:
    plan = Plan()
    rooms = [plan.video, plan.merging, plan.mapper, *backbone_tables(plan).values()]
    assert [p.path for room in rooms for p in parameters(room) if not p.meaning] == []
    file = tmp_path / "settings.toml"
    file.write_text(to_toml(plan))
    assert read_plan(file, None) == plan
    file.write_text(file.read_text().replace("tau = 0.", "tau = 0.1"))
    assert read_plan(file, None) != plan


def test_flags_win_over_the_file() -> None:
    rest, flags = split_stage_flags(["map", "p", "--a.b-c", "1", "-o", "s", "--a.d=-2", "--", "--x.y"])
    assert rest == ["map", "p", "-o", "s", "--", "--x.y"]
    assert flags == {"a": {"b_c": "1", "d": "-2"}}
    assert merge({"a": {"d": 1, "e": 5}, "f": 1}, flags) == {"a": {"b_c": "1", "d": "-2", "e": 5}, "f": 1}


def test_references_are_read_and_written() -> None:
    reference = parse_reference("my photo: 1.JPG:1200,840.5:1510,861=4.2")
    assert (reference.view, reference.a, reference.b, reference.metres) == (
        "my photo: 1.JPG",
        (1200.0, 840.5),
        (1510.0, 861.0),
        4.2,
    )
    assert parse_reference(format_reference(reference)) == reference
    for text in ("a.jpg:1,2:1,2=3", "a.jpg:1,2:3,4=0", "a.jpg:1:2=3", "1,2:3,4=5"):
        with pytest.raises(InputError):
            parse_reference(text)


def interrupted_in_compiled_code() -> SystemError:
    """What CPython raises when Ctrl-C comes while a compiled function runs."""
    error = SystemError("CPUDispatcher returned a result with an exception set")
    error.__cause__ = KeyboardInterrupt()
    return error


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (KeyboardInterrupt(), 130, "same command resumes"),
        (interrupted_in_compiled_code(), 130, "same command resumes"),
        (InputError("these photos are of a cat."), 2, "these photos are of a cat."),
        (MemoryError(), 2, "memory ran out"),
        (ZeroDivisionError("oops"), 1, "--debug"),
    ],
)
def test_every_failure_is_one_sentence(
    error: BaseException, code: int, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise error

    monkeypatch.setattr("excavatwin.survey.map_photos", fail)
    assert main(["map", "photos", "-o", "site"]) == code
    assert said in capsys.readouterr().err
    if code != 130:
        with pytest.raises(type(error)):
            main(["map", "photos", "-o", "site", "--debug"])


# --- photos that cannot be mapped -----------------------------------------------------------------------------------


def picture(path: Path, seed: int = 0) -> None:
    noise = np.random.default_rng(seed).integers(0, 255, (120, 160, 3), np.uint8)
    Image.fromarray(noise).save(path)


def nothing(folder: Path) -> None:
    pass


def one_photo(folder: Path) -> None:
    picture(folder / "a.jpg")


def texts(folder: Path) -> None:
    (folder / "notes.txt").write_text("hello")


def corrupt(folder: Path) -> None:
    for name in ("a.jpg", "b.jpg", "c.jpg"):
        picture(folder / name)
        (folder / name).write_bytes((folder / name).read_bytes()[:200])


def unrelated(folder: Path) -> None:
    for seed in range(6):
        picture(folder / f"{seed}.jpg", seed)


@pytest.mark.parametrize("fill", [nothing, one_photo, texts, corrupt, unrelated])
def test_photos_without_a_map_are_refused(fill: Callable[[Path], None], tmp_path: Path) -> None:
    photos = tmp_path / "photos"
    photos.mkdir()
    fill(photos)
    before = sorted(photos.iterdir())
    sentence(cli("map", photos, "-o", tmp_path / "site"))
    assert sorted(photos.iterdir()) == before
    assert list(tmp_path.iterdir()) == [photos]


# --- observations ---------------------------------------------------------------------------------------------------


def observations(path: Path, **changes: Any) -> Path:
    """Two views straight down on gently waved ground with a box, with some entries changed (None: left out)."""
    S, H, W, f, height = 3, 48, 64, 60.0, 10.0
    K_cam = np.array([[f, 0, W / 2], [0, f, H / 2], [0, 0, 1]])
    poses = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (S, 1, 1))
    poses[:, 0, 3], poses[:, 1, 3], poses[:, 2, 3] = np.arange(S), np.arange(S) % 2, height
    u, v = np.meshgrid(np.arange(W) + 0.5, np.arange(H) + 0.5)
    ray = np.stack([(u - W / 2) / f, (v - H / 2) / f, np.ones_like(u)], axis=-1)
    points = np.empty((S, H, W, 3), np.float32)
    for s in range(S):
        depth = np.full((H, W), height)
        for _ in range(8):  # where the ray meets z = ground(x, y)
            x, y = ray[..., 0] * depth + poses[s, 0, 3], -ray[..., 1] * depth + poses[s, 1, 3]
            depth = height - 0.2 * np.sin(x) * np.cos(y)
        points[s] = (ray * depth[..., None]) @ poses[s, :3, :3].T + poses[s, :3, 3]
    evidence = np.zeros((S, H, W, 5), np.float32)
    evidence[..., 0] = 0.9
    arrays: dict[str, Any] = {"points": points, "confidence": np.ones((S, H, W), np.float32), "evidence": evidence}
    arrays |= {
        "T_world_cam": poses,
        "K": np.tile(K_cam, (S, 1, 1)),
        "up": np.array([0.0, 0, 1]),
        "metres_per_unit": 1.0,
    }
    arrays |= changes
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})
    return path


def test_fuse_writes_a_site_and_tells(tmp_path: Path) -> None:
    site = tmp_path / "site"
    result = cli("fuse", observations(tmp_path / "o.npz"), "-o", site)
    assert result.returncode == 0, result.stderr
    assert "mapped 3 of 3" in result.stdout
    assert f"results saved to {site}" in result.stdout
    assert "next:" in result.stdout
    written = {path.name for path in site.iterdir()}
    assert {"map.nc", "elevation.tif", "label.tif", "points.laz", "objects.geojson", "labels"} <= written
    assert {"cameras.json", "preview.png", "run.json"} <= written
    assert sorted(tmp_path.iterdir()) == [tmp_path / "o.npz", site]


def test_fuse_takes_labels_in_another_vocabulary(tmp_path: Path) -> None:
    labels, vocabulary = np.ones((3, 48, 64), np.uint8), np.array(["sky", "earth, ground"])
    file = observations(tmp_path / "o.npz", evidence=None, labels=labels, vocabulary=vocabulary)
    assert "--class-mapping ade20k-150" in sentence(cli("fuse", file, "-o", tmp_path / "site"))
    result = cli("fuse", file, "-o", tmp_path / "site", "--class-mapping", "ade20k-150")
    assert result.returncode == 0, result.stderr
    assert set(np.unique(np.array(Image.open(tmp_path / "site" / "labels" / "view_000.png")))) <= {0, 1, 255}


NOWHERE = np.full((3, 48, 64, 3), np.nan, np.float32)
TWISTED = np.tile(np.diag([1.0, -2.0, -1.0, 1.0]), (3, 1, 1))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"points": None}, "points"),
        ({"points": NOWHERE}, ""),
        ({"T_world_cam": TWISTED}, "rotation"),
        ({"evidence": np.zeros((3, 40, 64, 5), np.float32)}, "evidence"),
        ({"evidence": None, "labels": np.zeros((3, 24, 32), np.uint8)}, "labels"),
        ({"confidence": np.full((3, 48, 64), -1, np.float32)}, "confidence"),
        ({"K": np.zeros((3, 3, 3))}, "K"),
    ],
    ids=["no points", "nan everywhere", "no rotation", "wrong evidence", "wrong masks", "negative", "no camera"],
)
def test_observations_that_break_the_contract_are_refused(changes: dict[str, Any], said: str, tmp_path: Path) -> None:
    assert said in sentence(cli("fuse", observations(tmp_path / "o.npz", **changes), "-o", tmp_path / "site"))
    assert not (tmp_path / "site").exists()


def test_file_that_is_no_archive_is_refused(tmp_path: Path) -> None:
    (tmp_path / "o.npz").write_bytes(b"PK\x03\x04 not really")
    sentence(cli("fuse", tmp_path / "o.npz", "-o", tmp_path / "site"))


def test_read_only_target_is_refused(tmp_path: Path) -> None:
    file = observations(tmp_path / "o.npz")
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o555)
    target = locked / "site" if os.geteuid() else Path("/proc/site")  # root may write anywhere but there
    assert "cannot be written" in sentence(cli("fuse", file, "-o", target))


def test_full_disk_leaves_the_earlier_site_untouched(tmp_path: Path) -> None:
    resource = pytest.importorskip("resource")
    file, site = observations(tmp_path / "o.npz"), tmp_path / "site"
    assert cli("fuse", file, "-o", site).returncode == 0
    before = {path: path.read_bytes() for path in sorted(site.rglob("*")) if path.is_file()}

    def small_disk() -> None:  # no file may grow over 8 kB
        resource.setrlimit(resource.RLIMIT_FSIZE, (8192, 8192))

    assert "disk is full" in sentence(cli("fuse", file, "-o", site, preexec_fn=small_disk))
    assert {path: path.read_bytes() for path in sorted(site.rglob("*")) if path.is_file()} == before
    assert sorted(tmp_path.iterdir()) == [file, site]


def test_foreign_folder_is_not_replaced(tmp_path: Path) -> None:
    file, folder = observations(tmp_path / "o.npz"), tmp_path / "thesis"
    folder.mkdir()
    (folder / "thesis.docx").write_text("years of work")
    assert "thesis.docx" in sentence(cli("fuse", file, "-o", folder))
    assert (folder / "thesis.docx").read_text() == "years of work"


# --- backbones ------------------------------------------------------------------------------------------------------


def test_parameters_of_a_backbone_that_is_not_used_are_refused() -> None:
    with pytest.raises(InputError, match="--segmenter yoloe"):
        read_plan(None, {"yoloe": {"device": {}}})
    with pytest.raises(InputError, match="did you mean mapper"):
        read_plan(None, {"maper": {}})


def test_map_flag_needs_a_segmenter_with_classes() -> None:
    with pytest.raises(InputError, match="appearance has no classes"):
        read_plan(None, None, Choice(remap=["gravel=other_terrain"]))


def test_weights_are_never_fetched_without_consent(monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("yes\n"))  # no terminal: nobody can have agreed
    assert consent(download=False)("Download the weights?") is False
    assert consent(download=True)("Download the weights?") is True
    assert "--download" in capsys.readouterr().err


def test_a_class_that_is_mapped_twice_is_refused() -> None:
    twice = ["gravel=other_terrain", "Gravel=obstacle"]
    with pytest.raises(InputError, match="speaks of 'Gravel' twice"):
        read_plan(None, None, Choice(segmenters=["segformer"], remap=twice))
