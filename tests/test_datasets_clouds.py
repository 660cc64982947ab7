"""ISPRS filter test and ORFD: small copies of the official layouts, and the real samples where they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from excavatwin.datasets import examine, isprs, open_dataset, task_table
from excavatwin.errors import InputError
from excavatwin.scene.frames import invert_rigid, transform


def sample(path: Path, points: int = 50, swapped: bool = False) -> np.ndarray:
    """An official text file: x y z class, 0 = bare earth, in Gauss-Krueger coordinates."""
    rng = np.random.default_rng(3)
    rows = np.column_stack(
        [
            rng.uniform(512700, 512750, points),
            rng.uniform(5403500, 5403550, points),
            rng.uniform(295, 300, points),
            np.arange(points) % 5 == 0,
        ]
    )
    kind = 1 - rows[:, 3] if swapped else rows[:, 3]
    lines = (f"{x:.2f} {y:.2f} {z:.2f} {k:.0f}" for (x, y, z, _), k in zip(rows, kind, strict=True))
    path.write_text("\n".join(lines) + "\n")
    return rows


def test_isprs_text_keeps_its_centimetres_and_its_ground(tmp_path) -> None:
    rows = sample(tmp_path / "samp11.txt")
    dataset = open_dataset(tmp_path)
    assert (dataset.name, dataset.names) == ("isprs", ("samp11",))
    assert "14 of 15 samples" in dataset.missing[0]
    cloud = dataset.recording("samp11").scans[0].cloud()
    np.testing.assert_array_equal(cloud.ground, rows[:, 3] == 0)
    offset = rows[:, :3] - cloud.xyz
    assert np.ptp(offset, axis=0).max() < 0.011  # two decimals in the file
    with pytest.raises(InputError, match="no class labels"):
        task_table(dataset.recording("samp11"))
    with pytest.raises(InputError, match=r"no recording 'samp12'; it has: samp11\."):
        dataset.recording("samp12")


def test_isprs_with_swapped_classes_is_refused(tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(isprs.PUBLISHED, "11", (50, 40))
    sample(tmp_path / "samp11.txt", swapped=True)
    found = examine(open_dataset(tmp_path))
    assert "has 10 bare-earth points, published are 40; its classes are swapped" in found.problems[0]
    sample(tmp_path / "samp11.txt")
    assert examine(open_dataset(tmp_path)).problems == ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2 3\n", "row 0 has 3 numbers"),
        ("1 2 3 2\n", "fourth column holds 2"),
        ("1 2 a 0\n", "rows of numbers"),
        ("", "0 points"),
    ],
)
def test_damaged_samples_are_refused(tmp_path, text, message) -> None:
    (tmp_path / "samp24.txt").write_text(text)
    with pytest.raises(InputError, match=message):
        open_dataset(tmp_path).recording("samp24").scans[0].cloud()


def test_real_isprs_samples_have_the_published_counts(shared_data) -> None:
    folder = shared_data / "ISPRS_filtertest"
    if not folder.is_dir():
        pytest.skip(f"no {folder}")
    dataset = open_dataset(folder)
    assert len(dataset) == 8
    for recording in dataset:
        cloud = recording.scans[0].cloud()
        assert (len(cloud.xyz), cloud.ground.sum()) == isprs.PUBLISHED[recording.name[-2:]]


# --- ORFD -----------------------------------------------------------------------------------------------------------

#: Car to camera and scanner to car of a real calibration file: the car looks along +y, z is up.
CAM_RT = (
    "0.9990242442017794 -0.03870134489718302 -0.02127828471028577 0.0019129833672195673 -0.025608957095939373 "
    "-0.1150890189011354 -0.9930250243799661 0.1408030241727829 0.03598250704885683 0.9926009891348704 "
    "-0.11596782120465826 0.08308956027030945 0.0 0.0 0.0 1.0"
)
LIDAR_R = "-0.996479 -0.0834525 0.00805512 0.0837999 -0.994374 0.0647862 0.00260323 0.0652331 0.997867"
K = np.array([[148.8, 0, 62.5], [0, 147.1, 37.6], [0, 0, 1]])
WIDTH, HEIGHT = 128, 72


def calibration(cam_RT: str = CAM_RT) -> str:
    return f"cam_K: {' '.join(map(str, K.ravel()))} \ncam_RT: {cam_RT} \nlidar_R: {LIDAR_R} \nlidar_T: 0 0 0 \n"


def orfd(root: Path, text: str | None = None, depth_factor: float = 1.0) -> Path:
    """One sequence of the official layout: a flat road 2 m below the scanner, its depth image and its scan."""
    place = root / "training" / "y0613_1242"
    for kind in ("image_data", "calib", "dense_depth", "lidar_data", "gt_image"):
        (place / kind).mkdir(parents=True)
    T_cam_car = np.array(CAM_RT.split(), float).reshape(4, 4)
    T_car_L = np.eye(4)
    T_car_L[:3, :3] = np.array(LIDAR_R.split(), float).reshape(3, 3)
    col, row = np.meshgrid(np.arange(WIDTH, dtype=float), np.arange(HEIGHT, dtype=float))
    ray = np.stack([(col - K[0, 2]) / K[0, 0], (row - K[1, 2]) / K[1, 1], np.ones_like(col)], -1)
    T_car_cam = invert_rigid(T_cam_car)
    down = (ray @ T_car_cam[:3, :3].T)[..., 2]
    with np.errstate(divide="ignore"):
        depth = np.where(down < -0.02, (-2 - T_car_cam[2, 3]) / down, 0)
    stem = "1623721491895"
    Image.fromarray((depth * 256 * depth_factor).astype(np.uint16)).save(place / "dense_depth" / f"{stem}.png")
    Image.fromarray(np.zeros((HEIGHT, WIDTH, 3), np.uint8)).save(place / "image_data" / f"{stem}.png")
    x, y = (a.ravel() for a in np.meshgrid(np.arange(-5, 5, 0.2), np.arange(3, 9, 0.1)))
    xyz = transform(invert_rigid(T_car_L), np.column_stack([x, y, np.full(x.size, -2.0)]))
    rows = np.column_stack([xyz, np.zeros((len(xyz), 2))]).astype("<f4")
    (place / "lidar_data" / f"{stem}.bin").write_bytes(rows.tobytes())
    (place / "calib" / f"{stem}.txt").write_text(text or calibration())
    return root


def test_orfd_depth_scan_and_gravity_agree(tmp_path) -> None:
    dataset = open_dataset(orfd(tmp_path))
    assert (dataset.name, dataset.names) == ("orfd", ("training/y0613_1242",))
    assert dataset.counts == {"frames": 1, "frames with depth": 1, "scans": 1}
    assert dataset.splits == {"train": 1, "val": 0, "test": 0}
    assert "differ by a median of 0.0" in dataset.checks[0]
    frame = dataset.recording("training/y0613_1242").frames[0]
    depth = frame.depth()
    known = np.isfinite(depth)
    assert not known[0].any()  # sky is none, not zero
    col, row = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    p = np.stack([(col - frame.K_cam[0, 2]) / frame.K_cam[0, 0], (row - frame.K_cam[1, 2]) / frame.K_cam[1, 1]], -1)
    height = (np.concatenate([p, np.ones_like(p[..., :1])], -1) * depth[..., None])[known] @ frame.up_cam
    assert np.ptp(height) < 0.05  # the road is level in the direction that the calibration calls up
    assert examine(dataset, everything=True).problems == ()
    with pytest.raises(InputError, match="lacks depth, intrinsics or pose"):
        frame.world_points()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("cam_K: 1 2 3\n", "lacks cam_K with 9 numbers"),
        (calibration().replace("cam_RT: 0.999", "cam_RT: 1.999"), "cam_RT is no rotation"),
        (
            calibration(" ".join(map(str, invert_rigid(np.array(CAM_RT.split(), float).reshape(4, 4)).ravel()))),
            "inverted",
        ),
    ],
)
def test_orfd_calibration_that_is_damaged_or_inverted_is_refused(tmp_path, text, message) -> None:
    orfd(tmp_path, text)
    with pytest.raises(InputError, match=message):
        open_dataset(tmp_path)


def test_orfd_depth_of_another_release_is_refused(tmp_path) -> None:
    orfd(tmp_path, depth_factor=1.5)
    with pytest.raises(InputError, match=r"scan and depth image differ by a median of \d"):
        open_dataset(tmp_path)


def test_real_orfd_sequence(shared_data) -> None:
    folder = shared_data / "orfd_y0613"
    if not folder.is_dir():
        pytest.skip(f"no {folder}")
    dataset = open_dataset(folder)
    assert dataset.counts == {"frames": 6, "frames with depth": 6, "scans": 0}
    recording = dataset.recording("orfd_y0613")
    assert [round(frame.time - recording.frames[0].time, 1) for frame in recording.frames] == [
        0,
        0.1,
        0.2,
        0.3,
        0.4,
        0.9,
    ]
    frame = recording.frames[0]
    assert frame.image().shape == (*frame.depth().shape, 3)
    assert 2 < np.nanmedian(frame.depth()) < 40
    assert recording.photos is not None
    assert len(list(recording.photos.iterdir())) == 6
    # The road ahead is level in the direction that the calibration calls up, some 2 m below the camera.
    depth, K = frame.depth(), frame.K_cam
    row, col = np.mgrid[520:700:4, 450:850:4]
    z = depth[row, col]
    p = np.stack([(col + 0.5 - K[0, 2]) / K[0, 0] * z, (row + 0.5 - K[1, 2]) / K[1, 1] * z, z], -1)[np.isfinite(z)]
    normal = np.linalg.svd(p - p.mean(0), full_matrices=False)[2][2]
    normal *= np.sign(normal @ frame.up_cam)
    assert np.degrees(np.arccos(normal @ frame.up_cam)) < 2
    assert 1.5 < -p.mean(0) @ normal < 2.5


def test_a_folder_of_several_data_sets_is_not_guessed(tmp_path) -> None:
    orfd(tmp_path / "a")
    (tmp_path / "b").mkdir()
    sample(tmp_path / "b" / "samp11.txt")
    with pytest.raises(InputError, match=r"several data sets: orfd in .*, isprs in .*; give the folder of one"):
        open_dataset(tmp_path)
