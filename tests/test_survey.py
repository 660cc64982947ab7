"""The cached pipeline: what is computed again, what is not, and what a stopped run leaves behind."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import textwrap
import time
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from PIL import Image

from excavatwin.backbones.cards import Card, Tried
from excavatwin.backbones.merging import Merging
from excavatwin.backbones.protocols import Picture, Segmentation
from excavatwin.errors import InputError, ObservationError, OutputError
from excavatwin.geometry.scale import Reference, Scale
from excavatwin.scene.elevation_map import LAYERS, ElevationMap
from excavatwin.scene.grid import Grid
from excavatwin.scene.observations import Georeference, Lattice, Observations, Unplaced, View
from excavatwin.scene.progress import silent
from excavatwin.scene.site import FusedPoints, Site
from excavatwin.survey import fingerprint, memory, records
from excavatwin.survey.cache import StageCache, cache_folder, opened
from excavatwin.survey.checks import check_target
from excavatwin.survey.pipeline import map_photos

CALLS: Counter[str] = Counter()


def small_view(name: str, shade: int = 7) -> View:
    H, W = 6, 8
    return View(
        name=name,
        points=np.full((H, W, 3), shade, np.float32),
        confidence=np.ones((H, W), np.float32),
        evidence=np.zeros((H, W, 5), np.float32),
        T_R_cam=np.eye(4),
        K_cam=np.eye(3),
        image=np.full((H, W, 3), shade, np.uint8),
        lattice=Lattice(80, 60, np.eye(2, 3), np.eye(3), (0.1, 0.0, 0.0, 0.2)),
    )


@dataclass(frozen=True)
class FakePhotogrammetry:
    card: ClassVar[Card] = Card("fake-poses", "reconstructor", "two steps", Tried.BUILT_IN)
    features: int = 100
    lattice: int = 8

    @property
    def placing(self) -> Any:
        return self.features

    def identity(self) -> str:
        return "1"

    def place(self, photos: Any, progress: Any) -> list[str]:
        CALLS["place"] += 1
        return [photo.name for photo in photos]

    def save_placement(self, placement: list[str], folder: Path) -> None:
        (folder / "placement.json").write_text(json.dumps(placement))

    def load_placement(self, folder: Path) -> list[str]:
        return list(json.loads((folder / "placement.json").read_text()))

    def densify(self, placement: list[str], photos: Any, progress: Any) -> Observations:
        CALLS["densify"] += 1
        views = tuple(small_view(name, shade) for shade, name in enumerate(placement[:-1]))
        return Observations(views, unplaced=(Unplaced(placement[-1], "lies apart"),), doubts=("a doubt.",))


@dataclass(frozen=True)
class FakeAppearance:
    card: ClassVar[Card] = Card("fake-classes", "segmenter", "one row of sky", Tried.BUILT_IN)
    floor: float = 0.1
    fail_after: int = 10**6

    def identity(self) -> str:
        return "1"

    def __call__(self, picture: Picture) -> Segmentation:
        if CALLS["segment"] >= self.fail_after:
            raise KeyboardInterrupt
        CALLS["segment"] += 1
        image = picture.image
        sky = np.zeros(image.shape[:2], bool)
        sky[0] = True
        return Segmentation(np.full((*image.shape[:2], 5), self.floor, np.float32), sky)


@dataclass(frozen=True)
class FakeMapper:
    tau: float = 0.4
    scale: Scale = field(default_factory=Scale)

    def __call__(self, obs: Observations, progress: Any = silent) -> Site:
        CALLS["fuse"] += 1
        grid = Grid(0.0, 2.0, 1.0, 2, 2)
        layers: dict[str, Any] = {layer.name: np.full(grid.shape, layer.fill, layer.dtype) for layer in LAYERS}
        none = np.zeros((0, 3), np.float32)
        empty = np.zeros(0, np.uint8)
        points = FusedPoints(none, empty, np.zeros(0, np.float32), none.astype(np.uint8), empty.astype(np.int32), empty)
        return Site(ElevationMap(grid, **layers), points, (), obs.unplaced, {"seen": obs})


@dataclass(frozen=True)
class FakePlan:
    video: int = 0
    reconstructor: Any = field(default_factory=FakePhotogrammetry)
    segmenters: Any = field(default_factory=lambda: {"fake": FakeAppearance()})
    merging: Merging = field(default_factory=Merging)
    mapper: FakeMapper = field(default_factory=FakeMapper)


@pytest.fixture
def photos(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    CALLS.clear()
    folder = tmp_path / "photos"
    folder.mkdir()
    for index in range(4):
        Image.new("RGB", (80, 60), (index * 20, 90, 30)).save(folder / f"IMG_{index}.jpg")

    def write(site: Site, target: Path) -> list[Path]:
        target.mkdir(exist_ok=True)
        (target / "run.json").write_text(json.dumps({k: v for k, v in site.run.items() if k != "seen"}))
        return [target / "run.json"]

    monkeypatch.setattr("excavatwin.export.write_site", write, raising=False)
    return folder


def run(photos: Path, plan: FakePlan | None = None, **options: Any) -> Site:
    options = {"force": True} | options  # what the fakes deliver would not pass the validator
    return map_photos(photos, photos.parent / "site", plan=plan or FakePlan(), **options)  # type: ignore[arg-type]


def test_second_run_with_another_fusion_parameter_only_fuses(photos: Path) -> None:
    run(photos)
    assert CALLS == {"place": 1, "densify": 1, "segment": 3, "fuse": 1}
    site = run(photos, FakePlan(mapper=FakeMapper(tau=0.6)))
    assert CALLS == {"place": 1, "densify": 1, "segment": 3, "fuse": 2}
    assert site.run["stages"]["densify"]["cached"] is True
    assert site.run["stages"]["segment"]["cached"] == 3


def test_cached_result_equals_the_first_one(photos: Path) -> None:
    first, second = (run(photos).run["seen"] for _ in range(2))
    for a, b in zip(first.views, second.views, strict=True):
        np.testing.assert_array_equal(a.points, b.points)
        np.testing.assert_array_equal(a.evidence, b.evidence)
        np.testing.assert_array_equal(a.lattice.affine, b.lattice.affine)
        assert a.lattice.distortion == b.lattice.distortion
    assert (first.unplaced, first.doubts) == (second.unplaced, second.doubts)


@pytest.mark.parametrize(
    ("change", "again"),
    [
        ({"reconstructor": FakePhotogrammetry(features=50)}, {"place": 1, "densify": 1}),
        ({"reconstructor": FakePhotogrammetry(lattice=4)}, {"densify": 1}),
        ({"segmenters": {"fake": FakeAppearance(floor=0.2)}}, {"segment": 3}),
        ({}, {}),
    ],
)
def test_a_parameter_repeats_its_stage_and_those_after_it(photos: Path, change: Any, again: Any) -> None:
    run(photos)
    CALLS.clear()
    run(photos, FakePlan(**change))
    assert dict(CALLS) == {**again, "fuse": 1}
    CALLS.clear()
    run(photos)  # the entry before is kept: going back is free
    assert CALLS == {"fuse": 1}


def test_what_a_backbone_delivers_is_validated_before_it_is_fused(photos: Path) -> None:
    with pytest.raises(ObservationError, match="--force"):
        run(photos, force=False)
    assert not CALLS["segment"]
    assert run(photos).run["stages"]["validate"]["findings"] > 0


def test_changed_photo_is_noticed(photos: Path) -> None:
    run(photos)
    Image.new("RGB", (80, 60), (255, 0, 0)).save(photos / "IMG_2.jpg")
    run(photos)
    assert CALLS["place"] == 2


def test_interrupted_segmentation_resumes_per_photo(photos: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        run(photos, FakePlan(segmenters={"fake": FakeAppearance(fail_after=2)}))
    # fail_after is a parameter, so give it back unchanged in spirit: the same plan, no longer failing
    CALLS["segment"] = -100
    run(photos, FakePlan(segmenters={"fake": FakeAppearance(fail_after=2)}))
    assert CALLS["segment"] == -99
    assert CALLS["densify"] == 1


@pytest.mark.parametrize("damage", ["truncate", "overwrite", "remove"])
def test_corrupt_entry_is_computed_again_with_a_note(photos: Path, damage: str) -> None:
    run(photos)
    for file in cache_folder(photos.parent / "site").glob("densify/*/0000.npz"):
        if damage == "truncate":
            file.write_bytes(file.read_bytes()[:300])
        elif damage == "overwrite":
            content = bytearray(file.read_bytes())
            content[200:210] = b"xxxxxxxxxx"
            file.write_bytes(bytes(content))
        else:
            file.unlink()
    site = run(photos)
    assert CALLS["densify"] == 2
    assert CALLS["place"] == 1
    assert any("densify" in warning for warning in site.run["warnings"])


def test_fresh_forgets_everything(photos: Path) -> None:
    run(photos)
    run(photos, fresh=True)
    assert CALLS == {"place": 2, "densify": 2, "segment": 6, "fuse": 2}


def test_sky_has_no_points(photos: Path) -> None:
    view = run(photos).run["seen"].views[0]
    assert np.isnan(view.points[0]).all()
    assert (view.confidence[0] == 0).all()
    assert np.isfinite(view.points[1:]).all()


def test_run_record_names_versions_config_inputs_times_and_doubts(photos: Path) -> None:
    (photos / "IMG_9.jpg").write_bytes(b"not a photo")
    run(photos)
    record = json.loads((photos.parent / "site" / "run.json").read_text())
    assert record["versions"]["excavatwin"]
    assert record["config"]["mapper"]["tau"] == 0.4
    assert len(record["input"]["files"]["IMG_0.jpg"]) == 32
    assert {"capture", "place", "densify", "segment", "fuse"} <= set(record["stages"])
    assert record["peak_memory_bytes"] > 1e6
    assert "a doubt." in record["warnings"]
    assert record["photos"]["found"] == 5
    assert {row["name"] for row in record["photos"]["unplaced"]} == {"IMG_3.jpg", "IMG_9.jpg"}


def test_reference_is_checked_before_anything_is_computed(photos: Path) -> None:
    for reference, words in (
        (Reference("IMG_1.jpeg", (1.0, 1.0), (2.0, 2.0), 3.0), "did you mean 'IMG_1.jpg'"),
        (Reference("IMG_1.jpg", (1.0, 1.0), (90.0, 2.0), 3.0), "outside"),
    ):
        with pytest.raises(InputError, match=words):
            run(photos, references=[reference])
    assert not CALLS["place"]
    run(photos, references=[Reference("IMG_1.jpg", (1.0, 1.0), (20.0, 2.0), 3.0)])


def test_foreign_folder_is_not_replaced(photos: Path) -> None:
    target = photos.parent / "site"
    target.mkdir()
    (target / "thesis.docx").write_text("do not lose me")
    with pytest.raises(InputError, match="other files"):
        run(photos)
    assert (target / "thesis.docx").exists()
    assert not CALLS
    with pytest.raises(InputError, match="is a file"):
        check_target(target / "thesis.docx")


def test_second_run_at_the_same_time_is_refused(photos: Path) -> None:
    with opened(cache_folder(photos.parent / "site")), pytest.raises(InputError, match="another run"):
        run(photos)


def test_full_disk_leaves_no_half_entry(tmp_path: Path) -> None:
    cache = StageCache(tmp_path / "cache")

    def write(part: Path) -> None:
        (part / "a").write_text("half")
        raise OSError(28, "No space left on device")

    with pytest.raises(OutputError, match="disk is full"):
        cache.store("place", "k", write)
    assert not [p for p in cache.root.rglob("*") if p.is_file()]


def test_killed_run_leaves_no_entry_and_is_swept(tmp_path: Path) -> None:
    root = tmp_path / ".site.cache"
    script = f"""
        import time
        from pathlib import Path
        from excavatwin.survey.cache import opened
        def write(part):
            (part / "a").write_text("half")
            print("writing", flush=True)
            time.sleep(60)
        with opened(Path({str(root)!r})) as cache:
            cache.store("place", "k", write)
    """
    with subprocess.Popen([sys.executable, "-c", textwrap.dedent(script)], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        process.send_signal(signal.SIGKILL)
        process.wait()
    time.sleep(0.05)
    assert list(root.rglob("*.part"))
    with opened(root) as cache:
        assert not list(root.rglob("*.part"))
        assert cache.load("place", "k", lambda entry: "found") is None


def test_observations_survive_the_cache(tmp_path: Path) -> None:
    view = replace(small_view("a"), evidence=np.random.default_rng(1).random((6, 8, 5), np.float32), lattice=None)
    obs = Observations(
        (view, replace(view, name="b", image=None)),
        up=np.array([0.0, 0.6, 0.8]),
        metres_per_unit=2.5,
        georeference=Georeference(32633, (500000.25, 5e6, 120.0), 0.4),
        source={"reconstructor": "x"},
    )
    records.write_observations(obs, tmp_path)
    back = records.read_observations(tmp_path)
    np.testing.assert_array_equal(back.views[0].evidence, view.evidence)
    assert back.views[1].image is None
    assert back.views[0].lattice is None
    np.testing.assert_array_equal(back.up, obs.up)
    assert (back.georeference, back.metres_per_unit, back.source) == (obs.georeference, 2.5, obs.source)


def test_views_on_disk_stay_on_disk_and_keep_their_names(tmp_path: Path) -> None:
    view = small_view("a.jpg")
    names = ("points", "confidence", "image")
    for name in names:
        np.save(tmp_path / f"{name}.npy", getattr(view, name))
    layers = {name: np.load(tmp_path / f"{name}.npy", mmap_mode="r") for name in names}
    mapped = replace(view, **layers)
    plain = replace(view, name="b.jpg", image=None)
    records.write_observations(Observations((mapped, plain, replace(mapped, name="c.jpg"))), tmp_path)
    back = records.read_observations(tmp_path).views
    assert [one.name for one in back] == ["a.jpg", "b.jpg", "c.jpg"]
    for one in (back[0], back[2]):
        assert isinstance(one.points, np.memmap)
        for name in names:
            np.testing.assert_array_equal(getattr(one, name), getattr(view, name))
    assert back[1].image is None
    np.testing.assert_array_equal(back[1].points, view.points)
    (tmp_path / "points.bin").write_bytes((tmp_path / "points.bin").read_bytes()[:-4])
    with pytest.raises(ValueError, match=r"reshape|were written"):
        records.read_observations(tmp_path)


def test_a_segmenter_that_sees_nothing_is_named(photos: Path) -> None:
    assert any(
        "gave no evidence" in w for w in run(photos, FakePlan(segmenters={"f": FakeAppearance(0.0)})).run["warnings"]
    )
    assert not any("gave no evidence" in w for w in run(photos).run["warnings"])


def test_memory_is_estimated_before_it_runs_out(photos: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need = memory.estimate(4, 8, 0.75)
    monkeypatch.setattr(memory, "available", lambda: need * 0.8)
    assert any("memory" in warning for warning in run(photos).run["warnings"])
    monkeypatch.setattr(memory, "available", lambda: need * 0.5)
    CALLS.clear()
    with pytest.raises(InputError, match="fewer photos"):
        run(photos)
    assert not CALLS
    assert memory.estimate(75, 640) > memory.estimate(23, 640) > memory.estimate(23, 320)


def test_only_photos_that_are_used_need_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    from excavatwin.backbones.reconstructors.vggt import Vggt
    from excavatwin.backbones.sequence.selection import Selection

    monkeypatch.setattr(memory, "available", lambda: memory.estimate(50, 518))
    assert memory.check(Vggt(selection=Selection(most=50)), 5000, 0.75) == ()
    with pytest.raises(InputError, match=r"--vggt\.selection\.most\), or use a smaller lattice \(--vggt\.lattice"):
        memory.check(Vggt(), 5000, 0.75)


def test_fingerprints_tell_stages_values_and_twins_apart() -> None:
    keys = {
        fingerprint.key(FakeMapper()),
        fingerprint.key(FakeMapper(tau=0.5)),
        fingerprint.key(FakePhotogrammetry()),
        fingerprint.key(FakePhotogrammetry(), "more"),
    }
    assert len(keys) == 4
    assert fingerprint.key({"b": 1, "a": 2}) == fingerprint.key({"a": 2, "b": 1})
    a = np.zeros((2, 3), np.uint8)
    assert fingerprint.of_array(a) != fingerprint.of_array(a.reshape(3, 2))
    assert fingerprint.of_code("excavatwin.survey") != fingerprint.of_code("excavatwin.capture")


def test_code_of_a_plugin_counts_and_nothing_that_lies_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "lone_plugin.py").write_text("a = 1")
    first = fingerprint.of_code("lone_plugin")
    (tmp_path / "something_else.py").write_text("b = 1")
    assert fingerprint.of_code("lone_plugin") == first
    (tmp_path / "lone_plugin.py").write_text("a = 2")
    assert fingerprint.of_code("lone_plugin") != first
    assert fingerprint.of_code("__main__") is not None
