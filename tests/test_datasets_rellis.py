"""RELLIS-3D as it unpacks: merged archives, pairs by time, the direction of the calibration, the elevation protocol."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import rellis_example
from excavatwin.datasets import (
    ElevationProtocol,
    elevation_windows,
    examine,
    official_table,
    open_dataset,
    task_labels,
)
from excavatwin.datasets.label_agreement import label_agreement
from excavatwin.datasets.rellis_elevation import ground_ids
from excavatwin.errors import InputError
from excavatwin.scene.frames import invert_rigid, project, transform


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory):
    return rellis_example.write(tmp_path_factory.mktemp("rellis"))


@pytest.fixture(scope="module")
def rellis(unpacked):
    return open_dataset(unpacked)


def test_archives_unpacked_side_by_side_are_one_data_set(rellis, unpacked) -> None:
    assert (rellis.name, rellis.names, rellis.vocabulary) == ("rellis-3d", ("00000",), "rellis-3d")
    assert len(rellis.folders) == 4
    assert rellis.counts["frames"] == rellis.counts["labelled frames"] == rellis.counts["frames with pose"] == 3
    assert rellis.counts["scans"] == rellis.counts["labelled scans"] == 6
    assert rellis.splits == {"train": 1, "val": 1, "test": 0}  # a labelled photo may be in no split
    assert "sequence 00004" in rellis.missing
    assert not any(text.startswith("00000") for text in rellis.missing)
    parts = open_dataset([unpacked / "Rellis_3D_pylon_camera_node", unpacked / "Rellis_3D_calibration"])
    assert parts.counts["frames"] == 3
    assert parts.counts["scans"] == 0
    assert "not tested" in parts.checks[0]


def test_photos_and_scans_are_paired_by_time_not_by_number(rellis) -> None:
    recording = rellis.recording("00000")
    assert {frame.name[:11]: frame.scan for frame in recording.frames} == {
        "frame000000": "000001",
        "frame000001": "000003",
        "frame000002": "000005",
    }
    assert recording.doubts == ()


def test_rows_without_return_are_dropped_with_their_labels(rellis, unpacked) -> None:
    file = next(unpacked.rglob("000002.bin"))
    rows = np.fromfile(file, "<f4").reshape(-1, 4)
    labels = np.fromfile(next(unpacked.rglob("000002.label")), "<u4")
    seen = np.abs(rows[:, :3]).sum(1) > 0
    cloud = rellis.recording("00000").scan("000002").cloud()
    assert 0.3 < seen.mean() < 0.7
    np.testing.assert_array_equal(cloud.xyz, rows[seen, :3])
    np.testing.assert_array_equal(cloud.label, labels[seen])


def test_the_calibration_is_tested_and_the_camera_looks_along_minus_x(rellis) -> None:
    assert "labelled returns agree" in rellis.checks[0]
    frame = rellis.recording("00000").frames[0]
    forward, right, up = frame.T_L_cam[:3, 2], frame.T_L_cam[:3, 0], -frame.T_L_cam[:3, 1]
    assert forward @ (-1, 0, 0) > 0.99
    assert right @ (0, 1, 0) > 0.99
    assert up @ (0, 0, 1) > 0.99
    scan = rellis.recording("00000").scan(frame.scan)
    agreement = label_agreement(scan.cloud(), frame.label(), frame.K_cam, frame.distortion, frame.T_L_cam)
    assert agreement.share > 0.95
    assert agreement.landed > 100
    inverse = invert_rigid(frame.T_L_cam)
    assert label_agreement(scan.cloud(), frame.label(), frame.K_cam, frame.distortion, inverse).share < 0.05


def test_poses_place_photos_in_the_world_of_the_scans(rellis) -> None:
    """Returns of a scan, in the world, fall on pixels of their class in *another* photo."""
    recording = rellis.recording("00000")
    for frame, k in zip(recording.frames[:2], (1, 3), strict=True):  # between two scans; the last one is after all
        true = rellis_example.pose(k + rellis_example.LATER) @ rellis_example.camera_pose()
        np.testing.assert_allclose(frame.T_W_cam, true, atol=1e-4)  # of the quaternion's length
    last = rellis_example.pose(5) @ rellis_example.camera_pose()
    np.testing.assert_allclose(recording.frames[2].T_W_cam, last, atol=1e-4)
    scan, frame = recording.scan("000002"), recording.frames[2]
    cloud = scan.cloud()
    world = transform(scan.T_W_L, cloud.xyz.astype(float))
    uv, depth = project(frame.K_cam, frame.T_W_cam, world)
    label = frame.label()
    inside = (depth > 5) & (np.abs(uv - [120, 75]) < [70, 50]).all(1)  # where the lens hardly distorts
    seen = label[uv[inside, 1].astype(int), uv[inside, 0].astype(int)]
    assert inside.sum() > 100
    assert (seen == cloud.label[inside]).mean() > 0.9


@pytest.mark.parametrize("stamped", [True, False])
def test_a_calibration_in_the_wrong_direction_is_refused(tmp_path, stamped) -> None:
    rellis_example.write(tmp_path, photos={1: 1, 3: 3}, stamped=stamped, inverted=True)
    with pytest.raises(
        InputError, match=r" [0-5]% of the labelled returns .* expected at least 50%.*the other direction"
    ):
        open_dataset(tmp_path)


def test_labels_of_another_scan_are_refused(tmp_path) -> None:
    rellis_example.write(tmp_path)
    for file in tmp_path.rglob("*.label"):
        file.write_bytes(np.random.default_rng(1).permutation(np.fromfile(file, "<u4")).tobytes())
        file.write_bytes(np.where(np.fromfile(file, "<u4") == 1, 3, 1).astype("<u4").tobytes())
    with pytest.raises(InputError, match="scans and labels of one release"):
        open_dataset(tmp_path)


def test_without_times_pairs_by_number_must_prove_themselves(tmp_path) -> None:
    right = open_dataset(rellis_example.write(tmp_path / "a", photos={1: 1, 3: 3}, stamped=False)).recording("00000")
    assert [frame.scan for frame in right.frames] == ["000001", "000003"]
    assert "carry no time" in right.doubts[0]
    # Photos of other places under the numbers 0 and 5: right for one pair, wrong for the rest.
    folder = rellis_example.write(tmp_path / "b", photos={0: 0, 5: 5, 4: 4}, stamped=False)
    other = np.arange(256, dtype=np.uint8)
    other[[1, 3, 4]] = 3, 4, 1
    for file in folder.rglob("frame00000[45]*.png"):
        Image.fromarray(other[np.array(Image.open(file))]).save(file)
    wrong = open_dataset(folder).recording("00000")
    assert [frame.scan for frame in wrong.frames] == [None] * 3
    assert all(frame.T_W_cam is None for frame in wrong.frames)
    assert "do not fit the scans of their number" in wrong.doubts[-1]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("transforms.yaml", "vel2os1:\n  q:\n    w: 1\n", "lacks os1_cloud_node-pylon_camera_node"),
        (
            "transforms.yaml",
            "os1_cloud_node-pylon_camera_node:\n  q:\n    w: 1\n    x: 1\n    y: 0\n    z: 0\n"
            "  t:\n    x: 0\n    y: 0\n    z: 0\n",
            "not of unit length",
        ),
        ("camera_info.txt", "2813 2808 969\n", "row 0 has 3 numbers; expected 4"),
        ("camera_info.txt", "2813 -2808 969 624\n", "four positive numbers"),
        ("poses.txt", "1 0 0 0 0 1 0 0 0 0 1\n", "row 0 has 11 numbers; expected 12"),
        ("poses.txt", "1 0 0 x 0 1 0 0 0 0 1 0\n", "cannot be read as rows of numbers"),
    ],
)
def test_damaged_calibration_is_refused(tmp_path, name, text, message) -> None:
    rellis_example.write(tmp_path)
    next(tmp_path.rglob(name)).write_text(text)
    with pytest.raises(InputError, match=message):
        open_dataset(tmp_path)


def test_damaged_scans_are_found_by_reading(tmp_path) -> None:
    rellis_example.write(tmp_path)
    scan = next(tmp_path.rglob("000000.bin"))
    scan.write_bytes(scan.read_bytes()[:-16])
    label = next(tmp_path.rglob("000005.label"))
    label.write_bytes(np.full(32 * 512, 40, "<u4").tobytes())
    photo = next(tmp_path.rglob("frame000000*.png"))
    photo.write_bytes(photo.read_bytes()[:50])
    found = examine(open_dataset(tmp_path), everything=True)
    assert len(found.problems) == 3
    assert any("16384 labels for the 16383 rows" in problem for problem in found.problems)
    assert any("class id 40, but ids end at 34" in problem for problem in found.problems)
    assert any("cannot be decoded" in problem for problem in found.problems)


def test_elevation_by_the_protocol_is_the_ground(rellis) -> None:
    recording = rellis.recording("00000")
    frame = elevation_windows(recording, 2)[0]
    protocol = ElevationProtocol(half_window=1.0, cell=0.5, reach=20.0)
    reference = protocol(recording, frame)
    x, y = np.meshgrid(reference.grid.x, reference.grid.y)
    error = reference.height - rellis_example.ground_height(x)
    known = np.isfinite(error)
    assert known.sum() > 200
    assert (reference.returns[known] >= 3).all()
    assert np.abs(error[known & (y > 1)]).max() < 0.03  # dirt: within half a cell of the slope
    blades = error[known & (y < -1)]
    assert -0.03 < np.median(blades) < 0.06  # grass blades are up to 0.15 m high; a low quantile stays near their foot
    assert not np.isfinite(reference.height[x < -24.5]).any()  # trees are no ground
    shorter = ElevationProtocol(half_window=0.0, cell=0.5, reach=20.0)
    with pytest.raises(InputError, match="no labelled scan with a pose within 0 s"):
        shorter(recording, frame)


def test_ground_of_the_elevation_protocol_under_both_policies() -> None:
    assert set(ground_ids("diggable")) == {1, 3, 10, 23, 33, 34}  # dirt, grass, asphalt, concrete, mud, rubble
    assert set(ground_ids("strict")) == {1, 3, 10, 23, 33}
    with pytest.raises(InputError, match=r"ElevationProtocol.cell is 0; expected more than 0"):
        ElevationProtocol(cell=0)


def test_labels_become_task_classes_under_a_policy(rellis) -> None:
    recording = rellis.recording("00000")
    frame = recording.frames[0]
    raw, diggable, strict = frame.label(), task_labels(recording, frame), task_labels(recording, frame, "strict")
    assert set(np.unique(diggable[raw == rellis_example.GRASS])) == {3}
    assert set(np.unique(strict[raw == rellis_example.GRASS])) == {2}
    assert set(np.unique(strict[raw == rellis_example.DIRT])) == {1}
    assert set(np.unique(strict[raw == rellis_example.SKY])) == {255}


def test_a_world_that_leans_is_doubted(tmp_path) -> None:
    rellis_example.write(tmp_path)
    path = next(tmp_path.rglob("poses.txt"))
    turned = (
        np.loadtxt(path).reshape(-1, 3, 4)[:, [0, 2, 1]] * np.array([1, -1, 1])[:, None]
    )  # y up, as cameras have it
    np.savetxt(path, turned.reshape(-1, 12))
    doubts = open_dataset(tmp_path).recording("00000").doubts
    assert any("leans by 90 degrees" in doubt for doubt in doubts)


def test_ids_that_stand_for_others_are_replaced(tmp_path) -> None:
    rellis_example.write(tmp_path)
    image, scan = next(tmp_path.rglob("frame000000*.png")), next(tmp_path.rglob("000001.label"))
    ids, told = np.array(Image.open(image)), np.fromfile(scan, "<u4")
    Image.fromarray(np.where(ids == 3, 29, ids).astype(np.uint8)).save(image)
    np.where(told == 3, 30, told).astype("<u4").tofile(scan)
    dataset = open_dataset(tmp_path)
    recording = dataset.recording("00000")
    np.testing.assert_array_equal(recording.frames[0].label(), ids)
    assert set(np.unique(recording.scan("000001").cloud().label)) <= {1, 3, 4}
    assert examine(dataset, everything=True).problems == ()


def test_the_official_evaluation_has_18_classes_and_no_dirt() -> None:
    """The table that the authors' benchmark code applies, as its ids are printed there."""
    table = official_table()
    official = {
        0: 0, 1: 0, 3: 1, 4: 2, 5: 3, 6: 4, 7: 5, 8: 6, 9: 7, 10: 8, 12: 9, 15: 10, 17: 11, 18: 12, 19: 13, 23: 14,
        27: 15, 29: 1, 30: 1, 31: 16, 32: 4, 33: 17, 34: 18,
    }  # fmt: skip
    assert {i: int(k) for i, k in enumerate(table) if k != 255} == official


def test_a_folder_without_sequences_is_not_rellis(tmp_path: Path) -> None:
    (tmp_path / "00000").mkdir()
    with pytest.raises(InputError, match="layout of no known data set"):
        open_dataset(tmp_path)
