"""GOOSE (Mortimer et al., 2024, arXiv:2310.16788) and GOOSE-Ex (Hagmanns et al., 2025) from their official layout.

Three robots: MuCAR-3 (GOOSE), the excavator ALICE and the quadruped Spot (GOOSE-Ex). ``ego_vehicle`` is an excavator on
ALICE only; elsewhere it is the robot's own hood, and has no voice. The labelled release has neither poses nor fitting
intrinsics (those published are for an uncropped image), so frames have none.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from excavatwin.datasets.folders import files_in, first_file, roots_below, subfolders
from excavatwin.datasets.goose_classes import CLASSES, VOCABULARY, challenge_table, check_class_list
from excavatwin.datasets.readers import read_ids, read_rgb, read_scan, read_wide_ids
from excavatwin.errors import InputError
from excavatwin.scene.recording import Dataset, Excluded, Frame, Recording, Scan, Stored

SPLITS = ("train", "val", "test")
CAMERAS = ("_windshield_vis", "_front", "_camera_left", "_realsense")
SCANNERS = ("_pcl", "_vls128", "_velodyne")
CLOUD_LABELS = ("_goose", "_velodyne", "_pcl", "_vls128")
#: Scenes whose photos and labels are known not to belong together, with the report.
BAD_SCENES = {
    "val/2023-05-17_neubiberg_sunny": "labels lie beside their photos or belong to others (goose_dataset issue #12)"
}
#: Label images that are looked into for the 9 categories of the challenge in place of the 64 classes.
LOOKED_INTO = 5

_STAMP = re.compile(r"_(\d{15,})$")


@dataclass(frozen=True)
class _Parts:
    """Where one scene's files lie, over all roots."""

    images: tuple[Path, ...]
    scans: tuple[Path, ...]
    labels: tuple[Path, ...]


def is_root(folder: Path) -> bool:
    """Whether a folder holds images or clouds by split and scene, beside a folder of labels or the class list."""
    kinds = [folder / kind for kind in ("images", "lidar", "velodyne")]
    sorted_by_split = any((kind / split).is_dir() for kind in kinds for split in SPLITS)
    return sorted_by_split and ((folder / "labels").is_dir() or (folder / "goose_label_mapping.csv").is_file())


def find_roots(folders: Sequence[Path]) -> tuple[Path, ...]:
    """Roots below the folders; the 2D and 3D archives of each split unpack side by side."""
    return roots_below(folders, is_root)


def open_goose(folders: Sequence[Path]) -> Dataset:
    """GOOSE and GOOSE-Ex in one or several folders.

    Raises:
        InputError: no scene is there, or the class list is that of another release.
    """
    roots = find_roots(folders)
    if not roots:
        raise InputError(
            f"{folders[0]} holds no GOOSE: no images/<split>/<scene> or lidar/<split>/<scene> with labels/."
        )
    checks = _class_lists((*roots, *folders))
    opened: dict[str, Recording] = {}
    excluded: list[Excluded] = []
    for name, parts in _scenes(roots).items():
        recording, left_out = _recording(name, parts)
        excluded += left_out
        if recording.frames or recording.scans:
            opened[name] = recording
    platforms = Counter(str(recording.platform) for recording in opened.values())
    frames = [frame for recording in opened.values() for frame in recording.frames]
    scans = [scan for recording in opened.values() for scan in recording.scans]
    doubt = _nine_categories(frames)
    return Dataset(
        name="goose" if "mucar3" in platforms else "goose-ex",
        folders=roots,
        names=tuple(opened),
        open=opened.__getitem__,
        counts={
            "frames": len(frames),
            "labelled frames": sum(frame.label is not None for frame in frames),
            "scans": len(scans),
            "labelled scans": sum(scan.labelled for scan in scans),
            **{f"scenes of {platform}": count for platform, count in sorted(platforms.items())},
        },
        splits={split: sum(frame.split == split for frame in frames) for split in SPLITS},
        vocabulary=VOCABULARY,
        excluded=tuple(excluded),
        missing=_missing(opened, frames, scans),
        checks=(*checks, *([doubt] if doubt else [])),
    )


def _scenes(roots: Sequence[Path]) -> dict[str, _Parts]:
    """``split/scene`` -> its folders."""
    found: dict[str, _Parts] = {}
    for split in SPLITS:
        kinds = {kind: [root / kind / split for root in roots] for kind in ("images", "lidar", "velodyne", "labels")}
        shown = [place for kind in ("images", "lidar", "velodyne") for place in kinds[kind]]
        for scene in sorted({sub.name for place in shown for sub in subfolders(place)}):
            folder = {kind: tuple(place / scene for place in places) for kind, places in kinds.items()}
            found[f"{split}/{scene}"] = _Parts(
                folder["images"], (*folder["lidar"], *folder["velodyne"]), folder["labels"]
            )
    return found


