"""Folders of photos: what is in them, what cannot be used, and pixels in display orientation."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import UInt8

from excavatwin.capture.exif import describe_photo
from excavatwin.capture.video import VIDEO_SUFFIXES, VideoSampling, sample_video
from excavatwin.errors import InputError
from excavatwin.scene.observations import Unplaced
from excavatwin.scene.photo import Photo
from excavatwin.scene.progress import Progress, silent

if TYPE_CHECKING:
    from PIL import Image

PHOTO_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
#: Below this long side a picture is a thumbnail or an icon, not a photo [px].
MIN_SIDE = 64
#: Pillow modes that hold colours; "F" and "I" are depth maps and the like.
PICTURE_MODES = ("1", "L", "LA", "La", "P", "PA", "RGB", "RGBA", "RGBa", "RGBX", "CMYK", "YCbCr", "LAB", "HSV")


@dataclass(frozen=True)
class Capture:
    """Everything that a source offered."""

    photos: tuple[Photo, ...]
    """Readable photos, in natural order of their names (video: in order of time)."""
    skipped: tuple[Unplaced, ...] = ()
    """Files that look like photos but cannot be used, each with the reason."""


def open_capture(
    source: Path,
    frames_dir: Path | None = None,
    progress: Progress = silent,
    sampling: VideoSampling | None = None,
) -> Capture:
    """The photos of a folder, or sharp and sufficiently different frames of a video.

    A photo that cannot be decoded is skipped and named, as long as others remain: one bad file of a survey flight
    must not cost the flight. Folders are not searched recursively; hidden files are ignored.

    Args:
        source: folder of JPEG, PNG or TIFF photos, or a video file.
        frames_dir: where the frames of a video are written; needed for a video only.
        progress: told about ``"read photos"`` or ``"read video"``.
        sampling: how frames are chosen from a video.

    Raises:
        InputError: the source does not exist, holds no photo, holds none that is readable, or holds two photos whose
            results would get the same name.
    """
    source = Path(source)
    if not source.exists():
        raise InputError(f"{source} does not exist; give a folder of photos or a video file.")
    if source.is_file():
        return _open_file(source, frames_dir, progress, sampling or VideoSampling())
    paths = list_photos(source)
    photos: list[Photo] = []
    skipped: list[Unplaced] = []
    progress("read photos", 0, len(paths))
    with _pillow_quiet(), ThreadPoolExecutor(4) as pool:  # decoding releases the GIL
        for done, (path, found) in enumerate(zip(paths, pool.map(_probe, paths), strict=True), 1):
            if isinstance(found, Photo):
                photos.append(found)
            else:
                skipped.append(Unplaced(path.name, found))
            progress("read photos", done, len(paths))
    if not photos:
        first = f"{skipped[0].name} {skipped[0].reason}"
        raise InputError(f"none of the {len(skipped)} photo files in {source} is readable: {first}.")
    return Capture(tuple(photos), tuple(skipped))


def find_photos(source: Path, frames_dir: Path | None = None, progress: Progress = silent) -> list[Photo]:
    """The readable photos of a folder or video; see ``open_capture``, which also names what was skipped.

    Raises:
        InputError: as ``open_capture``.
    """
    return list(open_capture(source, frames_dir, progress).photos)


def read_photo(photo: Photo, long_side: int | None = None) -> UInt8[np.ndarray, "H W 3"]:
    """Pixels of a photo as displayed (EXIF orientation honoured), 8-bit sRGB.

    Args:
        photo: as found by ``find_photos``.
        long_side: shrink so that the longer side has this many pixels; a smaller photo is left as it is.

    Raises:
        InputError: the file is gone or can no longer be decoded.
    """
    from PIL import Image, ImageOps

    try:
        with _pillow_quiet(), Image.open(photo.path) as image:
            scale = 1.0 if long_side is None else min(1.0, long_side / max(image.size))
            if scale <= 0.5:  # JPEG: let the decoder skip octaves, but keep twice the size for a clean resize
                image.draft("RGB", (int(image.width * scale * 2), int(image.height * scale * 2)))
            upright = _to_rgb(ImageOps.exif_transpose(image))
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise InputError(f"{photo.path} cannot be decoded ({error}); copy it again or remove it.") from error
    width, height = (max(1, round(side * scale)) for side in (photo.width, photo.height))
    if upright.size != (width, height):
        upright = upright.resize((width, height), Image.Resampling.LANCZOS if scale < 1 else Image.Resampling.BOX)
    return np.array(upright)


def list_photos(folder: Path) -> list[Path]:
    """Photo files of a folder in natural order ("IMG_2" before "IMG_10").

    Raises:
        InputError: there is none, or two would give results of the same name.
    """
    files = [p for p in folder.iterdir() if p.is_file() and not p.name.startswith(".")]
    paths = sorted((p for p in files if p.suffix.lower() in PHOTO_SUFFIXES), key=lambda p: natural_key(p.name))
    if not paths:
        raise InputError(_no_photos(folder, files))
    seen: dict[str, Path] = {}
    for path in paths:
        twin = seen.setdefault(path.stem.casefold(), path)
        if twin is not path:
            raise InputError(
                f"{twin.name} and {path.name} in {folder} would give results of the same name; "
                "remove one of them, or rename it if it is another photo."
            )
    return paths


def natural_key(name: str) -> tuple[tuple[int, str], ...]:
    """Sort key under which numbers count as numbers."""
    parts = re.split(r"(\d+)", name.casefold())
    return (*((int(part), "") if part.isdigit() else (0, part) for part in parts), (0, name))


def _open_file(source: Path, frames_dir: Path | None, progress: Progress, sampling: VideoSampling) -> Capture:
    suffix = source.suffix.lower()
    if suffix in VIDEO_SUFFIXES:
        if frames_dir is None:
            raise InputError(f"{source.name} is a video; say in which folder its frames may be written (frames_dir).")
        return Capture(*sample_video(source, Path(frames_dir), sampling, progress))
    if suffix in PHOTO_SUFFIXES:
        raise InputError(f"{source.name} is a single photo; give its folder: a map needs several photos of one place.")
    raise InputError(
        f"{source.name} is neither a folder of photos ({_spoken(PHOTO_SUFFIXES)}) "
        f"nor a video ({_spoken(VIDEO_SUFFIXES)})."
    )


def _no_photos(folder: Path, files: list[Path]) -> str:
    """Why ``folder`` cannot be used, with what was found in it instead."""
    kinds = sorted({p.suffix.lower() or "files without suffix" for p in files})
    found = f"holds only {_spoken(tuple(kinds))} but" if kinds else "holds no files:"
    message = f"{folder} {found} no photos ({_spoken(PHOTO_SUFFIXES)})"
    inside = sorted(
        sub.name
        for sub in folder.iterdir()
        if sub.is_dir() and any(p.suffix.lower() in PHOTO_SUFFIXES for p in sub.iterdir())
    )
    if inside:
        return f"{message}; there are photos in its subfolder {inside[0]!r}: give {folder / inside[0]}."
    return f"{message}; give the folder that holds them."


def _spoken(suffixes: tuple[str, ...]) -> str:
    return ", ".join(suffixes)


def _probe(path: Path) -> Photo | str:
    """The photo at ``path``, or why it cannot be used. Decodes it once, small, so that later stages can rely on it."""
    from PIL import Image, UnidentifiedImageError

    try:
        if path.stat().st_size == 0:
            return "is empty (0 bytes); copy it again from the camera"
        with Image.open(path) as image:
            photo = describe_photo(image, path)
            if image.mode not in PICTURE_MODES and not image.mode.startswith("I;16"):
                return f"holds {image.mode!r} samples, not a picture; export it as 8- or 16-bit"
            if max(image.size) < MIN_SIDE:
                return f"is only {image.width} x {image.height} px"
            image.draft("RGB", (image.width // 8, image.height // 8))
            image.load()
    except UnidentifiedImageError:
        return f"is not a {path.suffix[1:].upper()} file or its header is damaged; copy it again from the camera"
    except PermissionError:
        return "may not be read (no permission)"
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        return f"is damaged ({error}); copy it again from the camera"
    return photo


def _to_rgb(image: Image.Image) -> Image.Image:
    from PIL import Image

    if not image.mode.startswith("I;16"):
        return image.convert("RGB")
    samples = np.asarray(image, np.uint32)
    # Raw converters store 10-, 12- and 14-bit samples in 16 bits: the brightest pixel tells which.
    bits = next(b for b in (8, 10, 12, 14, 16) if samples.max() < 1 << b)
    grey = (samples * 255 // ((1 << bits) - 1)).astype(np.uint8)
    return Image.fromarray(grey).convert("RGB")


@contextmanager
def _pillow_quiet() -> Iterator[None]:
    """No warnings about photos of 90 to 180 Mpx (survey cameras, not decompression bombs) nor about damaged EXIF."""
    from PIL import Image

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        warnings.filterwarnings("ignore", category=UserWarning, module="PIL")
        yield
