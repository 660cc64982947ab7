"""GOOSE and GOOSE-Ex as they unpack: prefixes, platforms, splits, the misspelt header, what is known to be bad."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from excavatwin.datasets import CHALLENGE, challenge_table, examine, open_dataset, task_labels, task_table
from excavatwin.errors import InputError
from excavatwin.vocabularies import read_vocabulary

EGO, HEAVY, SOIL, GRAVEL, LOW_GRASS, SKY, WATER, PERSON = 8, 57, 31, 24, 50, 53, 54, 14
STAMP = 1684329746496937615
ROW = np.array([EGO, HEAVY, SOIL, GRAVEL, LOW_GRASS, SKY, WATER, PERSON], np.uint8)
#: scene -> prefix, camera, scanner and the ending of its cloud's labels, as the releases name them.
SCENES = {
    "train/alice_scenario03": ("alice_scenario03_sequence01_0007", "_realsense", "_pcl", "_goose"),
    "val/spot_scenario01": ("spot_scenario01_sequence02_0003", "_camera_left", "_velodyne", "_velodyne"),
    "val/2022-07-22_flight": ("2022-07-22_flight__0071", "_windshield_vis", "_vls128", "_goose"),
    "val/2023-05-17_neubiberg_sunny": ("2023-05-17_neubiberg_sunny__0381", "_windshield_vis", "_vls128", "_goose"),
    "test/alice_scenario09": ("alice_scenario09_sequence01_0001", "_front", "_pcl", "_goose"),
}


def write(root: Path, clouds: bool = True, header: str = "challege_category_id") -> Path:
    """The 2D archives of some scenes in one folder, their 3D archives in another beside it."""
    for scene, (prefix, camera, scanner, label_end) in SCENES.items():
        name = f"{prefix}_{STAMP}"
        photos, labels = root / "goose_2d" / "images" / scene, root / "goose_2d" / "labels" / scene
        photos.mkdir(parents=True)
        labels.mkdir(parents=True)
        Image.fromarray(np.zeros((4, 8, 3), np.uint8)).save(photos / f"{name}{camera}.png")
        if not scene.startswith("test"):  # withheld
            Image.fromarray(np.tile(ROW, (4, 1))).save(labels / f"{name}_labelids.png")
            Image.fromarray(np.zeros((4, 8), np.uint8)).save(labels / f"{name}_instanceids.png")
            Image.fromarray(np.zeros((4, 8, 3), np.uint8)).save(labels / f"{name}_color.png")
        if clouds:
            scans = root / "goose_3d" / ("velodyne" if scanner == "_velodyne" else "lidar") / scene
            cloud_labels = root / "goose_3d" / "labels" / scene
            scans.mkdir(parents=True)
            cloud_labels.mkdir(parents=True)
            rows = np.arange(32, dtype="<f4").reshape(8, 4)
            rows[2] = 0  # no return
            (scans / f"{name}{scanner}.bin").write_bytes(rows.tobytes())
            ids = ROW.astype("<u4") | (np.arange(8, dtype="<u4") << 16)
            (cloud_labels / f"{name}{label_end}.label").write_bytes(ids.tobytes())
    classes = read_vocabulary("goose-64").names
    lines = [f"{name},{i},0,#000000" for i, name in classes.items()]
    (root / "goose_2d" / "goose_label_mapping.csv").write_text(
        "\n".join(["class_name,label_key,has_instance,hex", *lines]) + "\n"
    )
    categories, table = list(CHALLENGE), challenge_table()
    lines = [f"{name},{i},0,#000000,{table[i]},{categories[table[i]]}" for i, name in classes.items()]
    text = "\n".join([f"class_name,label_key,has_instance,hex,{header},challenge_category_name", *lines])
    (root / "goose_2d" / "challenge_label_mapping.csv").write_text("\ufeff" + text + "\n", encoding="utf-8")
    return root


@pytest.fixture(scope="module")
def goose(tmp_path_factory):
    return open_dataset(write(tmp_path_factory.mktemp("goose")))


def test_scenes_of_three_robots_from_2d_and_3d_archives(goose) -> None:
    assert goose.name == "goose"
    assert goose.names == (
        "train/alice_scenario03",
        "val/2022-07-22_flight",
        "val/2023-05-17_neubiberg_sunny",
        "val/spot_scenario01",
        "test/alice_scenario09",
    )
    platforms = {recording.name: recording.platform for recording in goose}
    assert platforms["train/alice_scenario03"] == "alice"
    assert platforms["val/spot_scenario01"] == "spot"
    assert platforms["val/2022-07-22_flight"] == "mucar3"
    assert goose.splits == {"train": 1, "val": 2, "test": 1}
    assert goose.counts["labelled frames"] == 3
    assert goose.counts["scans"] == goose.counts["labelled scans"] == 5
    frame = goose.recording("train/alice_scenario03").frames[0]
    assert frame.name == f"alice_scenario03_sequence01_0007_{STAMP}"
    assert frame.scan == frame.name
    assert abs(frame.time - STAMP * 1e-9) < 1e-3
    assert frame.K_cam is None  # the labelled release has neither poses nor fitting intrinsics
    assert frame.T_W_cam is None
    assert goose.recording("test/alice_scenario09").frames[0].label is None
    assert goose.missing == ()
    assert examine(goose, everything=True).problems == ()


def test_photos_of_the_scene_known_to_be_bad_are_left_out_and_named(goose) -> None:
    recording = goose.recording("val/2023-05-17_neubiberg_sunny")
    assert recording.frames == ()
    assert len(recording.scans) == 1  # its clouds are fine
    assert [item.what for item in goose.excluded] == ["val/2023-05-17_neubiberg_sunny (1 photos)"]
    assert "issue #12" in goose.excluded[0].reason


def test_ego_vehicle_is_an_excavator_on_alice_only(goose) -> None:
    alice, spot = goose.recording("train/alice_scenario03"), goose.recording("val/spot_scenario01")
    assert task_labels(alice, alice.frames[0])[0].tolist() == [4, 4, 1, 1, 3, 255, 255, 5]
    assert task_labels(alice, alice.frames[0], "strict")[0].tolist() == [4, 4, 1, 2, 2, 255, 255, 5]
    assert task_labels(spot, spot.frames[0])[0].tolist() == [255, 4, 1, 1, 3, 255, 255, 5]
    assert task_table(spot)[EGO] == 255
    with pytest.raises(InputError, match="no policy 'lenient'"):
        task_labels(spot, spot.frames[0], "lenient")


def test_clouds_drop_rows_without_return_with_their_labels(goose) -> None:
    cloud = goose.recording("train/alice_scenario03").scans[0].cloud()
    assert len(cloud.xyz) == 7
    assert cloud.label.tolist() == np.delete(ROW, 2).tolist()
    assert cloud.instance.tolist() == [0, 1, 3, 4, 5, 6, 7]


def test_the_official_map_to_nine_categories() -> None:
    table = challenge_table()
    names = {name: i for i, name in read_vocabulary("goose-64").names.items()}
    categories = list(CHALLENGE)
    assert sorted(name for group in CHALLENGE.values() for name in group.split()) == sorted(names)  # each class once
    assert categories[table[names["ego_vehicle"]]] == "other"
    assert categories[table[names["low_grass"]]] == "natural_ground"
    assert categories[table[names["high_grass"]]] == "vegetation"
    assert categories[table[names["rail_track"]]] == "obstacle"
    assert categories[table[names["rider"]]] == "human"
    assert (table[64:] == 255).all()


@pytest.mark.parametrize("header", ["challege_category_id", "challenge_category_id"])
def test_the_misspelt_header_is_read_like_the_right_one(tmp_path, header) -> None:
    write(tmp_path, clouds=False, header=header)
    path = tmp_path / "goose_2d" / "challenge_label_mapping.csv"
    np.testing.assert_array_equal(challenge_table(path), challenge_table())
    dataset = open_dataset(tmp_path)
    assert any("the map from 64 classes to 9 that we know" in check for check in dataset.checks)
    path.write_text(path.read_text().replace("soil,31,0,#000000,3", "soil,31,0,#000000,2"))
    assert any("differs from the map that we know" in check for check in open_dataset(tmp_path).checks)
    path.write_text(path.read_text().replace(header, "category"))
    with pytest.raises(InputError, match="no column challenge_category_id"):
        challenge_table(path)


def test_a_class_list_of_another_release_is_refused(tmp_path) -> None:
    write(tmp_path, clouds=False)
    path = tmp_path / "goose_2d" / "goose_label_mapping.csv"
    path.write_text(path.read_text().replace("soil,31,", "sand,31,"))
    with pytest.raises(InputError, match="id 31 is 'sand'; in GOOSE it is 'soil'"):
        open_dataset(tmp_path)
    path.write_text("class_name,id\nsoil,31\n")
    with pytest.raises(InputError, match="label_key None"):
        open_dataset(tmp_path)


def test_damaged_files_are_left_out_by_size_or_found_by_reading(tmp_path) -> None:
    write(tmp_path)
    label = next((tmp_path / "goose_3d" / "labels" / "val" / "spot_scenario01").iterdir())
    label.write_bytes(label.read_bytes()[:-4])
    label = next((tmp_path / "goose_3d" / "labels" / "val" / "2022-07-22_flight").iterdir())
    label.write_bytes(np.full(8, 4000, "<u4").tobytes())
    next((tmp_path / "goose_2d" / "images" / "val" / "2022-07-22_flight").iterdir()).write_bytes(b"")
    image = next((tmp_path / "goose_2d" / "labels" / "train" / "alice_scenario03").glob("*labelids*"))
    Image.fromarray(np.full((4, 8), 77, np.uint8)).save(image)
    dataset = open_dataset(tmp_path)
    reasons = {item.what.split("/")[1]: item.reason for item in dataset.excluded}
    assert "7 labels for 8 points" in reasons["spot_scenario01"]
    assert "empty (0 bytes)" in reasons["2022-07-22_flight"]
    problems = examine(dataset, everything=True).problems
    assert len(problems) == 2
    assert any("class id 4000, but ids end at 63" in problem for problem in problems)
    assert any("holds id 77, which goose-64 does not have" in problem for problem in problems)


def test_labels_of_the_challenge_are_recognised(tmp_path) -> None:
    write(tmp_path, clouds=False)
    for file in (tmp_path / "goose_2d" / "labels").rglob("*_labelids.png"):
        Image.fromarray(challenge_table()[np.array(Image.open(file))]).save(file)
    assert any("may be the categories of the challenge" in check for check in open_dataset(tmp_path).checks)


def test_goose_ex_alone_has_its_own_name(tmp_path) -> None:
    write(tmp_path)
    for kind in ("images", "labels"):
        for scene in ("2022-07-22_flight", "2023-05-17_neubiberg_sunny"):
            for file in (tmp_path / "goose_2d" / kind / "val" / scene).iterdir():
                file.unlink()
    for file in (tmp_path / "goose_3d").rglob("20*.*"):
        file.unlink()
    dataset = open_dataset([tmp_path / "goose_2d", tmp_path / "goose_3d"])
    assert dataset.name == "goose-ex"
    assert dataset.counts["scenes of alice"] == 2