def _recording(name: str, parts: _Parts) -> tuple[Recording, list[Excluded]]:
    split = name.split("/")[0]
    images = files_in(parts.images, ".png")
    clouds = files_in(parts.scans, ".bin")
    excluded: list[Excluded] = []
    if name in BAD_SCENES and images:
        excluded.append(Excluded(f"{name} ({len(images)} photos)", BAD_SCENES[name]))
        images = []
    first = next((file.name for file in (*images, *clouds)), name.split("/")[1])
    platform = "alice" if first.startswith("alice") else "spot" if first.startswith("spot") else "mucar3"
    label_files = {file.name: file for file in files_in(parts.labels, ".png", ".label")}
    scans = []
    for file in clouds:
        prefix = _without(file.stem, SCANNERS)
        label = next((f for end in CLOUD_LABELS if (f := label_files.get(f"{prefix}{end}.label"))), None)
        problem = _damage(file, label)
        if problem:
            excluded.append(Excluded(f"{name}/{file.name}", problem))
            continue
        read = partial(read_scan, labels=label, highest=CLASSES - 1)
        scans.append(Scan(prefix, Stored(file, read), _time(prefix), labelled=label is not None))
    scan_names = {scan.name for scan in scans}
    frames = []
    for file in images:
        prefix = _without(file.stem, CAMERAS)
        if prefix == file.stem:  # colour or id images that somebody put beside the photos
            continue
        label, instance = (label_files.get(f"{prefix}_{kind}.png") for kind in ("labelids", "instanceids"))
        if file.stat().st_size == 0 or (label and label.stat().st_size == 0):
            excluded.append(Excluded(f"{name}/{file.name}", "photo or label image is empty (0 bytes)"))
            continue
        frames.append(
            Frame(
                name=prefix,
                image=Stored(file, read_rgb),
                time=_time(prefix),
                label=Stored(label, read_ids) if label else None,
                instance=Stored(instance, read_wide_ids) if instance else None,
                scan=prefix if prefix in scan_names else None,
                split=split,
            )
        )
    voiceless = () if platform == "alice" else ("ego_vehicle",)
    recording = Recording(name, tuple(frames), tuple(scans), VOCABULARY, voiceless, platform=platform, split=split)
    return recording, excluded


def _damage(cloud: Path, label: Path | None) -> str | None:
    """What is wrong with a cloud and its labels, from their sizes alone."""
    size = cloud.stat().st_size
    if size == 0 or size % 16:
        return f"cloud has {size} bytes, not rows of 16"
    if label is not None and label.stat().st_size * 4 != size:
        return f"{label.stat().st_size // 4} labels for {size // 16} points (compare goose_dataset issue #14)"
    return None


def _without(stem: str, endings: tuple[str, ...]) -> str:
    return next((stem.removesuffix(end) for end in endings if stem.endswith(end)), stem)


def _time(prefix: str) -> float | None:
    """Seconds from the nanoseconds at the end of a prefix."""
    match = _STAMP.search(prefix)
    return int(match[1]) * 1e-9 if match else None


def _class_lists(places: Sequence[Path]) -> list[str]:
    checks = []
    for place in dict.fromkeys(places):
        if (place / "goose_label_mapping.csv").is_file():
            check_class_list(place / "goose_label_mapping.csv")
            checks.append(f"{place / 'goose_label_mapping.csv'}: ids mean the classes that we know.")
    official = first_file(place / "challenge_label_mapping.csv" for place in places)
    if official is not None:
        same = bool((challenge_table(official) == challenge_table()).all())
        verdict = "is the map from 64 classes to 9 that we know" if same else "differs from the map that we know"
        checks.append(f"{official} {verdict}.")
    return checks


def _nine_categories(frames: Sequence[Frame]) -> str | None:
    """A warning when label images hold the 9 categories of the challenge in place of the classes."""
    labelled = [frame.label for frame in frames if frame.label]
    if not labelled:
        return None
    looked = labelled[:: max(1, len(labelled) // LOOKED_INTO)][:LOOKED_INTO]
    highest = max(int(ids[ids < CLASSES].max(initial=0)) for ids in (label() for label in looked))
    if highest > 8:
        return f"ids of {len(looked)} label images reach {highest}: these are the 64 classes."
    return (
        f"ids of {len(looked)} label images stay below 9: these may be the categories of the challenge "
        "(2d_challenge.zip), which do not fit the vocabulary goose-64."
    )


def _missing(opened: dict[str, Recording], frames: Sequence[Frame], scans: Sequence[Scan]) -> tuple[str, ...]:
    splits = {str(recording.split) for recording in opened.values()}
    missing = [f"split {split}" for split in ("train", "val") if split not in splits]
    unlabelled = sum(frame.label is None and frame.split != "test" for frame in frames)
    if unlabelled:
        missing.append(f"labels of {unlabelled} photos of train and val")
    if not frames:
        missing.append("photos (the 2d archives)")
    if not scans:
        missing.append("clouds (the 3d archives)")
    return tuple(missing)
