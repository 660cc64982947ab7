"""Objectron (Ahmadyan et al., 2021, arXiv:2012.09988) from its bucket's layout: clips, AR stream, boxes.

Known to this reader: boxes are in ``annotations/``, ``geometry.pbdata`` is the AR stream; the category is the folder's
name (the one inside the file may be wrong, Objectron issue #62); clips are portrait while intrinsics belong to the
landscape sensor (issue #13), which is tested on the drawn corners; poses jump when ARKit closes a loop (issue #65).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from excavatwin.datasets.ar_frames import ArBox, ArCamera, best_orientation, read_annotation, read_ar_stream
from excavatwin.datasets.folders import first_file, roots_below, subfolders
from excavatwin.errors import InputError
from excavatwin.scene.recording import Dataset, Frame, KnownObject, Recording, Stored
from excavatwin.scene.taxonomy import TaskClass

CATEGORIES = ("bike", "book", "bottle", "camera", "cereal_box", "chair", "cup", "laptop", "shoe")
#: A pose jumps when the camera moves farther than this between two frames, and than this many usual steps.
JUMP_METRES, JUMP_STEPS = 0.1, 8.0
#: Our projection of a box may miss its drawn corners by this share of the photo's width.
MISS = 0.03


def is_root(folder: Path) -> bool:
    """Whether a folder holds ``videos/<class>/batch-*`` or ``annotations/<class>/batch-*``."""
    return any(
        any(batch.name.startswith("batch-") for batch in subfolders(folder / kind / category))
        for kind in ("videos", "annotations")
        for category in CATEGORIES
    )


def find_roots(folders: Sequence[Path]) -> tuple[Path, ...]:
    """Roots below the folders."""
    return roots_below(folders, is_root)


def open_objectron(folders: Sequence[Path]) -> Dataset:
    """Objectron in one or several folders. A clip is read when its recording is asked for.

    Raises:
        InputError: no clip is there.
    """
    roots = find_roots(folders)
    if not roots:
        raise InputError(
            f"{folders[0]} holds no Objectron: no videos/<class>/batch-*/ or annotations/<class>/batch-*/."
        )
    videos, annotations = _clips(roots)
    names = tuple(sorted({*videos, *annotations}, key=_order))
    splits = _splits(roots)
    categories = tuple(sorted({name.split("/")[0] for name in names}))
    alone = [name for name in names if name not in annotations]
    unseen = [name for name in names if name not in videos]
    missing = [f"annotations of {len(alone)} clips ({alone[0]}, ...)"] if alone else []
    missing += [f"video or AR stream of {len(unseen)} clips ({unseen[0]}, ...)"] if unseen else []
    missing += [] if splits else ["index/<class>_annotations_train and _test (the splits)"]
    missing += [f"class {category}" for category in CATEGORIES if category not in categories]
    return Dataset(
        name="objectron",
        folders=roots,
        names=names,
        open=partial(_recording, places=videos, annotations=annotations, splits=splits, root=roots[0]),
        counts={
            "clips": len(names),
            "clips with boxes": len(annotations),
            "clips with AR stream": sum((place / "geometry.pbdata").is_file() for place in videos.values()),
            "clips with video": sum((place / "video.MOV").is_file() for place in videos.values()),
        },
        splits={split: sum(splits.get(name) == split for name in names) for split in ("train", "test")},
        categories=categories,
        missing=tuple(missing),
    )


def _recording(
    name: str, places: dict[str, Path], annotations: dict[str, Path], splits: dict[str, str], root: Path
) -> Recording:
    place = places.get(name, root / "videos" / name)
    boxes, drawn = read_annotation(annotations[name]) if name in annotations else ([], [])
    if (place / "geometry.pbdata").is_file():
        cameras = dict(enumerate(read_ar_stream(place / "geometry.pbdata")))
        doubts = []
    else:
        cameras = {frame.index: frame.camera for frame in drawn if frame.camera is not None}
        doubts = [f"{name} has no geometry.pbdata: only its {len(cameras)} annotated frames have a camera."]
    orientation, miss = best_orientation(cameras, boxes, drawn)
    category = name.split("/")[0]
    strange = sorted({box.category for box in boxes} - {category, ""})
    breaks = pose_jumps(list(cameras.values()))
    if miss is None:
        doubts.append(f"{name} has no drawn corners: its photos are taken to be portrait.")
    elif miss > MISS:
        doubts.append(f"boxes of {name} miss their drawn corners by {miss:.0%} of the photo: do not trust its poses.")
    if strange:
        doubts.append(f"the annotation of {name} calls its object {strange[0]!r}; its folder says {category!r}.")
    if breaks:
        doubts.append(f"the pose of {name} jumps before {len(breaks)} frames (first: {breaks[0]}).")
    return Recording(
        name,
        frames=_frames(place / "video.MOV", cameras, orientation),
        objects=tuple(_known(box, category) for box in boxes),
        platform="iPhone",
        split=splits.get(name),
        breaks=breaks,
        doubts=tuple(doubts),
    )


def _frames(video: Path, cameras: dict[int, ArCamera], orientation: str) -> tuple[Frame, ...]:
    size = video_size(video) if video.is_file() else None
    frames = []
    for index, camera in cameras.items():
        shown = size or (camera.resolution if orientation == "landscape" else camera.resolution[::-1])
        frames.append(
            Frame(
                name=f"{index:06d}",
                image=Stored(video, partial(read_video_frame, index=index)),
                time=camera.time,
                size=shown,
                K_cam=camera.intrinsics(orientation, shown),
                T_W_cam=camera.pose(orientation),
            )
        )
    return tuple(frames)


def _known(box: ArBox, category: str) -> KnownObject:
    x, y, z = (float(length) for length in box.size)
    return KnownObject(box.object_id, category, (x, z, y), box.pose(), TaskClass.OBSTACLE, name=category)


def pose_jumps(cameras: Sequence[ArCamera]) -> tuple[int, ...]:
    """Frames before which the camera leaps: farther than a hand can, and than its usual steps."""
    if len(cameras) < 3:
        return ()
    steps = np.linalg.norm(np.diff([camera.T_AR_gl[:3, 3] for camera in cameras], axis=0), axis=1)
    leap = max(JUMP_METRES, JUMP_STEPS * float(np.median(steps)))
    return tuple(int(i) + 1 for i in np.flatnonzero(steps > leap))


def video_size(path: Path) -> tuple[int, int]:
    """Width and height of a clip as shown.

    Raises:
        InputError: the clip cannot be read.
    """
    height, width = read_video_frame(path, 0).shape[:2]
    return width, height


def read_video_frame(path: Path, index: int) -> UInt8[np.ndarray, "H W 3"]:
    """Frame ``index`` of a clip as RGB, turned as its display matrix says.

    Raises:
        InputError: the clip cannot be read, or is shorter.
    """
    import av

    try:
        with av.open(str(path)) as container:
            for i, frame in enumerate(container.decode(video=0)):
                if i == index:
                    # A display matrix turns counter-clockwise, as rot90 does.
                    return np.ascontiguousarray(np.rot90(frame.to_ndarray(format="rgb24"), round(frame.rotation / 90)))
    except (av.FFmpegError, OSError) as error:
        raise InputError(f"{path} cannot be read as a video ({error}).") from error
    raise InputError(f"{path} ends before frame {index}; the download is incomplete.")


def _clips(roots: Sequence[Path]) -> tuple[dict[str, Path], dict[str, Path]]:
    """``class/batch-i/j`` -> folder of the clip; the same -> annotation file."""
    videos: dict[str, Path] = {}
    annotations: dict[str, Path] = {}
    for root in roots:
        for category in CATEGORIES:
            for batch in subfolders(root / "videos" / category):
                for clip in subfolders(batch):
                    if (clip / "geometry.pbdata").is_file() or (clip / "video.MOV").is_file():
                        videos.setdefault(f"{category}/{batch.name}/{clip.name}", clip)
            for batch in subfolders(root / "annotations" / category):
                for file in sorted(batch.glob("*.pbdata")):
                    annotations.setdefault(f"{category}/{batch.name}/{file.stem}", file)
    return videos, annotations


def _splits(roots: Sequence[Path]) -> dict[str, str]:
    """Clip -> split, from the index files, where they lie in the repository or in the bucket."""
    found = {}
    for split in ("train", "test"):
        for category in CATEGORIES:
            places = [root / sub / f"{category}_annotations_{split}" for root in roots for sub in ("index", "v1/index")]
            file = first_file(places)
            for line in file.read_text("utf-8").split() if file else ():
                found[line.strip()] = split
    return found


def _order(name: str) -> tuple[str, ...]:
    return tuple(part.zfill(8) if part.isdigit() else part for part in name.replace("batch-", "batch/").split("/"))
