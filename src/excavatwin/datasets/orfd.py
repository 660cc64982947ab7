"""ORFD (Min et al., ICRA 2022): off-road tracks with a 40-beam scanner, from the official layout or one sequence.

Calibration files take the scanner into the car (z up) and the car into the camera. The dense depth is interpolated from
the beams by the authors: smooth, and wrong at edges and towards the sky. There are no poses. ``gt_image`` tells only
where a car could drive, which is no class of ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from excavatwin.datasets.folders import files_in, first_file, roots_below, subfolders
from excavatwin.datasets.readers import read_depth_256, read_rgb, read_scan
from excavatwin.errors import InputError
from excavatwin.scene.frames import invert_rigid
from excavatwin.scene.recording import Dataset, Frame, Recording, Scan, Stored

SPLITS = {"training": "train", "validation": "val", "testing": "test"}
IMAGES = ("image_data", "images")
DEPTHS = ("dense_depth", "sparse_depth")
#: x, y, z, intensity, ring.
SCAN_COLUMNS = 5


def is_sequence(folder: Path) -> bool:
    """Whether a folder is one sequence: photos, their calibration files, and depth or scans."""
    measured = any((folder / kind).is_dir() for kind in (*DEPTHS, "lidar_data"))
    return measured and (folder / "calib").is_dir() and any((folder / kind).is_dir() for kind in IMAGES)


def is_root(folder: Path) -> bool:
    """Whether a folder holds the splits of ORFD, or is one of its sequences."""
    return is_sequence(folder) or any(is_sequence(sub) for split in SPLITS for sub in subfolders(folder / split))


def find_roots(folders: Sequence[Path]) -> tuple[Path, ...]:
    """Roots below the folders."""
    return roots_below(folders, is_root)


def open_orfd(folders: Sequence[Path]) -> Dataset:
    """ORFD in one or several folders.

    Raises:
        InputError: no sequence is there, or a calibration file is damaged.
    """
    roots = find_roots(folders)
    if not roots:
        raise InputError(f"{folders[0]} holds no ORFD: no training/<sequence>/ with image_data, calib and dense_depth.")
    opened = {name: _recording(name, place) for name, place in _sequences(roots).items()}
    frames = [frame for recording in opened.values() for frame in recording.frames]
    lacking = sum(frame.depth is None for frame in frames)
    whole = any((root / split).is_dir() for root in roots for split in SPLITS)
    missing = [f"split {split}" for split in SPLITS if not any((root / split).is_dir() for root in roots)]
    return Dataset(
        name="orfd",
        folders=roots,
        names=tuple(opened),
        open=opened.__getitem__,
        counts={
            "frames": len(frames),
            "frames with depth": len(frames) - lacking,
            "scans": sum(len(recording.scans) for recording in opened.values()),
        },
        splits={s: sum(frame.split == s for frame in frames) for s in SPLITS.values()} if whole else {},
        missing=(
            *(missing if whole else ["all but this sequence"]),
            *([f"depth of {lacking} frames"] if lacking else []),
        ),
        checks=tuple(_checked(recording) for recording in opened.values()),
    )


def _sequences(roots: Sequence[Path]) -> dict[str, Path]:
    found: dict[str, Path] = {}
    for root in roots:
        if is_sequence(root):
            found.setdefault(root.name, root)
        for split in SPLITS:
            for sub in subfolders(root / split):
                if is_sequence(sub):
                    found.setdefault(f"{split}/{sub.name}", sub)
    return found


def _recording(name: str, place: Path) -> Recording:
    split = SPLITS.get(name.split("/")[0])
    photos = next(place / kind for kind in IMAGES if (place / kind).is_dir())
    images = files_in([photos], ".png", ".jpg")
    clouds = {file.stem: file for file in files_in([place / "lidar_data"], ".bin")}
    frames = []
    for file in images:
        calib = place / "calib" / f"{file.stem}.txt"
        if not calib.is_file():
            raise InputError(f"{name}: photo {file.name} has no {calib}; copy the calibration files, too.")
        K_cam, T_cam_car, T_car_L = read_calibration(calib)
        depth = first_file(place / kind / f"{file.stem}.png" for kind in DEPTHS)
        frames.append(
            Frame(
                name=file.stem,
                image=Stored(file, read_rgb),
                time=int(file.stem) / 1000 if file.stem.isdigit() else None,
                K_cam=K_cam,
                T_L_cam=invert_rigid(T_cam_car @ T_car_L),
                up_cam=T_cam_car[:3, 2],
                depth=Stored(depth, read_depth_256) if depth else None,
                scan=file.stem if file.stem in clouds else None,
                split=split,
            )
        )
    scans = tuple(
        Scan(stem, Stored(file, partial(read_scan, columns=SCAN_COLUMNS)), int(stem) / 1000 if stem.isdigit() else None)
        for stem, file in clouds.items()
    )
    return Recording(name, tuple(frames), scans, photos=photos, split=split)


def read_calibration(
    path: Path,
) -> tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, "4 4"], Float64[np.ndarray, "4 4"]]:
    """Intrinsics, car-to-camera and scanner-to-car.

    Raises:
        InputError: a matrix is missing, is no rotation, or the car's up does not point up in the photo.
    """
    values: dict[str, np.ndarray] = {}
    try:
        for line in path.read_text("utf-8").splitlines():
            key, _, numbers = line.partition(":")
            values[key.strip()] = np.array([float(word) for word in numbers.split()])
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read as a calibration ({error}).") from error
    for key, count in (("cam_K", 9), ("cam_RT", 16), ("lidar_R", 9), ("lidar_T", 3)):
        if len(values.get(key, ())) != count:
            raise InputError(f"{path} lacks {key} with {count} numbers.")
    T_cam_car, T_car_L = values["cam_RT"].reshape(4, 4), np.eye(4)
    T_car_L[:3, :3], T_car_L[:3, 3] = values["lidar_R"].reshape(3, 3), values["lidar_T"]
    for key, T in (("cam_RT", T_cam_car), ("lidar_R", T_car_L)):
        if np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max() > 1e-2 or np.linalg.det(T[:3, :3]) < 0:
            raise InputError(f"{path}: {key} is no rotation; the file is damaged.")
        U, _, Vt = np.linalg.svd(T[:3, :3])
        T[:3, :3] = U @ Vt
    if T_cam_car[1, 2] > -0.5:  # the car's z axis in the camera, whose y points down
        raise InputError(f"{path}: cam_RT does not take the car (z up) into the camera (y down): is it inverted?")
    K = values["cam_K"].reshape(3, 3)
    # Calibrated with pixel centres at whole numbers.
    return K + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]), T_cam_car, T_car_L


def _checked(recording: Recording) -> str:
    """How far the depth image of the middle frame is from its scan, where both are there."""
    pairs = [frame for frame in recording.frames if frame.depth and frame.scan]
    if not pairs:
        return f"{recording.name}: depth not tested against scans (there are none)."
    frame = pairs[len(pairs) // 2]
    scan = recording.scan(frame.scan)
    assert scan is not None
    assert frame.depth is not None
    miss = depth_miss(frame, scan, frame.depth())
    if not miss < 1.0:
        raise InputError(
            f"{recording.name}/{frame.name}: scan and depth image differ by a median of {miss:.1f} m; "
            "take calib, lidar_data and dense_depth of one release."
        )
    return f"{recording.name}: depth image and scan differ by a median of {miss:.2f} m."


def depth_miss(frame: Frame, scan: Scan, depth: np.ndarray) -> float:
    """Median difference of a scan's projected depth and the depth image [m]; NaN when nothing lands."""
    from excavatwin.datasets.label_agreement import project_distorted
    from excavatwin.scene.frames import transform

    assert frame.K_cam is not None
    assert frame.T_L_cam is not None
    xyz = scan.cloud().xyz.astype(np.float64)
    size = (depth.shape[1], depth.shape[0])
    uv, inside = project_distorted(xyz, frame.K_cam, frame.distortion, frame.T_L_cam, size)
    z = transform(invert_rigid(frame.T_L_cam), xyz[inside])[:, 2]
    seen = depth[uv[inside, 1].astype(int), uv[inside, 0].astype(int)]
    known = np.isfinite(seen)
    return float(np.median(np.abs(seen - z)[known])) if known.any() else float("nan")
