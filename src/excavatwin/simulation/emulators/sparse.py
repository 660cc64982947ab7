"""Sparse instance masks as an open-vocabulary detector delivers them: few, mostly of things, each with one score."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Int64

from excavatwin.errors import require
from excavatwin.scene.taxonomy import K, TaskClass
from excavatwin.simulation.camera import Camera
from excavatwin.simulation.emulators.fields import (
    LAB_PATCH,
    anchored,
    footprint,
    lab,
    lasting_field,
    patches,
    require_colours,
    stream,
)
from excavatwin.simulation.render import RenderedView

SPARSE = 0x5BA
"""Key of the random streams of this segmenter."""
CT, OT, RC, EX, OB = (int(k) for k in list(TaskClass)[1:])
MISTAKEN = {EX: (OB, OB, OB, CT), OB: (OB, EX, CT, OT), RC: (OT, OT, OB), CT: (OB, OT, EX), OT: (RC, CT)}
"""What an instance of a class is taken for when it is taken for something else; repeated = more often."""


@dataclass(frozen=True)
class Candidate:
    """Something that the detector may report."""

    mask: Bool[np.ndarray, "H W"]
    task_class: int
    key: int
    """Which thing in the world it is: the same in every view."""
    ease: float
    """Log odds that the prompt for its class finds it at the reference size."""


@dataclass(frozen=True)
class YoloeLike:
    """YOLOE (Wang et al., ICCV 2025; paper key ``wang2025yoloe``) prompted with the names of the task's classes.

    Each thing of the scene has a score, the logistic of how easy it is: its class, its size in the picture, a luck of
    its own that it has in every view (half the variance: an unusual skip is missed from everywhere), and a luck of the
    view. What scores above ``threshold`` is reported: mask times score, as the paper projects it. "Stuff" prompts
    (soil heap, pit, gravel, grass) rarely answer, and with a part of the region only.
    """

    machines: float = -2.5
    """Log odds of an excavator of ``size`` pixels: the prompt names it and nothing looks like it."""
    things: float = -2.65
    """Log odds of an obstacle of ``size`` pixels: some are trucks and people, others a skip or a block that no prompt
    fits. Calibrated."""
    plants: float = -2.4
    """Log odds of a bush or a tree of ``size`` pixels. Calibrated."""
    stuff: float = 1.05
    """Expected number of partial blobs reported of each kind of ground and view. Calibrated."""
    blob: float = 1.33
    """How far below its peak, in standard deviations, the field that a blob follows may fall inside it."""
    ghosts: float = 0.2
    """Expected number of false things reported on the ground and view: a heap called obstacle, a shadow, a rut."""
    size: float = 900.0
    """Reference size of a thing [px]."""
    growth: float = 0.8
    """Gain of log odds for each doubling of a thing's size."""
    luck: float = 1.5
    """Standard deviation of the luck of things in log odds."""
    sticky: float = 0.5
    """Share of the variance of that luck, and of what is taken for another class, that a thing has in every view."""
    look: float = 0.5
    """Share of what is fixed to the world that follows colour, for blobs of ground: which parts of a region are found,
    and by which name. Things keep their own luck."""
    mistaken: float = 0.22
    """Share of reported things that are called another class."""
    border: float = 2.5
    """Reach by which masks grow or shrink, standard deviation [px]."""
    missing: float = 0.2
    """Share of a mask that is missing, in patches."""
    threshold: float = 0.25
    """Least score that is reported, the default of the published code."""
    plant_cell: float = 2.5
    """Size of the ground that one plant, or one clump of them, stands on [m]."""

    @classmethod
    def goose_ex(cls) -> YoloeLike:
        """Calibrated to the GOOSE-Ex row of tab:semantic_accuracy instead of the OCES row."""
        return cls(machines=-3.4, things=-3.3, plants=-2.5, mistaken=0.35, stuff=1.4, ghosts=0.4)

    def __post_init__(self) -> None:
        for name in ("stuff", "ghosts", "luck", "border"):
            require(self, name, 0.0)
        for name in ("sticky", "look", "mistaken", "missing", "threshold"):
            require(self, name, 0.0, 1.0)
        for name in ("size", "plant_cell"):
            require(self, name, 0.0, open_low=True)

    def __call__(
        self, views: Sequence[RenderedView], cameras: Sequence[Camera], seed: int = 0
    ) -> list[Float32[np.ndarray, "H W K"]]:
        """Mask times score of the best instance of each class, 0 where there is none.

        Raises:
            InputError: ``look`` is above 0 and a view has no colours.
        """
        if self.look > 0:
            require_colours(self, views)
        return [self._view(i, view, cameras[i], seed) for i, view in enumerate(views)]

    def _view(self, number: int, view: RenderedView, camera: Camera, seed: int) -> Float32[np.ndarray, "H W K"]:
        rng = stream(seed, SPARSE, 1, number)
        evidence = np.zeros((*view.label.shape, K), np.float32)
        blurred = np.nan_to_num(footprint(view, camera), nan=np.inf)
        for thing in (*self._things(view), *self._plants(view, seed)):
            score = self._score(thing, number, seed)
            if score >= self.threshold:
                paint(evidence, self._mask(thing.mask, rng), self._called(thing, number, seed), score)
        for mask, task_class in self._blobs(view, blurred, seed, rng):
            score = self.threshold + (0.75 - self.threshold) * rng.beta(1.0, 2.5)
            paint(evidence, self._mask(mask, rng), task_class, score)
        evidence[~np.isfinite(view.depth)] = 0
        return evidence

    def _things(self, view: RenderedView) -> Iterator[Candidate]:
        """Objects with an id."""
        for key in np.unique(view.instance[view.instance > 0]):
            mask = view.instance == key
            task_class = int(np.median(view.label[mask]))
            ease = {EX: self.machines, RC: self.plants}.get(task_class, self.things)
            yield Candidate(mask, task_class, int(key), ease)

    def _plants(self, view: RenderedView, seed: int) -> Iterator[Candidate]:
        """Clumps of removable cover: which clump a pixel belongs to is the world's affair."""
        cover = (view.label == RC) & (view.instance == 0)
        keys = np.zeros(cover.shape, np.int64)
        keys[cover] = clumps(view.points[cover], self.plant_cell, seed)
        found, count = np.unique(keys[cover], return_counts=True)
        for key in found[count >= 20]:
            yield Candidate(keys == key, RC, int(key), self.plants)

    def _score(self, thing: Candidate, number: int, seed: int) -> float:
        """Logistic of ease, size and luck, at most 0.95."""
        lasting = stream(seed, SPARSE, 2, thing.key).normal()
        passing = stream(seed, SPARSE, 3, thing.key, number).normal()
        luck = self.luck * (np.sqrt(self.sticky) * lasting + np.sqrt(1 - self.sticky) * passing)
        odds = thing.ease + self.growth * np.log2(max(thing.mask.sum(), 1) / self.size) + luck
        return float(min(1 / (1 + np.exp(-odds)), 0.95))

    def _called(self, thing: Candidate, number: int, seed: int) -> int:
        """The class that a reported thing is given; a share of the mistakes is the same in every view."""
        always, once = stream(seed, SPARSE, 4, thing.key), stream(seed, SPARSE, 5, thing.key, number)
        for rng, share in ((always, self.sticky), (once, 1 - self.sticky)):
            if rng.random() < 1 - (1 - self.mistaken) ** share:
                return int(rng.choice(MISTAKEN[thing.task_class]))
        return thing.task_class

    def _mask(self, mask: Bool[np.ndarray, "H W"], rng: np.random.Generator) -> Bool[np.ndarray, "H W"]:
        """The mask grown or shrunk, its outline moved, parts missing."""
        import cv2

        outside = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 3)
        inside = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 3)
        grow = self.border * (0.7 * rng.normal() + 0.7 * patches(mask.shape, 30.0, rng)[..., 0])
        grow = np.maximum(grow, -0.3 * np.sqrt(mask.sum() / np.pi))  # nothing shrinks away
        shape = outside - inside < grow
        if self.missing == 0 or not shape.any():
            return shape
        holes = patches(mask.shape, max(12.0, 0.8 * np.sqrt(mask.sum())), rng)[..., 0]
        lost = min(self.missing * rng.uniform(0, 2), 0.9)
        return shape & (holes > np.quantile(holes[shape], lost))

    def _blobs(
        self, view: RenderedView, size: Float32[np.ndarray, "H W"], seed: int, rng: np.random.Generator
    ) -> Iterator[tuple[Bool[np.ndarray, "H W"], int]]:
        """Partial blobs of ground, rightly or wrongly named: where the world's and the picture's fields peak."""
        kinds = ((CT, CT, self.stuff), (OT, OT, self.stuff), (CT, OB, self.ghosts), (CT, EX, 0.3 * self.ghosts))
        for place, (true, called, rate) in enumerate(kinds):
            region = (view.label == true) & (size < 0.5)
            count = rng.poisson(rate)
            if count == 0 or region.sum() < 500:
                continue
            by_place, by_looks = (stream(seed, SPARSE, key, place).integers(2**31).item() for key in (6, 8))
            lasting = lasting_field(view, 4.0, self.look, (by_place, by_looks))[..., 0]
            for _ in range(count):
                field = np.sqrt(self.sticky) * lasting
                field = field + np.sqrt(1 - self.sticky) * patches(view.label.shape, 60.0, rng)[..., 0]
                blob = peak(np.where(region, field, -9), self.blob)
                yield blob, self._named(view, blob, true, seed, rng) if called == true else called

    def _named(
        self, view: RenderedView, blob: Bool[np.ndarray, "H W"], true: int, seed: int, rng: np.random.Generator
    ) -> int:
        """The class that a blob of ground is given; ground of its colour is mistaken for the same thing everywhere."""
        from scipy.special import ndtr

        fixed = self.sticky * self.look
        if fixed > 0:
            colour, of_looks = np.median(lab(view)[blob], axis=0), stream(seed, SPARSE, 9, true).integers(2**31).item()
            chance, which = ndtr(anchored(colour, LAB_PATCH, of_looks, 2))
            if chance < 1 - (1 - self.mistaken) ** fixed:
                return MISTAKEN[true][int(which * len(MISTAKEN[true]))]
        if rng.random() < 1 - (1 - self.mistaken) ** (1 - fixed):
            return int(rng.choice(MISTAKEN[true]))
        return true


def paint(evidence: Float32[np.ndarray, "H W K"], mask: Bool[np.ndarray, "H W"], task_class: int, score: float) -> None:
    """Write mask times score where it beats what is there."""
    channel = evidence[..., task_class - 1]
    channel[mask] = np.maximum(channel[mask], score)


def clumps(points: Float32[np.ndarray, "n 3"], cell: float, seed: int) -> Int64[np.ndarray, "n"]:
    """A number for the clump of plants that each point belongs to, from 1000 on: ground cells with wavy borders."""
    wave = 0.3 * cell * anchored(points, 1.5 * cell, stream(seed, SPARSE, 7).integers(2**31).item(), 2)
    col, row = np.floor((points[:, :2] + wave).clip(-1000, 1000) / cell).astype(np.int64).T + 2000
    return 1000 + row * 4000 + col


def peak(field: Float32[np.ndarray, "H W"], drop: float) -> Bool[np.ndarray, "H W"]:
    """The connected region around the greatest value of a field, down to ``drop`` below it."""
    import cv2

    top = np.unravel_index(np.argmax(field), field.shape)
    _, region = cv2.connectedComponents((field > field[top] - drop).astype(np.uint8))
    return region == region[top]
