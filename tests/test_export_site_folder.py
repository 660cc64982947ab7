"""The SITE folder appears whole or not at all."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import excavatwin.export.preview
from excavatwin.errors import OutputError
from excavatwin.export import write_site
from excavatwin.export.preview import best_view, encode_preview
from excavatwin.export.relief import hillshade
from excavatwin.export.run_record import to_json
from excavatwin.scene.staging import whole_file
from site_example import example_site

FILES = {
    "README.txt", "cameras.json", "elevation.tif", "label.tif", "label.tif.aux.xml", "labels", "map.nc",
    "objects.geojson", "objects_wgs84.geojson", "points.laz", "preview.png", "run.json",
}  # fmt: skip


@pytest.fixture(scope="module")
def site():
    return example_site()


@pytest.fixture
def quick(monkeypatch):
    """Without drawing the preview, which is tested by itself below."""
    monkeypatch.setattr(excavatwin.export.preview, "encode_preview", lambda site: b"png")


def snapshot(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_every_file_is_there_and_named(site, tmp_path):
    written = write_site(site, tmp_path / "new" / "site")
    folder = tmp_path / "new" / "site"
    assert {p.name for p in folder.iterdir()} == FILES
    assert sorted(written) == sorted(p for p in folder.rglob("*") if p.is_file())
    assert [p.name for p in folder.parent.iterdir()] == ["site"]
    run = json.loads((folder / "run.json").read_text())
    assert run["config"] == {"tau": 0.4, "voxel": {"size": None}}
    assert run["photos_unplaced"] == {"IMG_0099.JPG": "too few matches"}
    assert run["map"]["epsg"] == 32617
    assert sorted(run["files"]) == sorted(str(p.relative_to(folder)) for p in written)
    readme = (folder / "README.txt").read_text()
    assert all(name in readme for name in FILES if not name.endswith((".txt", ".xml")))
    assert "GPS track is nearly one line" in readme
    umask = os.umask(0)
    os.umask(umask)
    assert folder.stat().st_mode & 0o777 == 0o777 & ~umask


def test_a_local_site_has_no_wgs84_twin(tmp_path, quick):
    write_site(example_site(georeferenced=False), tmp_path / "site")
    assert {p.name for p in (tmp_path / "site").iterdir()} == FILES - {"objects_wgs84.geojson"}


def test_a_second_run_replaces_ours_and_keeps_yours(site, tmp_path, quick):
    folder = tmp_path / "site"
    write_site(site, folder)
    (folder / "my_project.qgz").write_text("mine")
    (folder / ".cache").mkdir()
    (folder / "elevation.tif.aux.xml").write_text("statistics of the old raster")
    (folder / "labels" / "IMG_OLD.png").write_text("of a photo that is gone")
    write_site(replace(site, views=site.views[:1], run={}), folder)
    assert {p.name for p in folder.iterdir()} == FILES | {"my_project.qgz", ".cache"}
    assert [p.name for p in (folder / "labels").iterdir()] == ["IMG_0000.png"]
    assert (folder / "my_project.qgz").read_text() == "mine"
    assert "config" not in json.loads((folder / "run.json").read_text())
    assert [p.name for p in tmp_path.iterdir()] == ["site"]


def test_an_empty_folder_and_a_link_are_fine(site, tmp_path, quick):
    (tmp_path / "real").mkdir()
    (tmp_path / "latest").symlink_to("real")
    write_site(site, tmp_path / "latest")
    assert (tmp_path / "latest").is_symlink()
    assert (tmp_path / "real" / "map.nc").is_file()


def test_somebody_elses_folder_is_refused(site, tmp_path, quick):
    (tmp_path / "thesis.tex").write_text("mine")
    with pytest.raises(OutputError, match=r"already holds something else \(thesis.tex, no run.json\)"):
        write_site(site, tmp_path)
    assert snapshot(tmp_path) == {"thesis.tex": b"mine"}
    with pytest.raises(OutputError, match="is a file, where a folder was to be written"):
        write_site(site, tmp_path / "thesis.tex")


@pytest.mark.parametrize(
    ("code", "message"),
    [
        (errno.ENOSPC, "the disk is full; free some space"),
        (errno.EROFS, "it is read-only for you"),
        (errno.EIO, "Input/output error"),
    ],
)
@pytest.mark.parametrize("earlier", [True, False])
def test_a_failing_disk_leaves_what_was_there(site, tmp_path, quick, monkeypatch, code, message, earlier):
    folder = tmp_path / "deep" / "site"
    if earlier:
        write_site(site, folder)
    before = snapshot(tmp_path)
    write = Path.write_bytes

    def failing(self: Path, content: bytes) -> int:
        if self.name == "points.laz":
            write(self, content[:100])
            raise OSError(code, os.strerror(code))
        return write(self, content)

    monkeypatch.setattr(Path, "write_bytes", failing)
    with pytest.raises(OutputError, match=message):
        write_site(replace(site, run={}), folder)
    assert snapshot(tmp_path) == before
    assert [p.name for p in tmp_path.iterdir()] == (["deep"] if earlier else [])


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError])
def test_an_interrupted_run_leaves_what_was_there(site, tmp_path, quick, monkeypatch, error):
    write_site(site, tmp_path / "site")
    before = snapshot(tmp_path)

    def interrupted(_):
        raise error

    monkeypatch.setattr(excavatwin.export.preview, "encode_preview", interrupted)
    with pytest.raises(error):
        write_site(site, tmp_path / "site")
    assert snapshot(tmp_path) == before
    assert [p.name for p in tmp_path.iterdir()] == ["site"]


def test_a_failing_swap_is_taken_back(site, tmp_path, quick, monkeypatch):
    write_site(site, tmp_path / "site")
    before = snapshot(tmp_path)
    rename = Path.rename

    def failing(self: Path, target: Path) -> Path:
        if Path(target).name == "site" and self.name.endswith(".part") and b"now" in (self / "run.json").read_bytes():
            raise OSError(errno.EIO, "Input/output error")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", failing)
    with pytest.raises(OutputError, match="Input/output error"):
        write_site(replace(site, run={"now": True}), tmp_path / "site")
    assert snapshot(tmp_path) == before


def test_a_place_that_cannot_be_written(site, tmp_path):
    if os.geteuid() == 0:  # root may write anywhere but where the kernel itself refuses
        if not Path("/proc/self").exists():
            pytest.skip("root, and no /proc to be refused by")
        target = Path("/proc/site")
    else:
        target = tmp_path / "site"
        tmp_path.chmod(0o555)
    with pytest.raises(OutputError, match="could not be written"):
        write_site(site, target)


def test_a_really_full_disk(tmp_path):
    """The kernel itself refuses the 5000th byte (a file size limit behaves like a full disk)."""
    pytest.importorskip("resource")
    script = """
