"""Backbones that keep every promise, and twins of them that break one each: what the conformance suite is tested on."""

from __future__ import annotations

import socket
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from excavatwin.backbones.cards import Card, Tried
from excavatwin.backbones.lattices import IMAGENET, normalised
from excavatwin.backbones.protocols import Picture, Segmentation
from excavatwin.capture import read_photo
from excavatwin.errors import InputError
from excavatwin.scene.frames import invert_rigid
from excavatwin.scene.observations import Lattice, Observations, Unplaced, View
from excavatwin.scene.photo import Photo
from excavatwin.scene.progress import Progress
from excavatwin.scene.taxonomy import K
from finished_site import shots

RNG = np.random.default_rng(1)
"""Shared and never seeded again: what is drawn from it differs from call to call."""


def card(name: str, kind, **more) -> Card:
    return Card(name=name, kind=kind, summary="of the tests", tried=Tried.STAND_IN, **more)


def forced(view: View, key: str, value) -> View:
    """A view with a field that the shape checks of the tests would not let in; users run without them."""
    object.__setattr__(view, key, value)
    return view


@dataclass(frozen=True)
class Exact:
    """The truth of the finished site."""

    card: ClassVar[Card] = card("exact", "reconstructor")

    shrink: int = 1
    """Every so many pixels of the photo become one of the lattice [px]."""

    def identity(self) -> str:
        return "tests"

    def __call__(self, photos: Sequence[Photo], progress: Progress, scratch: Path) -> Observations:
        known = {shot.name: shot for shot in shots()}
        views, unplaced = [], []
        for number, photo in enumerate(photos):
            progress("look up", number, len(photos))
            try:
                image = read_photo(photo)
            except InputError as error:
                unplaced.append(Unplaced(photo.name, str(error)))
                continue
            if photo.name not in known or image.shape != known[photo.name].image.shape:
                raise InputError(f"{photo.name} is none of the photos of the finished site; give those.")
            views.append(self.view(known[photo.name]))
        source = {"reconstructor": "exact", "confidence": "constant"}
        return Observations(tuple(views), np.array([0.0, 0, 1]), 1.0, unplaced=tuple(unplaced), source=source)

    def view(self, shot) -> View:
        H, W = shot.depth.shape
        points = np.where(np.isfinite(shot.depth)[..., None], shot.points, np.nan).astype(np.float32)
        confidence = np.where(np.isfinite(points[..., 0]), 1 / np.nan_to_num(shot.depth, nan=1), 0).astype(np.float32)
        at = Lattice(W, H, np.array([[1.0, 0, 0], [0, 1, 0]]), shot.K)
        return View(shot.name, points, confidence, np.zeros((H, W, K), np.float32), shot.T, shot.K, shot.image, at)


class InvertedPose(Exact):
    def view(self, shot):
        return replace(super().view(shot), T_R_cam=invert_rigid(shot.T))


class SwappedSides(Exact):
    def view(self, shot):
        return forced(super().view(shot), "confidence", np.ones(shot.depth.shape[::-1], np.float32))


class BgrImages(Exact):
    def view(self, shot):
        view = super().view(shot)
        return replace(view, image=np.ascontiguousarray(view.image[..., ::-1]))


class ForgottenCrop(Exact):
    def view(self, shot):
        view = super().view(shot)
        affine = view.lattice.affine + np.array([[0, 0, -9.0], [0, 0, 0]])
        return replace(view, lattice=replace(view.lattice, affine=affine))


class Segments(Exact):
    def view(self, shot):
        view = super().view(shot)
        return replace(view, evidence=np.full_like(view.evidence, 0.1))


class DoublePoints(Exact):
    def view(self, shot):
        view = super().view(shot)
        return forced(view, "points", view.points.astype(np.float64))


class Drifting(Exact):
    def view(self, shot):
        view = super().view(shot)
        return replace(view, confidence=view.confidence * np.float32(1 + 0.1 * RNG.random()))


class Calling(Exact):
    def __call__(self, photos, progress, scratch):
        try:
            socket.create_connection(("telemetry.example", 443), timeout=1)
        except OSError:
            progress("offline", 0, 1)
        return super().__call__(photos, progress, scratch)


