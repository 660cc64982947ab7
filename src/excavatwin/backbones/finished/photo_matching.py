"""Which photo is which camera of a finished reconstruction: by name, size and orientation."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

from excavatwin.backbones.finished.lenses import Lens
from excavatwin.errors import InputError
from excavatwin.scene.observations import Unplaced
from excavatwin.scene.photo import Photo

#: EXIF orientation -> quarter turns clockwise from the stored to the displayed photo.
TURNS = {3: 2, 6: 1, 8: 3}
#: Sizes of equal shape agree to this.
SHAPE = 0.005


@dataclass(frozen=True)
class Matches:
    """Photos with their cameras."""

    pairs: tuple[tuple[Photo, int], ...]
    """Photo and index of its camera, in the order of the photos."""
    unplaced: tuple[Unplaced, ...]
    doubts: tuple[str, ...]


def match(names: Sequence[str], photos: Sequence[Photo], where: str) -> Matches:
    """Photos whose path ends in a camera's name, else whose file name is equal, else equal but for its suffix.

    Raises:
        InputError: none fits, or one fits two cameras equally well.
    """
    found: dict[int, int] = {}
    for key in (lambda name: PurePosixPath(name).name.casefold(), lambda name: PurePosixPath(name).stem.casefold()):
        free: dict[str, list[int]] = defaultdict(list)
        for index, name in enumerate(names):
            if index not in found.values():
                free[key(_posix(name))].append(index)
        for number, photo in enumerate(photos):
            if number not in found and (same := free.get(key(photo.name))):
                found[number] = _longest(same, names, photo, where)
    taken = list(found.values())
    twice = next((index for index in taken if taken.count(index) > 1), None)
    if twice is not None:
        both = " and ".join(photos[number].name for number, index in found.items() if index == twice)
        raise InputError(f"{both} both fit {names[twice]!r} of {where}; remove the one that is not meant.")
    if not found:
        raise InputError(
            f"none of the {len(photos)} photos ({photos[0].name}, ...) is among the {len(names)} images of {where} "
            f"({names[0] if names else 'none'}, ...); give the photos that it was made from."
        )
    unused = [name for index, name in enumerate(names) if index not in taken]
    doubts: tuple[str, ...] = ()
    if unused:
        doubts = (f"{len(unused)} of the {len(names)} images of {where} have no photo here, {unused[0]} among them.",)
    return Matches(
        tuple((photos[number], found[number]) for number in sorted(found)),
        tuple(Unplaced(p.name, f"has no pose in {where}") for n, p in enumerate(photos) if n not in found),
        doubts,
    )


def fitted(lens: Lens, photo: Photo, where: str) -> tuple[Lens, str]:
    """The lens for the photo as displayed, and what was assumed about it (empty when nothing was).

    Other programs read photos as they are stored and do not turn them for display; we do. Photos of another size but
    the same shape were shrunk.

    Raises:
        InputError: the photo has another shape than the camera.
    """
    orientation = _orientation(photo)
    if orientation not in (1, *TURNS):
        raise InputError(f"{photo.path} is stored mirrored (EXIF orientation {orientation}); export it upright first.")
    turns = TURNS.get(orientation, 0)
    stored = (photo.height, photo.width) if turns % 2 else (photo.width, photo.height)
    for size, turned in ((stored, turns), ((photo.width, photo.height), 0)):
        if abs(size[0] / size[1] / (lens.width / lens.height) - 1) < SHAPE:
            if size == (lens.width, lens.height):
                return Lens(lens.width, lens.height, lens.model, lens.params, turned), ""
            said = (
                f"photos are {size[0]} x {size[1]} px, the cameras of {where} {lens.width} x {lens.height}: rescaled."
            )
            fit = lens.resized(*size)
            return Lens(fit.width, fit.height, fit.model, fit.params, turned), said
    raise InputError(
        f"{photo.name} is {photo.width} x {photo.height} px but its camera in {where} is {lens.width} x {lens.height}; "
        "give the photos that the reconstruction was made from (undistorted ones for a model of undistorted images)."
    )


def _posix(name: str) -> str:
    return name.replace("\\", "/")


def _longest(same: Sequence[int], names: Sequence[str], photo: Photo, where: str) -> int:
    """Of cameras with the photo's file name the one whose folders agree best."""
    if len(same) == 1:
        return same[0]

    def shared(index: int) -> int:
        parts, own = PurePosixPath(_posix(names[index])).parts[::-1], photo.path.parts[::-1]
        agree = [a.casefold() == b.casefold() for a, b in zip(parts[1:], own[1:], strict=False)]
        return [*agree, False].index(False)

    ranked = sorted(same, key=shared, reverse=True)
    if shared(ranked[0]) == shared(ranked[1]):
        raise InputError(
            f"{photo.name} may be {names[ranked[0]]!r} or {names[ranked[1]]!r} of {where}; give the folder of one of "
            "them, named as there."
        )
    return ranked[0]


def _orientation(photo: Photo) -> int:
    from PIL import Image

    from excavatwin.capture.exif import ORIENTATION

    try:
        with Image.open(photo.path) as image:
            return int(image.getexif().get(ORIENTATION) or 1)
    except (OSError, SyntaxError, ValueError, TypeError):
        return 1