import resource, sys
from pathlib import Path
from excavatwin.errors import OutputError
from excavatwin.scene.staging import whole_file
resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))
try:
    with whole_file(Path(sys.argv[1])) as file:
        file.write(bytes(10000))
except OutputError as error:
    sys.stdout.write(str(error))
"""
    (tmp_path / "a.npz").write_text("old")
    run = subprocess.run([sys.executable, "-c", script, tmp_path / "a.npz"], capture_output=True, text=True, check=True)
    assert "the disk is full" in run.stdout
    assert snapshot(tmp_path) == {"a.npz": b"old"}


def test_whole_file_refuses_a_folder(tmp_path):
    with pytest.raises(OutputError, match="is a folder"), whole_file(tmp_path):
        pass


def test_json_has_no_nan_and_takes_what_python_has():
    table = {"nan": np.nan, "array": np.array([1.5, np.inf]), "path": Path("a/b"), "n": np.int64(3), "set": {"b", "a"}}
    assert json.loads(to_json(table)) == {"nan": None, "array": [1.5, None], "path": "a/b", "n": 3, "set": ["a", "b"]}


def pixels(png: bytes) -> np.ndarray:
    import io

    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))


def test_preview_of_every_kind_of_site(site):
    local = example_site(georeferenced=False, metric=False)
    without_images = replace(site, views=tuple(replace(v, image=None) for v in site.views))
    upright = replace(
        site, views=(replace(site.views[0], label=site.views[0].label.T, image=site.views[0].image.swapaxes(0, 1)),)
    )
    empty = replace(
        site.map, elevation=np.full_like(site.map.elevation, np.nan), observed=np.zeros_like(site.map.observed)
    )
    for variant in (site, local, without_images, upright, replace(site, views=()), replace(site, map=empty)):
        picture = pixels(encode_preview(variant))
        assert picture.shape[1] == 1800
        assert 400 < picture.shape[0] < 2200
        assert len(np.unique(picture.astype(int) @ (65536, 256, 1))) > 100


def test_preview_shows_the_photo_with_most_in_it(site):
    blank = replace(site.views[0], label=np.full_like(site.views[0].label, 255))
    assert best_view(replace(site, views=(blank, site.views[1]))).name == "IMG_0001.JPG"
    assert best_view(replace(site, views=())) is None


def test_preview_has_every_class_of_the_map_in_its_colour(site):
    picture = pixels(encode_preview(site)).astype(int)
    for colour in ((245, 190, 0), (200, 40, 60)):  # swatch and map: excavator, obstacle
        assert (np.abs(picture - colour).max(-1) < 12).sum() > 1000


def test_hillshade_is_lit_from_the_north_west():
    x, y = np.meshgrid(np.arange(40.0), -np.arange(40.0))
    facing = hillshade((x - y).astype(np.float32), 1.0)  # falls towards the north-west
    averted = hillshade((y - x).astype(np.float32), 1.0)
    assert facing[20, 20] > 0.8 > averted[20, 20] + 0.5
    assert hillshade(np.full((3, 4), np.nan, np.float32), 1.0).shape == (3, 4)