class Mute(Exact):
    def __call__(self, photos, progress, scratch):
        return super().__call__(photos, lambda *_: None, scratch)


class Losing(Exact):
    def __call__(self, photos, progress, scratch):
        found = super().__call__(photos, progress, scratch)
        return replace(found, views=found.views[1:], source={})


class Fragile(Exact):
    def __call__(self, photos, progress, scratch):
        if len(photos) < 2:
            raise IndexError("list index out of range")
        return super().__call__(photos, progress, scratch)


@dataclass(frozen=True)
class Colours:
    """Green is cover, the rest is ground."""

    card: ClassVar[Card] = card("colours", "segmenter")

    sure: float = 0.9
    """Evidence where all is clear."""

    def identity(self) -> str:
        return "tests"

    def prepare(self, image):
        return normalised(image, *IMAGENET)

    def __call__(self, picture: Picture) -> Segmentation:
        rgb = picture.image.astype(np.float32)
        green = np.clip((2 * rgb[..., 1] - rgb[..., 0] - rgb[..., 2]) / 60, 0, 1)
        evidence = np.zeros((*green.shape, K), np.float32)
        evidence[..., 2], evidence[..., 0] = self.sure * green, self.sure * (1 - green)
        return Segmentation(evidence, np.zeros(green.shape, bool))


class BgrPrepare(Colours):
    def prepare(self, image):
        return normalised(np.ascontiguousarray(image[..., ::-1]), *IMAGENET)


class BgrOrder(Colours):
    def prepare(self, image):
        return np.ascontiguousarray(super().prepare(image)[::-1])


class SwappedPrepare(Colours):
    def prepare(self, image):
        return np.ascontiguousarray(super().prepare(image).transpose(0, 2, 1))


class SquareTransposed(Colours):
    def prepare(self, image):
        return np.ascontiguousarray(super().prepare(image)[:, :96, :96].transpose(0, 2, 1))


class Mirrored(Colours):
    def prepare(self, image):
        return np.ascontiguousarray(super().prepare(image)[:, :, ::-1])


class Negative(Colours):
    def prepare(self, image):
        return -super().prepare(image)


class Squared(Colours):
    def prepare(self, image):
        return super().prepare(image) ** 2


class TooMuch(Colours):
    def __call__(self, picture):
        found = super().__call__(picture)
        return Segmentation(np.clip(found.evidence + np.float32(0.4), 0, 1), found.no_surface)


class Logits(Colours):
    def __call__(self, picture):
        found = super().__call__(picture)
        return Segmentation(np.log(found.evidence + np.float32(1e-3)), found.no_surface)


class Turned(Colours):
    def __call__(self, picture):
        found = super().__call__(picture)
        return Segmentation(np.ascontiguousarray(found.evidence.transpose(1, 0, 2)), found.no_surface)


class UpsideDown(Colours):
    def __call__(self, picture):
        found = super().__call__(picture)
        return Segmentation(np.ascontiguousarray(found.evidence[::-1]), found.no_surface)


class Dropout(Colours):
    def __call__(self, picture):
        found = super().__call__(picture)
        return Segmentation(found.evidence * np.float32(RNG.uniform(0.5, 1)), found.no_surface)


class Downloading(Colours):
    def __call__(self, picture):
        with socket.socket() as one:
            try:
                one.connect(("192.0.2.1", 443))
            except OSError:
                return super().__call__(picture)


class OneSize(Colours):
    def __call__(self, picture):
        if picture.image.shape[1] == 517:
            raise ValueError("shapes (517,391) (512,384) not aligned")
        return super().__call__(picture)


@dataclass
class Thawed:
    """Not frozen, and with a parameter that nobody explains."""

    card: ClassVar[Card] = card("Thawed_One", "reconstructor", modules=("no_such_module",))

    threshold: float = 0.5

    def identity(self) -> str:
        return str(RNG.random())

    def __call__(self, picture: Picture) -> Segmentation:
        return Colours()(picture)
