"""Finished labels of the photos instead of a network: label images, COCO JSON, YOLO text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import Float32

import excavatwin
from excavatwin.backbones.cards import Card, Tried
from excavatwin.backbones.protocols import Picture, Segmentation
from excavatwin.backbones.segmenters import sight
from excavatwin.backbones.segmenters.label_folder import IMAGES, Form, Labels, by_stem, name_files, open_labels, stamp
from excavatwin.backbones.segmenters.label_images import score_image
from excavatwin.backbones.segmenters.labelled import VOID, Labelled
from excavatwin.backbones.segmenters.photo_sampling import shares
from excavatwin.errors import InputError, require
from excavatwin.scene.taxonomy import K
from excavatwin.vocabularies import digest, resolve

#: Shapes of label images and photos agree to this.
SHAPE = 0.005


@dataclass(frozen=True)
class Masks:
    """What somebody, or some other program, has drawn on the photos.

    Files belong to photos by their names: ``a.png`` or ``a.txt`` to ``a.jpg``; a COCO file names its images. Labels
    that cover the photo are brought to the pixels of the lattice by area: a pixel on a border gets a share of each
    side. What has no label, and photos without a file, get no evidence. Label images hold ids (8 or 16 bits, or a
    palette), or colours where the vocabulary has a palette.
    """

    card: ClassVar[Card] = Card(
        name="masks",
        kind="segmenter",
        summary="finished labels: PNG of ids or colours, COCO JSON (instances, panoptic), YOLO text",
        tried=Tried.FILES,
        argument="source",
    )

    source: str = ""
    """Folder of label images or YOLO text, or a COCO JSON file."""
    form: Form = "auto"
    """What it holds; ``auto`` looks at the files."""
    vocabulary: str = ""
    """What the ids mean: a shipped vocabulary or a TOML file, ``:policy`` behind it if wanted; without it the files
    ``classes.txt`` or ``data.yaml`` beside the labels, else the task classes. COCO JSON names its own."""
    mapping: str = ""
    """Class mapping, when it is not the vocabulary's own; chosen by the names of the classes where there is none."""
    remap: Mapping[str, str] = field(default_factory=dict)
    """Class -> task class, above the mapping."""
    suffix: str = ""
    """What the label files' names have behind the photo's, ``"_labelids"``."""
    offset: int = 0
    """Added to every id: -1 for labels that count from 1 (0 becomes void)."""
    scores: str = ""
    """Folder of images that say how sure each label is, named as the photos; multiplied with the evidence."""
    certainty: float = 1.0
    """Evidence of a label without a score, 0..1: hand-drawn labels are sure, those of a network less so."""

    def __post_init__(self) -> None:
        require(self, "certainty", 0, 1)

    def identity(self) -> str:
        """The version of ExcavaTwin, which files, those that name their classes, and the content of the mappings."""
        scores = [Path(self.scores).expanduser()] if self.scores else []
        places = [self._place(), *name_files(self._place()), *scores]
        return f"{excavatwin.__version__}; {stamp(*places)}; {digest(self.vocabulary)}; {digest(self.mapping)}"

    def __call__(self, picture: Picture) -> Segmentation:
        """Evidence on the pixels of the picture.

        Raises:
            InputError: no such folder, or labels that do not fit the photo or the vocabulary; the message names the
                mistake.
        """
        size = sight.checked(picture.image, self.card.name)
        if picture.lattice is not None:
            size = (picture.lattice.width, picture.lattice.height)
        labels = self._labels()
        found = labels.source.of(picture.name, size)
        if found is None:
            return self._nothing(picture)
        mapping = self.mapping or labels.vocabulary
        resolved = resolve(labels.source.names, mapping, self.remap)
        doubts = (*resolved.doubts, *labels.doubts, *found.doubts, *_fits(found, size, picture.name))
        known = found.classes != VOID
        table = np.zeros((len(found.classes), K + 1), np.float32)
        table[known, :K] = resolved.weights[found.classes[known]] * self.certainty * found.scores[known, None]
        table[known, K] = resolved.no_surface[found.classes[known]]
        shape = picture.image.shape[:2]
        seen = shares(found.index, table, picture.lattice, shape)
        no_surface = seen[..., K] > 0.5
        evidence = np.ascontiguousarray(seen[..., :K])
        if self.scores:
            score = self._score(picture, size)
            evidence *= np.float32(0) if score is None else shares_of(score, picture, shape)
            doubts += ("has labels, but no image of scores; it has no evidence.",) if score is None else ()
        evidence[no_surface] = 0
        return Segmentation(evidence, no_surface, doubts)

    def _place(self) -> Path:
        if not self.source:
            raise InputError("segmenter masks needs labels; give --segmenter masks:FOLDER or masks:FILE.json.")
        return Path(self.source).expanduser()

    def _labels(self) -> Labels:
        place = self._place()
        state = f"{stamp(place, *name_files(place))} {digest(self.vocabulary)}"
        return open_labels(place, self.form, self.vocabulary, self.suffix, self.offset, state)

    def _nothing(self, picture: Picture) -> Segmentation:
        if not picture.name:
            raise InputError("segmenter masks finds labels by the photo's name, but the picture has none; name it.")
        shape = picture.image.shape[:2]
        said = f"has no labels in {self.source}; it has no evidence."
        return Segmentation(np.zeros((*shape, K), np.float32), np.zeros(shape, bool), (said,))

    def _score(self, picture: Picture, size: tuple[int, int]) -> Float32[np.ndarray, "h w"] | None:
        files = by_stem(Path(self.scores).expanduser(), IMAGES, "")
        path = files.get(Path(picture.name).stem.casefold())
        return None if path is None else score_image(path)


def shares_of(
    score: Float32[np.ndarray, "h w"], picture: Picture, shape: tuple[int, int]
) -> Float32[np.ndarray, "H W 1"]:
    """Mean score over each pixel of the lattice, in steps of 1/65535."""
    steps = np.round(score * 65535).astype(np.int64)
    return shares(steps, np.linspace(0, 1, 65536, dtype=np.float32)[:, None], picture.lattice, shape)


def _fits(found: Labelled, size: tuple[int, int], photo: str) -> tuple[str, ...]:
    """What must be said about the size of the labels."""
    h, w = found.index.shape
    if (w, h) == size:
        return ()
    if abs(w / h / (size[0] / size[1]) - 1) < SHAPE:
        return ("its labels have another size than the photo; they are rescaled.",)
    turned = abs(h / w / (size[0] / size[1]) - 1) < SHAPE
    hint = "they lie on their side: label photos as they are displayed (EXIF orientation)" if turned else ""
    raise InputError(
        f"the labels of {photo} are {w} x {h} px, the photo {size[0]} x {size[1]}; "
        f"{hint or 'give labels of the whole photo, neither cropped nor padded'}."
    )
