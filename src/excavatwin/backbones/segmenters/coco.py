"""Labels as COCO JSON: instances with polygons or run lengths, and panoptic PNG with their segments."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from excavatwin.backbones.segmenters.label_images import numbered
from excavatwin.backbones.segmenters.labelled import (
    VOID,
    Instance,
    Labelled,
    of_instances,
    polygon_area,
    polygon_mask,
)
from excavatwin.backbones.segmenters.run_lengths import decoded, unpacked
from excavatwin.errors import InputError


@dataclass(frozen=True)
class Coco:
    """One JSON file with images, annotations and categories."""

    path: Path
    names: tuple[str, ...]
    """Categories in the order of the file."""
    places: dict[int, int]
    """Category id -> place in ``names``."""
    images: dict[str, dict[str, Any]]
    """Photo's stem (case-folded) -> entry of its image."""
    annotations: dict[int, list[dict[str, Any]]]
    """Image id -> annotations."""

    def of(self, photo: str, size: tuple[int, int]) -> Labelled | None:
        """Labels of a photo.

        Raises:
            InputError: an annotation has no mask, or is damaged; the message names it.
        """
        image = self.images.get(Path(photo).stem.casefold())
        if image is None:
            return None
        found = self.annotations.get(image["id"], [])
        if any("segments_info" in one for one in found):
            return self._panoptic(found[0])
        shape = int(image.get("width", size[0])), int(image.get("height", size[1]))
        return of_instances([self._instance(one, shape) for one in found], shape)

    def _instance(self, one: dict[str, Any], size: tuple[int, int]) -> Instance:
        where = f"{self.path}, annotation {one.get('id', '?')}"
        place, score = self._place(one, where), float(one.get("score", 1.0))
        shape = one.get("segmentation")
        if not shape:
            raise InputError(f"{where} has no segmentation (only a box?); export masks, not boxes.")
        if isinstance(shape, dict):
            counts, (height, width) = shape["counts"], shape["size"]
            if (width, height) != size:
                raise InputError(f"{where} is {width} x {height} px, its image {size[0]} x {size[1]}; export it again.")
            runs = unpacked(counts) if isinstance(counts, str) else counts
            return Instance(place, score, float(sum(runs[1::2])), partial(decoded, runs, height, width))
        polygons = [np.asarray(flat, float).reshape(-1, 2) for flat in shape]
        area = sum(map(polygon_area, polygons))
        return Instance(place, score, area, lambda: np.any([polygon_mask(one, *size) for one in polygons], axis=0))

    def _panoptic(self, one: dict[str, Any]) -> Labelled:
        from PIL import Image

        name = str(one["file_name"])
        folders = (self.path.parent, self.path.with_suffix(""), self.path.parent / "panoptic")
        path = next((folder / name for folder in folders if (folder / name).is_file()), None)
        if path is None:
            raise InputError(
                f"{self.path} names {name}, which is neither beside it nor in {self.path.with_suffix('')}."
            )
        with Image.open(path) as image:
            if image.mode not in ("RGB", "RGBA"):
                raise InputError(
                    f"{path} is {image.mode}, not RGB; panoptic ids are stored as red + 256 green + 65536 blue."
                )
            colours = np.asarray(image.convert("RGB")).astype(np.int32)
        ids, index = numbered(colours[..., 0] | colours[..., 1] << 8 | colours[..., 2] << 16)
        places = {int(s["id"]): self._place(s, f"{self.path}, segment {s['id']}") for s in one["segments_info"]}
        strange = [int(i) for i in ids if i and int(i) not in places]
        if strange:
            raise InputError(f"{path} holds the segment {strange[0]}, which {self.path} does not describe.")
        classes = np.array([places.get(int(i), VOID) for i in ids], np.int64)
        return Labelled(index, classes, np.ones(len(ids), np.float32))

    def _place(self, one: dict[str, Any], where: str) -> int:
        category = one.get("category_id")
        if category not in self.places:
            raise InputError(f"{where} has the category {category!r}, which the file does not describe.")
        return self.places[category]


@lru_cache(maxsize=2)
def read_coco(path: Path, stamp: str) -> Coco:
    """The file, kept while it does not change.

    Args:
        path: the JSON file.
        stamp: fingerprint of the file.

    Raises:
        InputError: not JSON, or not COCO's annotations.
    """
    try:
        table = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read as JSON ({error}); export it again.") from None
    if isinstance(table, list):
        raise InputError(f"{path} holds results only; give an annotation file with images and categories.")
    for key in ("images", "annotations", "categories"):
        if not isinstance(table.get(key), list):
            raise InputError(f"{path} has no list {key!r}; expected COCO annotations: images, annotations, categories.")
    images = {Path(str(one["file_name"])).stem.casefold(): one for one in table["images"]}
    if len(images) < len(table["images"]):
        raise InputError(f"{path} has several images of one name; give a file for one folder of photos.")
    annotations: dict[int, list[dict[str, Any]]] = {}
    for one in table["annotations"]:
        annotations.setdefault(one["image_id"], []).append(one)
    places = {one["id"]: place for place, one in enumerate(table["categories"])}
    return Coco(path, tuple(str(one["name"]) for one in table["categories"]), places, images, annotations)
