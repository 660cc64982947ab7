"""RELLIS-3D (Jiang et al., 2021, arXiv:2011.12954) from its official layout, merged from several unpacked archives.

Facts of the release that this reader knows: ``calib.txt`` is all identity and not read; ``transforms.yaml`` holds the
pose of the camera *in the lidar frame*, so lidar-to-camera is its inverse; photos and scans of one number are not
always of one instant, so they are paired by time; four tenths of the rows of a ``.bin`` are no returns. Opening a
sequence projects a labelled scan into a labelled photo, and refuses a calibration under which fewer than half agree.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from excavatwin.datasets.folders import files_in, first_file, roots_below, subfolders
from excavatwin.datasets.label_agreement import LEAST, Agreement, label_agreement
from excavatwin.datasets.readers import read_rgb
from excavatwin.datasets.rellis_calibration import LENS, read_camera_info, read_transforms
from excavatwin.datasets.rellis_classes import VOCABULARY, read_labelled_scan, read_labels
from excavatwin.datasets.rellis_poses import LEAN, poses_at, read_poses, tilt
from excavatwin.errors import InputError
from excavatwin.scene.frames import invert_rigid
from excavatwin.scene.recording import Dataset, Frame, Recording, Scan, Stored

IMAGES, LABELS = "pylon_camera_node", "pylon_camera_node_label_id"
SCANS, SCAN_LABELS = "os1_cloud_node_kitti_bin", "os1_cloud_node_semantickitti_label_id"
#: Folder of coloured clouds whose file names carry the time of each scan.
STAMPED_SCANS = "os1_cloud_node_color_ply"
#: Photo and scan belong together when their times differ by less: half a turn of the scanner at 10 Hz [s].
NEAR_IN_TIME = 0.06
#: Photos of a sequence that the self-check tries when photos and scans had to be paired by number.
TRIED = 3

_SEQUENCE = re.compile(r"\d{5}")
_STAMPED = re.compile(r"frame(\d+)-(\d+)_(\d+)")


def is_root(folder: Path) -> bool:
    """Whether a folder holds sequences of RELLIS-3D."""
    parts = (IMAGES, LABELS, SCANS, SCAN_LABELS, STAMPED_SCANS, "transforms.yaml", "camera_info.txt")
    return any(_SEQUENCE.fullmatch(sub.name) and any((sub / p).exists() for p in parts) for sub in subfolders(folder))


def find_roots(folders: Sequence[Path]) -> tuple[Path, ...]:
    """Roots below the folders: the archives unpack as ``Rellis_3D_<package>/Rellis-3D/00000``."""
    return roots_below(folders, is_root)


def open_rellis(folders: Sequence[Path]) -> Dataset:
    """RELLIS-3D in one or several folders.

    Raises:
        InputError: no sequence is there, or photos and scans of one do not fit under its calibration.
    """
    roots = find_roots(folders)
    if not roots:
        raise InputError(f"{folders[0]} holds no RELLIS-3D: no folder 00000 to 00004 with {IMAGES} or {SCANS}.")
    splits = _splits((*roots, *folders))
    opened: dict[str, Recording] = {}
    checks: list[str] = []
    for name in sorted({sub.name for root in roots for sub in subfolders(root) if _SEQUENCE.fullmatch(sub.name)}):
        parts = [root / name for root in roots if (root / name).is_dir()]
        recording, agreement = _checked(_recording(name, parts, splits), parts)
        opened[name] = recording
        checks.append(_told(recording, agreement))
    frames = [frame for recording in opened.values() for frame in recording.frames]
    scans = [scan for recording in opened.values() for scan in recording.scans]
    return Dataset(
        name="rellis-3d",
        folders=roots,
        names=tuple(opened),
        open=opened.__getitem__,
        counts={
            "frames": len(frames),
            "labelled frames": sum(frame.label is not None for frame in frames),
            "frames with pose": sum(frame.T_W_cam is not None for frame in frames),
            "scans": len(scans),
            "labelled scans": sum(scan.labelled for scan in scans),
        },
        splits={s: sum(frame.split == s for frame in frames) for s in ("train", "val", "test")},
        vocabulary=VOCABULARY,
        missing=_missing(opened, roots, splits),
        checks=tuple(checks),
    )


def _recording(name: str, parts: Sequence[Path], splits: dict[str, str]) -> Recording:
    clock = _clock(parts)
    poses = read_poses(first_file(part / "poses.txt" for part in parts))
    labels = {file.stem: file for file in files_in((part / SCAN_LABELS for part in parts), ".label")}
    scans = tuple(
        Scan(
            name=file.stem,
            cloud=Stored(file, partial(read_labelled_scan, labels=labels.get(file.stem))),
            time=clock.get(int(file.stem)),
            labelled=file.stem in labels,
            T_W_L=poses[int(file.stem)] if int(file.stem) < len(poses) else None,
        )
        for file in files_in((part / SCANS for part in parts), ".bin")
        if file.stem.isdigit()
    )
    doubts = []
    if scans and len(poses) and len(poses) <= int(scans[-1].name):
        doubts.append(f"poses.txt of {name} has {len(poses)} rows, but scans are numbered up to {scans[-1].name}.")
    if tilt(poses) > LEAN:
        doubts.append(
            f"the world of poses.txt of {name} leans by {tilt(poses):.0f} degrees: heights along z are wrong."
        )
    if scans and not clock:
        doubts.append(
            f"the scans of {name} carry no time ({STAMPED_SCANS} is absent): photos are paired with them by number."
        )
    frames = _frames(name, parts, scans, splits)
    return Recording(name, frames, scans, VOCABULARY, platform="warthog", doubts=tuple(doubts))


def _frames(name: str, parts: Sequence[Path], scans: Sequence[Scan], splits: dict[str, str]) -> tuple[Frame, ...]:
    """Photos in order of time, each with its scan and the pose that the camera had between two scans."""
    labels = {file.stem: file for file in files_in((part / LABELS for part in parts), ".png")}
    camera = first_file(part / "camera_info.txt" for part in parts)
    transforms = first_file(part / "transforms.yaml" for part in parts)
    K_cam = read_camera_info(camera) if camera else None
    T_L_cam = read_transforms(transforms) if transforms else None
    stamped = [(stamp, f) for f in files_in((p / IMAGES for p in parts), ".jpg", ".png") if (stamp := _stamp(f.stem))]
    stamped.sort(key=lambda entry: entry[0][1])
    times = np.array([time for (_, time), _ in stamped])
    T_W_L, between = poses_at(times, scans)
    partners = _partners([stamp for stamp, _ in stamped], scans)
    frames = []
    for i, ((_, time), file) in enumerate(stamped):
        scan = partners[i]
        pose = T_W_L[i] if between[i] else scan.T_W_L if scan else None
        frames.append(
            Frame(
                name=file.stem,
                image=Stored(file, read_rgb),
                time=time,
                K_cam=K_cam,
                distortion=LENS if K_cam is not None else (0.0, 0.0, 0.0, 0.0),
                T_W_cam=pose @ T_L_cam if pose is not None and T_L_cam is not None else None,
                T_L_cam=T_L_cam,
                label=Stored(labels[file.stem], read_labels) if file.stem in labels else None,
                scan=scan.name if scan else None,
                split=splits.get(f"{name}/{file.stem}"),
            )
        )
    return tuple(frames)


def _partners(stamps: Sequence[tuple[int, float]], scans: Sequence[Scan]) -> list[Scan | None]:
    """The scan nearest in time to each photo; the scan of its number where scans have no time."""
    timed = sorted((scan.time, i) for i, scan in enumerate(scans) if scan.time is not None)
    if not timed:
        numbered = {int(scan.name): scan for scan in scans}
        return [numbered.get(number) for number, _ in stamps]
    clock = np.array([time for time, _ in timed])
    found: list[Scan | None] = []
    for _, time in stamps:
        after = int(np.searchsorted(clock, time))
        near = min(range(max(0, after - 1), min(after + 1, len(clock))), key=lambda k: abs(clock[k] - time))
        found.append(scans[timed[near][1]] if abs(clock[near] - time) <= NEAR_IN_TIME else None)
    return found


@dataclass(frozen=True)
class _Fit:
    """The weakest agreement of the photos that were tried, and that of the inverted calibration."""

    right: Agreement
    inverted: Agreement


def _checked(recording: Recording, parts: Sequence[Path]) -> tuple[Recording, _Fit | None]:
    """The recording, tested; without pairs where these were only a guess by number that does not hold.

    Raises:
        InputError: fewer than half of the labelled returns agree with the photo.
    """
    pairs = [f for f in recording.frames if f.label and f.scan and f.K_cam is not None and f.T_L_cam is not None]
    pairs = [frame for frame in pairs if (scan := recording.scan(frame.scan)) is not None and scan.labelled]
    if not pairs:
        return recording, None
    timed = recording.scans[0].time is not None
    tried = pairs[len(pairs) // 2 :][:1] if timed else pairs[:: max(1, len(pairs) // TRIED)][:TRIED]
    fits = [_fit(recording, frame) for frame in tried]
    fit = min(fits, key=lambda f: f.right.share)
    if fit.right.share >= LEAST:
        return recording, fit
    if not timed and max(f.right.share for f in fits) >= LEAST:
        # The calibration holds, the pairing by number does not: without times there is no better one.
        frames = tuple(replace(frame, scan=None, T_W_cam=None) for frame in recording.frames)
        doubt = f"photos of {recording.name} do not fit the scans of their number, so none has a scan or a pose."
        return replace(recording, frames=frames, doubts=(*recording.doubts, doubt)), fit
    where = first_file(part / "transforms.yaml" for part in parts)
    cause = (
        f"its inverse reaches {fit.inverted.share:.0%}, so it holds the other direction: put the official one back"
        if fit.inverted.share >= LEAST
        else "take transforms.yaml and camera_info.txt of this very sequence, and scans and labels of one release"
    )
    raise InputError(
        f"{where} does not fit: {fit.right.share:.0%} of the labelled returns of a scan agree with their photo "
        f"({recording.name}/{tried[0].name}), expected at least {LEAST:.0%}; {cause}."
    )


def _fit(recording: Recording, frame: Frame) -> _Fit:
    scan = recording.scan(frame.scan)
    assert scan
    assert frame.label
    assert frame.K_cam is not None
    assert frame.T_L_cam is not None
    cloud, label = scan.cloud(), frame.label()
    right, inverted = (
        label_agreement(cloud, label, frame.K_cam, frame.distortion, T)
        for T in (frame.T_L_cam, invert_rigid(frame.T_L_cam))
    )
    return _Fit(right, inverted)


def _told(recording: Recording, fit: _Fit | None) -> str:
    if fit is None:
        return f"{recording.name}: calibration not tested (no labelled photo with a labelled scan and a calibration)."
    return (
        f"{recording.name}: {fit.right.share:.0%} of {fit.right.landed} labelled returns agree with the photo "
        f"(inverted calibration: {fit.inverted.share:.0%})."
    )


def _stamp(stem: str) -> tuple[int, float] | None:
    """Number and time [s] of a name such as ``frame000104-1581624663_149``; the last part is milliseconds."""
    match = _STAMPED.fullmatch(stem)
    return (int(match[1]), int(match[2]) + int(match[3]) / 1000) if match else None


def _clock(parts: Sequence[Path]) -> dict[int, float]:
    """Time of each scan, by number."""
    stamps = (_stamp(file.stem) for file in files_in((part / STAMPED_SCANS for part in parts), ".ply"))
    return dict(stamp for stamp in stamps if stamp is not None)


def _splits(places: Sequence[Path]) -> dict[str, str]:
    """``sequence/photo`` -> split, from the image lists."""
    found: dict[str, str] = {}
    near = [sub for place in places for sub in (place, place.parent, *subfolders(place))]
    for split in ("train", "val", "test"):
        file = first_file(place / f"{split}.lst" for place in near)
        for line in file.read_text("utf-8").splitlines() if file else ():
            if line.strip():
                image = Path(line.split()[0])
                found[f"{image.parts[0]}/{image.stem}"] = split
    return found


def _missing(opened: dict[str, Recording], roots: Sequence[Path], splits: dict[str, str]) -> tuple[str, ...]:
    absent = [f"{i:05d}" for i in range(5) if f"{i:05d}" not in opened]
    missing = [f"sequence {name}" for name in absent]
    if not splits:
        missing.append("image splits (train.lst, val.lst, test.lst)")
    parts = (IMAGES, LABELS, SCANS, SCAN_LABELS, STAMPED_SCANS, "poses.txt", "camera_info.txt", "transforms.yaml")
    for name in opened:
        lacking = [part for part in parts if not any((root / name / part).exists() for root in roots)]
        missing += [f"{name}: {', '.join(lacking)}"] if lacking else []
    return tuple(missing)
