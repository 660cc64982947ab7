"""Recordings that are no simulation: labels in their own classes, scanner heights, measured objects."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from excavatwin.errors import InputError
from excavatwin.export import write_site
from excavatwin.scene.observations import Lattice
from excavatwin.scene.recording import Dataset, ElevationReference, Frame, KnownObject, Recording, Stored
from excavatwin.scene.site import MappedView, Site
from excavatwin.studies.dataset_evaluation import Place, evaluate_dataset
from excavatwin.studies.recorded_truth import frames_by_photo
from excavatwin.studies.site_evaluation import Scoring
from scored_site import a_map, a_truth, one_point

IDS = np.array([0, 31, 21, 18, 57, 38, *[0] * 249, 0], np.uint8)
"""Task class -> an id of goose-64 of that class: soil, sidewalk, moss, heavy machinery, building."""
CENTRES = ((-3.0, 2.0, 9.0), (3.0, 1.0, 10.0), (0.0, -3.0, 11.0))


def recorded(scale: float = 1.0) -> tuple[Recording, Site]:
    """Three photos over the small truth; the map is a perfect one but ``scale`` times too small."""
    truth = a_truth()
    frames, views = [], []
    for k, centre in enumerate(CENTRES):
        T = truth.views[0].T_M_cam.copy()
        T[:3, 3] = centre
        label = truth.views[0].label
        frames.append(
            Frame(
                name=f"{k:06d}",
                image=Stored(Path(f"{k:06d}.png"), lambda _: np.zeros((60, 80, 3), np.uint8)),
                size=(80, 60),
                K_cam=truth.views[0].K_cam,
                T_W_cam=T,
                label=Stored(Path("labels.png"), lambda _, ids=IDS[label]: ids),
            )
        )
        ours = T.copy()
        ours[:3, 3] /= scale
        K = truth.views[0].K_cam
        views.append(MappedView(f"clip_{k:06d}.jpg", label, K, ours, lattice=Lattice(80, 60, np.eye(2, 3), K)))
    box = truth.objects[0]
    small = replace(
        box,
        centre=tuple(v / scale for v in box.centre),
        size=tuple(v / scale for v in box.size),
        footprint=box.footprint / scale,
    )
    m = replace(a_map(truth), objects=(small,), georeference=None)
    T_W_object = np.eye(4)
    T_W_object[:3, 3] = box.centre
    known = KnownObject(1, "skip", (box.size[1], box.size[0], box.size[2]), T_W_object)
    height = np.where(np.isin(truth.label, (1, 2)), truth.height + np.float32(0.1), np.nan)
    reference = ElevationReference(truth.grid, height)
    recording = Recording(
        "scene",
        tuple(frames),
        vocabulary="goose-64",
        objects=(known,),
        elevation=Stored(Path("elevation.tif"), lambda _: reference),
    )
    return recording, Site(m, one_point(), tuple(views))


def dataset_of(*recordings: Recording) -> Dataset:
    by_name = {r.name: r for r in recordings}
    return Dataset("goose-ex", (Path("goose"),), tuple(by_name), by_name.__getitem__)


def figures(scores) -> dict:
    return {m.name: m for m in scores.summary}


def test_labels_heights_and_objects_of_a_recording_are_scored(tmp_path: Path) -> None:
    recording, site = recorded()
    write_site(site, tmp_path / "scene")
    other = replace(recording, name="unmapped")
    scores = evaluate_dataset(dataset_of(recording, other), tmp_path, Scoring())
    found = figures(scores)
    assert found["photo_miou"].value == pytest.approx(100)
    assert "'diggable'" in found["photo_miou"].meaning
    assert found["photo_miou"].paper == 38.03
    assert found["elevation_bias"].value == pytest.approx(-0.1, abs=1e-4)
    assert found["dimension_camera_baseline_mae"].value == pytest.approx(0, abs=1e-3)
    assert found["dimension_metric_backbone_objects"].value == 1
    assert any("1 recording (unmapped)" in note for note in scores.notes)
    strict = evaluate_dataset(dataset_of(recording), tmp_path, Scoring(policy="strict"))
    assert "'strict'" in figures(strict)["photo_miou"].meaning


def test_the_cameras_scale_what_the_map_measures_too_small(tmp_path: Path) -> None:
    recording, site = recorded(scale=2.0)
    write_site(replace(site, map=replace(site.map, metric=False)), tmp_path / "scene")
    scores = evaluate_dataset(dataset_of(recording), tmp_path, Scoring())
    found = figures(scores)
    assert "elevation_mae" not in found
    assert any("scene: its elevation is not scored: The map's unit is arbitrary" in note for note in scores.notes)
    assert found["dimension_camera_baseline_mae"].value == pytest.approx(0, abs=1e-3)
    assert np.isnan(found["dimension_metric_backbone_mae"].value)  # an arbitrary unit is no metric scale
    assert found["dimension_one_dimension_mae"].value == pytest.approx(0, abs=1e-3)


def test_what_is_missing_is_said_in_one_sentence(tmp_path: Path) -> None:
    recording, site = recorded()
    with pytest.raises(InputError, match=r"holds no SITE of goose-ex; .* -o .*scene"):
        evaluate_dataset(dataset_of(recording), tmp_path, Scoring())
    write_site(site, tmp_path / "scene")
    empty = replace(
        recording, elevation=None, objects=(), frames=tuple(replace(f, label=None) for f in recording.frames)
    )
    with pytest.raises(InputError, match="no labels, heights or measured objects"):
        evaluate_dataset(dataset_of(empty), tmp_path, Scoring())
    foreign = replace(recording, frames=tuple(replace(f, name=f"x{f.name}") for f in recording.frames[:0]))
    with pytest.raises(InputError, match="not made from photos of scene"):
        evaluate_dataset(dataset_of(foreign), tmp_path, Scoring())


def test_photos_find_their_frames() -> None:
    recording, _ = recorded()
    found = frames_by_photo(recording, ["000001.png", "000002.JPG", "clip_000000.jpg", "else_7.jpg"])
    assert {photo: frame.name for photo, frame in found.items()} == {
        "000001.png": "000001",
        "000002.JPG": "000002",
        "clip_000000.jpg": "000000",
    }
    assert Place.of("site_200/epoch_03") == Place("site_200", "epoch_03")
    assert Place.of("bike/batch-1/0") == Place("bike/batch-1/0", "")
