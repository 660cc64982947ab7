"""Label images: a number or a colour for every pixel of a photo."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, Integer, UInt8

from excavatwin.backbones.segmenters.labelled import VOID, Labelled
from excavatwin.errors import InputError
from excavatwin.vocabularies import Vocabulary, read_vocabulary, shipped_vocabularies

#: Numbers that mean "not labelled" unless the vocabulary has them: the greatest of 8 and of 16 bits.
UNLABELLED = (255, 65535)
#: Formats that change the values of pixels.
LOSSY = (".jpg", ".jpeg", ".webp")


@dataclass(frozen=True)
class LabelImages:
    """Images of a folder, one for each photo."""

    files: dict[str, Path]
    """Photo's stem (case-folded) -> file."""
    vocabulary: Vocabulary
    offset: int = 0
    """Added to the ids; below 0 is void."""

    @property
    def names(self) -> tuple[str, ...]:
        """The classes of the vocabulary."""
        return self.vocabulary.classes

    def of(self, photo: str, size: tuple[int, int]) -> Labelled | None:
        """Labels of a photo.

        Raises:
            InputError: ids or colours that the vocabulary does not have, a lossy format; the message names the mistake.
        """
        path = self.files.get(Path(photo).stem.casefold())
        if path is None:
            return None
        if path.suffix.lower() in LOSSY:
            raise InputError(f"{path} is {path.suffix[1:].upper()}, which changes the values of labels; export PNG.")
        image = pixels(path)
        if image.ndim == 2:
            return self._of_ids(image, path)
        known = {place: self.vocabulary.key(name) for place, name in reversed(list(enumerate(self.names)))}
        colours = self.vocabulary.colours
        painted = {colours[key]: place for place, key in known.items() if key in colours}
        if not (image == image[..., :1]).all() or (painted and _all_known(image, painted)):
            return self._of_colours(image, path, painted)
        return self._of_ids(
            image[..., 0], path, ("the label image is stored as RGB; its equal channels are read as ids.",)
        )

    def _of_ids(self, ids: Integer[np.ndarray, "h w"], path: Path, doubts: tuple[str, ...] = ()) -> Labelled:
        found, index = numbered(ids)
        known = {number: place for place, number in enumerate(self.vocabulary.names)}
        void = {number for number in UNLABELLED if number not in known}
        moved = [int(i) if int(i) in void else int(i) + self.offset for i in found]
        strange = [i for i in moved if i not in known and i not in void and not (i < 0 and self.offset < 0)]
        if strange:
            raise InputError(f"{path} {self._strange(strange, self.offset)}.")
        classes = np.array([known.get(i, VOID) for i in moved], np.int64)
        return Labelled(index, classes, np.ones(len(found), np.float32), doubts)

    def _strange(self, strange: list[int], offset: int) -> str:
        names, name = self.vocabulary.names, self.vocabulary.mapping.name
        low, high = min(names), max(names)
        said = f"holds the id {strange[0]}, which {name} (ids {low} to {high}) does not have"
        if strange == [high + 1] and len(names) == high - low + 1:
            return f"{said}: its labels seem to count from {low + 1}; give --masks.offset {offset - 1}"
        if strange == [low - 1] and len(names) == high - low + 1:
            return f"{said}: its labels seem to count from {low - 1}; give --masks.offset {offset + 1}"
        return f"{said}; give the vocabulary that it was made with, --masks.vocabulary NAME or FILE.toml"

    def _of_colours(
        self, image: UInt8[np.ndarray, "h w 3"], path: Path, painted: dict[tuple[int, int, int], int]
    ) -> Labelled:
        name = self.vocabulary.mapping.name
        if not painted:
            known = ", ".join(one for one in shipped_vocabularies() if read_vocabulary(one).colours)
            raise InputError(
                f"{path} is painted (RGB), but label images hold class ids, and {name} has no [colours]; export ids, "
                f"or add the table [colours] to a mapping of your own (shipped with colours: {known})."
            )
        colours, index = numbered(_packed(image))
        known_colours = {_packed(np.array(colour)).item(): place for colour, place in painted.items()}
        black = _packed(np.zeros(3, int)).item()
        strange = [int(c) for c in colours if int(c) not in known_colours and int(c) != black]
        if strange:
            turned = _all_known(image[..., ::-1], painted)
            hint = "its channels are blue, green, red: export RGB" if turned else "it was painted with another palette"
            raise InputError(f"{path} holds the colour {_unpacked(strange[0])}, which {name} does not have; {hint}.")
        classes = np.array([known_colours.get(int(c), VOID) for c in colours], np.int64)
        return Labelled(index, classes, np.ones(len(colours), np.float32))


def pixels(path: Path) -> Any:
    """Ids (h, w), or colours (h, w, 3), of a label image.

    Raises:
        InputError: it cannot be read, or holds neither.
    """
    from PIL import Image

    try:
        with Image.open(path) as image:
            mode, array = image.mode, np.asarray(image)
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError(f"{path} cannot be read as an image ({error}); export it again.") from None
    if mode in ("L", "P", "1", "I", "I;16", "I;16B", "I;16L"):
        return array.astype(np.int32)
    if mode == "RGB" or (mode == "RGBA" and (array[..., 3] == 255).all()):
        return array[..., :3]
    raise InputError(f"{path} has the mode {mode}; label images hold ids (8 or 16 bits, or a palette) or RGB colours.")


def score_image(path: Path) -> Float32[np.ndarray, "h w"]:
    """Scores in [0, 1]: 8 or 16 bits as shares of their greatest value, floating point as it is.

    Raises:
        InputError: it cannot be read, has colours, or values outside [0, 1].
    """
    from PIL import Image

    try:
        with Image.open(path) as image:
            mode, array = image.mode, np.asarray(image)
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError(f"{path} cannot be read as an image ({error}); export it again.") from None
    full = {"L": 255.0, "I;16": 65535.0, "I;16B": 65535.0, "I": 65535.0, "F": 1.0, "1": 1.0}.get(mode)
    if full is None:
        raise InputError(f"{path} has the mode {mode}; scores are images of 8 or 16 bits, or floating point in 0..1.")
    scores = array.astype(np.float32) / np.float32(full)
    if not np.isfinite(scores).all() or scores.min() < 0 or scores.max() > 1:
        raise InputError(f"{path} holds scores from {scores.min():g} to {scores.max():g}; expected 0 to 1.")
    return scores


def numbered(values: Integer[np.ndarray, "h w"]) -> tuple[Integer[np.ndarray, "n"], Integer[np.ndarray, "h w"]]:
    """The different values >= 0 in ascending order, and which of them each pixel has (sorting would take seconds)."""
    if values.min() < 0 or values.max() >= 1 << 24:
        found, index = np.unique(values, return_inverse=True)
        return found, index.reshape(values.shape)
    there = np.zeros(values.max() + 1, bool)
    there[values] = True
    place = np.cumsum(there, dtype=np.int32) - 1
    return np.flatnonzero(there), place[values]


def _packed(colours: np.ndarray) -> np.ndarray:
    wide = colours.astype(np.int32)
    return np.asarray(wide[..., 0] << 16 | wide[..., 1] << 8 | wide[..., 2])


def _unpacked(packed: int) -> tuple[int, int, int]:
    return packed >> 16, packed >> 8 & 255, packed & 255


def _all_known(image: np.ndarray, painted: dict[tuple[int, int, int], int]) -> bool:
    known = {*(_packed(np.array(colour)).item() for colour in painted), 0}
    return set(numbered(_packed(image))[0].tolist()) <= known
