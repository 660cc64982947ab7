"""Which photos of a long sequence are worth reconstructing: sharp ones that overlap enough."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from excavatwin.errors import InputError, require
from excavatwin.scene.observations import Unplaced
from excavatwin.scene.photo import Photo
from excavatwin.scene.progress import Progress, silent

if TYPE_CHECKING:
    from excavatwin.backbones.sequence.overlaps import Glance

NEIGHBOURS = 3
"""A photo's sharpness is compared with that of so many before and after it."""
BRIDGED = 0.4
"""A blurred photo may go when the photos before and after it share this much: it leaves no gap."""
VIDEO = 0.85
"""Photos of which neighbours share this much on the whole are frames of a video; sparser sets keep all that is sharp.
"""


@dataclass(frozen=True)
class Chosen:
    """The photos that are used, in the order in which they were taken, and those that are not."""

    photos: tuple[Photo, ...]
    unplaced: tuple[Unplaced, ...] = ()


@dataclass(frozen=True)
class Selection:
    """How views are chosen before a network sees them."""

    most: int | None = None
    """Most photos that are used; None uses all that are worth it."""
    overlap: float = 0.9
    """A frame of a video that shares more than this with the last chosen one adds nothing and is left out; 1 keeps
    all. Sets of photos whose neighbours share less than 0.85 on the whole are no video and are kept whole."""
    sharpness: float = 0.3
    """A photo is left out when its sharpness is below this share of that of its neighbours, provided that these share
    so much that no gap is left; 0 keeps all."""

    def __post_init__(self) -> None:
        require(self, "most", 1)
        require(self, "overlap", 0.0, 1.0)
        require(self, "sharpness", 0.0, 1.0)

    def __call__(self, photos: Sequence[Photo], progress: Progress = silent) -> Chosen:
        """Choose.

        Raises:
            InputError: there is no photo, or one can no longer be read.
        """
        if not photos:
            raise InputError("found no photo; give at least one.")
        ordered = in_order(photos)
        left: dict[int, str] = {}
        if len(ordered) > 2 and (self.overlap < 1 or self.sharpness > 0):
            glances = _glances(ordered, progress)
            left = self._left_out(ordered, glances)
        kept = [i for i in range(len(ordered)) if i not in left]
        if self.most is not None and len(kept) > self.most:
            thinned = {kept[i] for i in np.linspace(0, len(kept) - 1, self.most).round().astype(int)}
            reason = f"was left out because at most {self.most} photos are wanted (selection.most)"
            left.update({i: reason for i in kept if i not in thinned})
        return Chosen(
            tuple(photo for i, photo in enumerate(ordered) if i not in left),
            tuple(Unplaced(ordered[i].name, left[i]) for i in sorted(left)),
        )

    def _left_out(self, photos: Sequence[Photo], glances: Sequence[Glance]) -> dict[int, str]:
        """Index and reason of each photo that is blurred or adds nothing."""
        from excavatwin.backbones.sequence.overlaps import overlap

        relative = _relative([one.sharpness for one in glances])
        blurred = relative < self.sharpness
        left: dict[int, str] = {}
        alike: dict[int, str] = {}
        shared: list[float] = []
        last: int | None = None
        for i in range(len(photos)):
            after = next((j for j in range(i + 1, len(photos)) if not blurred[j]), None)
            ends = [j for j in (last, after) if j is not None]
            if blurred[i] and ends and overlap(glances[ends[0]], glances[ends[1] if len(ends) > 1 else i]) > BRIDGED:
                left[i] = f"is blurred ({relative[i]:.0%} of the sharpness of its neighbours)"
                continue
            common = overlap(glances[last], glances[i]) if last is not None else 0.0
            if i and i - 1 not in left:
                shared.append(common if last == i - 1 else overlap(glances[i - 1], glances[i]))
            if last is not None and common > self.overlap:
                alike[i] = f"shares {common:.0%} with {photos[last].name} and adds nothing"
            else:
                last = i
        dense = len(shared) > 0 and float(np.median(np.nan_to_num(shared))) >= VIDEO
        return left | alike if dense else left


def in_order(photos: Sequence[Photo]) -> tuple[Photo, ...]:
    """The photos as they were taken: by their clock when all of them tell the time, else as given."""
    times = [photo.time for photo in photos]
    if any(time is None for time in times):
        return tuple(photos)
    return tuple(photos[i] for i in sorted(range(len(photos)), key=lambda i: times[i] or 0.0))


def _glances(photos: Sequence[Photo], progress: Progress) -> list[Glance]:
    from excavatwin.backbones.sequence.overlaps import SIDE, glance
    from excavatwin.capture import read_photo

    glances = []
    for done, photo in enumerate(photos):
        progress("selection", done, len(photos))
        glances.append(glance(read_photo(photo, SIDE)))
    progress("selection", len(photos), len(photos))
    return glances


def _relative(values: Sequence[float]) -> np.ndarray:
    """Each value over the median of its neighbourhood."""
    found = []
    for i, value in enumerate(values):
        around = values[max(0, i - NEIGHBOURS) : i + NEIGHBOURS + 1]
        found.append(value / max(float(np.median(around)), 1e-12))
    return np.array(found)
