"""Videos: frames that are sharp, and different enough from each other to be worth a photo."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import UInt8

from excavatwin.errors import InputError, OutputError
from excavatwin.scene.observations import Unplaced
from excavatwin.scene.photo import Photo
from excavatwin.scene.progress import Progress

if TYPE_CHECKING:
    import av

VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mts", ".mpg", ".mpeg")
#: Long side at which frames are compared: a twentieth of the pixels of 4K, still sharp enough to see motion blur.
PREVIEW_SIDE = 960
MATCHED_SIDE = 480
#: Fewer matched features than this do not tell how far the picture moved.
MIN_MATCHES = 20
#: Of the 256 bits of an ORB descriptor (Rublee et al., ICCV 2011), how many a match may differ in.
MAX_CODE_DISTANCE = 50


@dataclass(frozen=True)
class VideoSampling:
    """How frames are chosen."""

    window: float = 0.4
    """Of the frames in each stretch of this length only the sharpest is considered [s]."""
    min_motion: float = 0.06
    """Median displacement of image features against the last kept frame, as a share of the long side."""
    min_sharpness: float = 0.35
    """A frame must reach this share of the usual sharpness (median of the sharpest frames of the stretches before)."""
    quality: int = 95
    """JPEG quality of the written frames."""


@dataclass(frozen=True)
class _Candidate:
    """The sharpest frame of a window so far."""

    index: int
    time: float
    sharpness: float
    frame: Any
    preview: UInt8[np.ndarray, "h w"]


def sample_video(
    path: Path, frames_dir: Path, sampling: VideoSampling, progress: Progress
) -> tuple[tuple[Photo, ...], tuple[Unplaced, ...]]:
    """Choose frames and write them to ``frames_dir`` as ``<video>_<frame number>.jpg``; one pass, constant memory.

    Sharpness is the variance of the Laplacian (Pech-Pacheco et al., ICPR 2000), compared only between frames that are
    near in time; difference is the displacement of matched features (ORB).

    Returns:
        The photos in order of time, and the video itself with a reason if it broke off.

    Raises:
        InputError: no video stream, or nothing in it can be decoded.
        OutputError: a frame cannot be written.
    """
    photos: list[Photo] = []
    broken: list[Unplaced] = []
    kept: UInt8[np.ndarray, "h w"] | None = None
    usual: deque[float] = deque(maxlen=25)
    try:
        frames_dir.mkdir(parents=True, exist_ok=True)
        for best in _sharpest_of_windows(path, sampling.window, progress, broken):
            blurred = len(usual) >= 3 and best.sharpness < sampling.min_sharpness * float(np.median(usual))
            usual.append(best.sharpness)
            if blurred or (kept is not None and displacement(kept, best.preview) < sampling.min_motion):
                continue
            photos.append(_write(best, path, frames_dir, sampling.quality))
            kept = best.preview
    except OSError as error:
        if isinstance(error, InputError | OutputError):
            raise
        raise OutputError(f"frames of {path.name} cannot be written to {frames_dir}: {error.strerror}.") from error
    if not photos:
        raise InputError(f"{path} has a video stream but no frame of it can be decoded; convert it to H.264 MP4.")
    return tuple(photos), tuple(broken)


def displacement(a: UInt8[np.ndarray, "h w"], b: UInt8[np.ndarray, "h w"]) -> float:
    """Median displacement of features of ``a`` in ``b`` as a share of the long side; infinite if they are gone.

    Features are matched, not tracked: optical flow loses its way on gravel and sand after a few pixels.
    """
    import cv2

    shrink = MATCHED_SIDE / max(a.shape)
    if shrink < 1:
        a, b = (cv2.resize(x, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA) for x in (a, b))
    if a.shape != b.shape:
        return float("inf")
    orb = cv2.ORB.create(600, fastThreshold=8)
    (spots_a, codes_a), (spots_b, codes_b) = (orb.detectAndCompute(x, None) for x in (a, b))
    if min(len(spots_a), len(spots_b)) < MIN_MATCHES:  # featureless: only a change of brightness can be seen
        return 0.0 if np.abs(a.astype(int) - b).mean() < 2 else float("inf")
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(codes_a, codes_b)
    steps = [
        np.subtract(spots_a[m.queryIdx].pt, spots_b[m.trainIdx].pt) for m in matches if m.distance < MAX_CODE_DISTANCE
    ]
    if len(steps) < MIN_MATCHES:
        return float("inf")
    return float(np.median(np.linalg.norm(steps, axis=1))) / max(a.shape)


def sharpness(preview: UInt8[np.ndarray, "h w"]) -> float:
    """Variance of the Laplacian: high where edges are crisp."""
    import cv2

    return float(cv2.Laplacian(preview, cv2.CV_32F).var())


def _sharpest_of_windows(path: Path, window: float, progress: Progress, broken: list[Unplaced]) -> Iterator[_Candidate]:
    import av

    try:
        container = av.open(str(path))
    except av.FFmpegError as error:
        raise InputError(f"{path} cannot be opened as a video ({error.strerror}); convert it to H.264 MP4.") from error
    with container:
        if not container.streams.video:
            raise InputError(f"{path} has no video stream; give a video or a folder of photos.")
        stream = container.streams.video[0]
        stream.thread_type = "AUTO"
        total = stream.frames or _expected_frames(stream)
        start = _creation_time(container, stream)
        best: _Candidate | None = None
        index = -1
        try:
            for index, frame in enumerate(container.decode(stream)):
                now = frame.time if frame.time is not None else index / float(stream.average_rate or 25)
                if best is not None and int(now / window) != int((best.time - start) / window):
                    yield best
                    best = None
                preview = _preview(frame)
                crisp = sharpness(preview)
                if best is None or crisp > best.sharpness:
                    best = _Candidate(index, start + now, crisp, frame, preview)
                progress("read video", index + 1, max(total, index + 1))
        except av.FFmpegError as error:
            broken.append(Unplaced(path.name, f"breaks off after frame {index + 1} ({error.strerror})"))
        if best is not None:
            yield best


def _write(best: _Candidate, path: Path, frames_dir: Path, quality: int) -> Photo:
    image = best.frame.to_image()
    if best.frame.rotation % 360:  # the display matrix of a phone held upright
        image = image.rotate(best.frame.rotation, expand=True)
    target = frames_dir / f"{path.stem}_{best.index:06d}.jpg"
    image.save(target, quality=quality, subsampling=0)
    return Photo(
        name=target.name,
        path=target,
        width=image.width,
        height=image.height,
        camera=f"video {path.name} {image.width}x{image.height}",
        time=best.time,
    )


def _preview(frame: av.VideoFrame) -> UInt8[np.ndarray, "h w"]:
    shrink = min(1.0, PREVIEW_SIDE / max(frame.width, frame.height))
    size = {"width": max(2, round(frame.width * shrink)), "height": max(2, round(frame.height * shrink))}
    return frame.reformat(**size, format="gray").to_ndarray()


def _expected_frames(stream: Any) -> int:
    if not stream.duration or not stream.average_rate:
        return 0
    return int(stream.duration * stream.time_base * stream.average_rate)


def _creation_time(container: Any, stream: Any) -> float:
    """Seconds since the epoch at which the recording began; 0 when the file does not tell."""
    stamp = container.metadata.get("creation_time") or stream.metadata.get("creation_time") or ""
    try:
        return datetime.fromisoformat(stamp.replace("Z", "+00:00")).timestamp()
    except ValueError:
        return 0.0
