"""What kind of labels a folder holds, and which file belongs to which photo."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

from excavatwin.backbones.segmenters.coco import read_coco
from excavatwin.backbones.segmenters.label_images import LOSSY, LabelImages
from excavatwin.backbones.segmenters.labelled import LabelSource
from excavatwin.backbones.segmenters.yolo_text import YoloText, yaml_names
from excavatwin.errors import InputError
from excavatwin.vocabularies import Vocabulary, read_vocabulary

Form = Literal["auto", "images", "coco", "yolo"]
IMAGES = (".png", ".tif", ".tiff", ".bmp", ".gif", ".jpg", ".jpeg", ".webp")
#: Files beside YOLO text that are no labels.
NAME_FILES = ("classes.txt", "labels.txt", "obj.names")


@dataclass(frozen=True)
class Labels:
    """A source of labels, and what was assumed about it."""

    source: LabelSource
    vocabulary: str
    """Its class mapping, ``""`` when the names must find one."""
    doubts: tuple[str, ...] = ()


def stamp(*places: Path) -> str:
    """Fingerprint of files, or of all files in folders: names, sizes and times."""
    digest = hashlib.blake2b(digest_size=10)
    for place in places:
        for file in sorted(place.rglob("*")) if place.is_dir() else [place]:
            if file.is_file():
                state = file.stat()
                digest.update(f"{file.relative_to(place)} {state.st_size} {state.st_mtime_ns}\n".encode())
    return digest.hexdigest()


def name_files(place: Path) -> list[Path]:
    """Files above a folder of labels that may name its classes, and so decide the result as well."""
    above = {place.parent, place.parent.parent} if place.is_dir() else set()
    there = [file for folder in sorted(above) for file in sorted(folder.iterdir())]
    return [file for file in there if file.name in NAME_FILES or file.suffix in (".yaml", ".yml")]


@lru_cache(maxsize=4)
def open_labels(place: Path, form: Form, vocabulary: str, suffix: str, offset: int, state: str) -> Labels:
    """The labels of a folder, or of a COCO file.

    Args:
        place: folder or file.
        form: what it holds; ``auto`` looks.
        vocabulary: classes of label images and YOLO text, a shipped name or a TOML file.
        suffix: what the names of the files have behind the stem of the photo.
        offset: added to ids.
        state: fingerprint of the place, of the files that name its classes, and of the vocabulary.

    Raises:
        InputError: nothing is there, or its classes are not known.
    """
    if not place.exists():
        raise InputError(f"there is no {place}; give a folder of label images or YOLO text, or a COCO JSON file.")
    found = _form(place) if form == "auto" else form
    if found == "coco":
        return Labels(read_coco(_json(place), state), "")
    files = by_stem(place, (".txt",) if found == "yolo" else IMAGES, suffix)
    if found == "yolo":
        names = _yolo_names(place, vocabulary)
        return Labels(YoloText(files, names, offset), vocabulary)
    if vocabulary:
        known = read_vocabulary(vocabulary)
        if not known.names:
            raise InputError(f"the classes of {vocabulary} have no ids; give a vocabulary that numbers them.")
        return Labels(LabelImages(files, known, offset), vocabulary)
    listed = _listed(place)
    if listed:
        return Labels(LabelImages(files, _plain(listed, place), offset), "")
    said = "no vocabulary was given: its ids are read as task classes 0 to 5."
    return Labels(LabelImages(files, read_vocabulary("task"), offset), "task", (said,))


def by_stem(folder: Path, endings: tuple[str, ...], suffix: str) -> dict[str, Path]:
    """Photo's stem (case-folded) -> file: ``a.png``, ``a<suffix>.png`` or ``a.jpg.png`` for ``a.jpg``.

    Raises:
        InputError: no such files, or two for one photo.
    """
    files: dict[str, Path] = {}
    every = sorted(folder.rglob("*")) if folder.is_dir() else [folder]
    for path in every:
        if path.suffix.lower() not in endings or path.name in NAME_FILES or path.name.startswith("."):
            continue
        if not path.stem.casefold().endswith(suffix.casefold()):
            continue
        stem = path.stem[: len(path.stem) - len(suffix)]
        stem = Path(stem).stem if Path(stem).suffix.lower() in IMAGES else stem
        other = files.setdefault(stem.casefold(), path)
        if other.suffix.lower() in LOSSY and path.suffix.lower() not in LOSSY:
            files[stem.casefold()] = path  # the photo beside its labels
        elif other != path and path.suffix.lower() not in LOSSY:
            raise InputError(
                f"{other.relative_to(folder)} and {path.relative_to(folder)} of {folder} both belong to {stem}; keep "
                "one, or say with --masks.suffix how the names of the label files end."
            )
    if not files:
        ending = f"{suffix}{endings[0]}"
        raise InputError(f"{folder} holds no label file named like PHOTO{ending}; give the folder of the label files.")
    return files


def _form(place: Path) -> Form:
    if place.is_file():
        return "coco"
    names = [path for path in place.rglob("*") if path.is_file() and path.name not in NAME_FILES]
    endings = {path.suffix.lower() for path in names}
    if ".json" in endings:
        return "coco"
    if ".txt" in endings and not endings & set(IMAGES):
        return "yolo"
    if ".txt" in endings and (place / "labels").is_dir():
        raise InputError(f"{place} holds images and text; give its folder labels, or say --masks.form yolo.")
    return "images"


def _json(place: Path) -> Path:
    if place.is_file():
        return place
    found = sorted(place.glob("*.json"))
    if len(found) != 1:
        names = ", ".join(path.name for path in found) or "none"
        raise InputError(f"{place} holds {len(found)} JSON files ({names}); give the one that has the annotations.")
    return found[0]


def _listed(place: Path) -> tuple[str, ...]:
    """Names of classes from a text file beside the labels, or one level up."""
    for folder in (place, place.parent):
        for name in NAME_FILES:
            if (folder / name).is_file():
                return tuple(line.strip() for line in (folder / name).read_text("utf-8").splitlines() if line.strip())
    return ()


def _yolo_names(place: Path, vocabulary: str) -> tuple[str, ...]:
    if vocabulary:
        known = read_vocabulary(vocabulary)
        if list(known.names) == list(range(len(known.names))) and known.names:
            return known.classes
        raise InputError(
            f"the classes of {vocabulary} are not numbered 0, 1, 2, ...; put a data.yaml beside the labels."
        )
    for folder in (place, place.parent, place.parent.parent):
        for path in sorted([*folder.glob("*.yaml"), *folder.glob("*.yml")]):
            names = yaml_names(path.read_text("utf-8"))
            if names:
                return names
    names = _listed(place)
    if not names:
        raise InputError(
            f"the classes of {place} are not known; put data.yaml or classes.txt beside the labels, or give "
            "--masks.vocabulary NAME."
        )
    return names


def _plain(names: tuple[str, ...], place: Path) -> Vocabulary:
    """A vocabulary that only numbers names; what they mean is looked up elsewhere."""
    from excavatwin.scene.taxonomy import ClassMapping

    if len(set(names)) < len(names):
        raise InputError(f"the list of classes of {place} names one twice; name each once.")
    return Vocabulary(ClassMapping("its list of classes", {}), dict(enumerate(names)), "own", classes=names)
