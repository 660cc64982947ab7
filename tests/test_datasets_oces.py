"""The OCES-like layout: a hand-written one, a damaged one, and what the simulator really writes."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

import oces_example
from excavatwin.datasets import examine, open_dataset, task_labels
from excavatwin.errors import InputError
from excavatwin.scene.frames import invert_rigid
from excavatwin.scene.taxonomy import TaskClass


@pytest.fixture
def root(tmp_path):
    return oces_example.write(tmp_path / "yard")


def change(path, **keys) -> None:
    table = json.loads(path.read_text())
    table.update(keys)
    path.write_text(json.dumps(table))


def test_an_epoch_brings_all_of_its_truth(root) -> None:
    dataset = open_dataset(root)
    assert (dataset.name, dataset.names) == ("oces", ("site_007/epoch_00", "site_007/epoch_01"))
    assert dataset.counts == {"sequences": 1, "epochs": 2, "frames": 6, "changes": 1}
    assert dataset.categories == ("excavator", "truck")
    assert dataset.excluded == dataset.missing == ()
    assert "lies 0.0 cm from elevation.tif" in dataset.checks[1]
    moved = dataset.changes[0]
    assert (moved.before, moved.after) == dataset.names
    assert (moved.cut, moved.fill, moved.net) == (4.0, 5.0, 1.0)
    recording = dataset.recording("site_007/epoch_01")
    assert recording.time - dataset.recording("site_007/epoch_00").time == 3600
    assert recording.truth == root / "site_007/epoch_01/truth.npz"
    assert recording.photos == root / "site_007/epoch_01/images"
    assert recording.georeference.origin == oces_example.ORIGIN
    assert examine(dataset, everything=True).problems == ()


def test_world_points_come_from_depth_and_camera(root) -> None:
    frame = open_dataset(root).recording("site_007/epoch_00").frames[0]
    points, label = frame.world_points(), frame.label()
    np.testing.assert_allclose(points[label == 1][:, 2], 0.4, atol=1e-5)
    np.testing.assert_allclose(points[label == 4][:, 2], 2.4, atol=1e-5)
    assert np.isnan(points[label == 255]).all()
    row, col = 20, 30
    x = (col + 0.5 - 20) / 30 * 11.6 - 1
    y = 0.5 - (row + 0.5 - 15) / 30 * 11.6
    np.testing.assert_allclose(points[row, col, :2], (x, y), atol=1e-5)
    assert set(np.unique(frame.instance())) == {0, 300}  # 16 bits


def test_heights_lose_the_origin_and_the_marks_of_nothing(root) -> None:
    reference = open_dataset(root).recording("site_007/epoch_00").elevation()
    assert (reference.grid.west, reference.grid.north, reference.grid.shape) == (-10, 8, (40, 50))
    assert np.isnan(reference.height[0, 0])
    np.testing.assert_allclose(reference.height[1:], 0.4, atol=1e-4)


def test_objects_have_dimensions_and_a_pose(root) -> None:
    known = open_dataset(root).recording("site_007/epoch_00").objects[0]
    assert (known.object_id, known.category, known.task_class) == (300, "excavator", TaskClass.EXCAVATOR)
    assert known.size == (4.0, 1.5, 2.0)
    np.testing.assert_allclose(known.T_W_object[:2, 0], (np.cos(np.pi / 6), np.sin(np.pi / 6)))
    np.testing.assert_allclose(known.T_W_object[:3, 3], (0.5, 0.5, 1.4))
    assert (known.z_base, known.z_top) == (0.4, 2.4)


def test_labels_are_task_classes_already(root) -> None:
    recording = open_dataset(root).recording("site_007/epoch_00")
    labels = task_labels(recording, recording.frames[0])
    np.testing.assert_array_equal(labels, recording.frames[0].label())
    with pytest.raises(InputError, match="no policy 'strict'; it has: identity"):
        task_labels(recording, recording.frames[0], "strict")


def test_poses_in_the_wrong_direction_are_refused(root) -> None:
    for file in root.rglob("cameras.json"):
        table = json.loads(file.read_text())
        for frame in table["frames"]:
            T = invert_rigid(np.array(frame["T_map_cam"]))
            T[2, 3] += 5
            frame["T_map_cam"] = T.tolist()
        file.write_text(json.dumps(table))
    with pytest.raises(
        InputError, match=r"terrain seen in 000001.jpg lies .* elevation.tif; cameras \(camera-to-map\)"
    ):
        open_dataset(root)


def test_unfinished_epochs_and_sequences_are_left_out_and_named(root) -> None:
    change(root / "dataset.json", sequences=["site_007", "site_008"])
    (root / "site_007/epoch_01/cameras.json").unlink()
    dataset = open_dataset(root)
    assert dataset.names == ("site_007/epoch_00",)
    assert {item.what: item.reason for item in dataset.excluded} == {
        "site_007/epoch_01": "lacks cameras.json",
        "site_008": "has no sequence.json: it was not finished or not copied",
    }


def test_absent_truth_of_photos_is_counted(root) -> None:
    (root / "site_007/epoch_00/depth/000002.tif").unlink()
    (root / "site_007/epoch_01/labels/000002.png").unlink()
    dataset = open_dataset(root)
    assert "not there: 1 of labels, 1 of depth" in dataset.checks[0]
    assert dataset.recording("site_007/epoch_00").frames[2].depth is None


def test_what_is_broken_is_refused_with_its_name(root) -> None:
    change(root / "dataset.json", version=2)
    with pytest.raises(InputError, match="is of version 2; this reader knows version 1"):
        open_dataset(root)
    change(root / "dataset.json", version=1)
    file = root / "site_007/epoch_00/cameras.json"
    whole = file.read_text()
    file.write_text(whole.replace('"T_map_cam"', '"pose"'))
    with pytest.raises(InputError, match=r"cameras.json lacks 'T_map_cam'; see docs/oces-layout.md"):
        open_dataset(root)
    file.write_text(whole[:-5])
    with pytest.raises(InputError, match="cannot be read as JSON"):
        open_dataset(root)
    file.write_text(whole)
    shutil.rmtree(root / "site_007")
    with pytest.raises(InputError, match="none of the epochs"):
        open_dataset(root)


@pytest.mark.slow
def test_what_the_simulator_writes_is_read_with_everything(tmp_path) -> None:
    from excavatwin.evaluation import load_truth
    from excavatwin.simulation.recording import Shoot, record_dataset

    record_dataset(tmp_path / "oces", [(100, Shoot(views=2, width=128))])
    dataset = open_dataset(tmp_path / "oces")
    assert examine(dataset, everything=True).problems == ()
    recording = dataset.recording("site_100/epoch_00")
    truth = load_truth(recording.truth)
    assert [known.object_id for known in recording.objects] == [o.object_id for o in truth.objects]
    cloud = recording.scans[0].cloud()
    index = truth.grid.flat_index(cloud.xyz[cloud.ground, :2].astype(float))
    miss = cloud.xyz[cloud.ground, 2] - truth.height.ravel()[index]
    assert abs(np.median(miss[index >= 0])) < 0.02
    assert set(np.unique(cloud.label)) <= {1, 2, 3, 4, 5}
    frame = recording.frames[0]
    points, label = frame.world_points(), frame.label()
    index = truth.grid.flat_index(np.nan_to_num(points.reshape(-1, 3), nan=1e6)[:, :2])
    seen = (index >= 0) & np.isin(label.ravel(), (1, 2))
    assert np.median(np.abs(points.reshape(-1, 3)[seen, 2] - truth.height.ravel()[index[seen]])) < 0.02
