"""Dense class maps as a closed-set segmenter delivers them on work sites: complete, confident, wrong by regions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int64, UInt8

from excavatwin.errors import require
from excavatwin.scene.taxonomy import K
from excavatwin.simulation.camera import Camera
from excavatwin.simulation.emulators.fields import footprint, lasting_field, patches, require_colours, stream
from excavatwin.simulation.render import RenderedView

DENSE = 0xDE5
"""Key of the random streams of this segmenter."""

AFFINITY = np.array(
    [
        # CT    OT    RC    EX    OB   nothing
        [0.0, -0.3, -1.2, -4.5, -2.2, -1.0],  # construction terrain: "path", "sand", "field"; a heap is a "rock"
        [-0.6, 0.0, -0.3, -5.0, -2.8, -1.2],  # other terrain: "earth" or, turf being green, "grass" and "plant"
        [-1.4, -0.4, 0.0, -5.0, -1.8, -1.2],  # cover: tall grass is "grass" as the meadow is; a tree is easy
        [-1.5, -2.0, -2.5, -1.2, 0.4, -0.5],  # excavator: no such class in ADE20K-150, so "truck", "crane", "car"
        [-1.0, -1.0, -2.0, -2.5, 0.0, -0.3],  # obstacle: pipes, blocks, skips are few among the 150
    ],
    np.float32,
)
"""Log odds with which each true class (rows) is taken for each class or nothing (columns) before ``skill`` favours the
right one: which confusions there are. ADE20K-150 (Zhou et al., CVPR 2017) has earth, sand, path, dirt track, field,
grass, rock for the same ground, and neither excavator nor pipe nor skip."""

SKY = np.array([-3, -3, -1, -6, -3, 3], np.float32)
"""The same for sky, which borders on things and blurs into them."""


@dataclass(frozen=True)
class Mask2FormerLike:
    """Mask2Former (Cheng et al., CVPR 2022) with the weights of a general vocabulary, on a site it was not trained for.

    Log odds of every class are the confusion table, plus ``skill`` for the right class, plus errors that come in
    patches: half of their variance is fixed to the world and the same in every view, because the cause (wet soil that
    looks like a road, turf that looks like a hedge, a machine that has no class) is in the scene; half is drawn anew
    in every view, because the cause (viewpoint, crop, what else is in the picture) is in the picture. Half of what is
    fixed to the world follows colour: places that look alike are wrong alike. See docs/emulators.md for why half, and
    for the calibration. Views need colours unless ``look`` is 0.
    """

    skill: float = 1.749
    """Log odds in favour of the right class at the reference footprint. Calibrated: sets the mIoU."""
    nothing: float = 0.998
    """Log odds added to "none of the task classes" (sky, water, wall, void). Calibrated: sets the coverage."""
    spread: float = 1.6
    """Standard deviation of the patchy errors of each class's log odds."""
    sticky: float = 0.5
    """Share of the variance of the errors that is fixed to the world, 0..1; the rest is drawn anew in every view."""
    look: float = 0.5
    """Share of the variance of the errors fixed to the world that follows colour, 0..1; the rest belongs to places."""
    world_patch: float = 4.0
    """Wavelength of the errors that belong to places of the world [m]."""
    picture_patch: float = 70.0
    """Wavelength of the errors that are fixed to the picture [px]: about the same 4 m."""
    whole: float = 0.6
    """Share of the errors' variance, on an object, that the object has as a whole: masks are classified, not pixels."""
    small: float = 400.0
    """Size of an object that has an even chance to be lost in its surroundings [px]."""
    border: float = 3.0
    """Displacement of borders between regions, standard deviation [px]: masks are predicted at a quarter of the
    resolution."""
    reference: float = 0.1
    """Length of ground under a pixel at which the fields above hold [m]."""
    far: float = 0.5
    """Growth of the picture's own errors with the length of ground under a pixel, as its exponent: far and grazing
    pixels are worse."""
    confidence: float = 1.6
    """Factor on the log odds before they become probabilities: above 1 the scores claim more than they keep."""

    @classmethod
    def goose_ex(cls) -> Mask2FormerLike:
        """Calibrated to the GOOSE-Ex row of tab:semantic_accuracy instead of the OCES row."""
        return cls(skill=0.504, nothing=-0.035)

    def __post_init__(self) -> None:
        for name in ("spread", "small", "border", "far"):
            require(self, name, 0.0)
        for name in ("sticky", "look", "whole"):
            require(self, name, 0.0, 1.0)
        for name in ("world_patch", "picture_patch", "reference", "confidence"):
            require(self, name, 0.0, open_low=True)

    def __call__(
        self, views: Sequence[RenderedView], cameras: Sequence[Camera], seed: int = 0
    ) -> list[Float32[np.ndarray, "H W K"]]:
        """Probability of every class and pixel; what is missing to 1 went to classes that map to nothing.

        Raises:
            InputError: ``look`` is above 0 and a view has no colours.
        """
        if self.look > 0:
            require_colours(self, views)
        return [self._view(i, view, cameras[i], seed) for i, view in enumerate(views)]

    def _view(self, number: int, view: RenderedView, camera: Camera, seed: int) -> Float32[np.ndarray, "H W K"]:
        rng = stream(seed, DENSE, 1, number)
        odds = self._means(view, rng) @ self._table()
        odds += self._errors(view, camera, number, seed, rng)
        odds = np.float32(self.confidence) * odds
        odds -= odds.max(-1, keepdims=True)
        p = np.exp(odds, out=odds)
        p /= p.sum(-1, keepdims=True)
        return np.where(np.isfinite(view.depth)[..., None], p[..., :K], 0).astype(np.float32)

    def _table(self) -> Float32[np.ndarray, "K+1 K+1"]:
        """Mean log odds by true class, the last being sky."""
        table = np.concatenate([AFFINITY, SKY[None]])
        table[:K, :K] += self.skill * np.eye(K, dtype=np.float32)
        table[:K, K] += self.nothing
        return table

    def _means(self, view: RenderedView, rng: np.random.Generator) -> Float32[np.ndarray, "H W K+1"]:
        """Share of each true class in what the network takes a pixel for: objects fade, borders move and blur."""
        import cv2

        shape = view.label.shape
        shift = self.border * patches(shape, 20.0, rng, 2)
        v, u = np.indices(shape, dtype=np.float32)
        moved = [
            cv2.remap(image, u + shift[..., 0], v + shift[..., 1], cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
            for image in (class_index(view.label), class_index(behind(view)), kept(view, self.small, rng))
        ]
        own, back, keep = np.eye(K + 1, dtype=np.float32)[moved[0]], np.eye(K + 1, dtype=np.float32)[moved[1]], moved[2]
        mixed = keep[..., None] * own + (1 - keep[..., None]) * back
        return cv2.GaussianBlur(mixed, (0, 0), max(0.5 * self.border, 0.3)).reshape(*shape, K + 1)

    def _errors(
        self, view: RenderedView, camera: Camera, number: int, seed: int, rng: np.random.Generator
    ) -> Float32[np.ndarray, "H W K+1"]:
        """Errors of the log odds: fixed to the world, and the picture's own, which grow where detail is lacking."""
        place, looks = (stream(seed, DENSE, key).integers(2**31).item() for key in (2, 5))
        lasting = lasting_field(view, self.world_patch, self.look, (place, looks), K + 1)
        passing = patches(view.label.shape, self.picture_patch, rng, K + 1)
        for object_id in np.unique(view.instance[view.instance > 0]):
            on = view.instance == object_id
            a, b = np.sqrt(self.whole), np.sqrt(1 - self.whole)
            lasting[on] = b * lasting[on] + a * stream(seed, DENSE, 3, int(object_id)).normal(size=K + 1)
            passing[on] = b * passing[on] + a * stream(seed, DENSE, 4, int(object_id), number).normal(size=K + 1)
        size = np.nan_to_num(footprint(view, camera), nan=self.reference)
        passing *= (np.clip(size / self.reference, 0.3, 8) ** self.far)[..., None]
        return (self.spread * (np.sqrt(self.sticky) * lasting + np.sqrt(1 - self.sticky) * passing)).astype(np.float32)


def class_index(label: UInt8[np.ndarray, "H W"]) -> UInt8[np.ndarray, "H W"]:
    """0..K-1, and K where there is no class (sky)."""
    return np.where((label >= 1) & (label <= K), label - 1, K).astype(np.uint8)


def behind(view: RenderedView) -> UInt8[np.ndarray, "H W"]:
    """The class image without its objects: each of their pixels takes the class of the nearest pixel beside them."""
    import cv2

    objects = view.instance > 0
    if not objects.any() or objects.all():
        return view.label
    _, nearest = cv2.distanceTransformWithLabels(
        objects.astype(np.uint8), cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_label = np.zeros(nearest.max() + 1, np.uint8)
    of_label[nearest[~objects]] = view.label[~objects]
    return of_label[nearest]


def object_sizes(view: RenderedView) -> Int64[np.ndarray, "n"]:
    """Pixels of every object id of the view."""
    return np.bincount(view.instance.ravel().clip(0))


def kept(view: RenderedView, small: float, rng: np.random.Generator) -> Float32[np.ndarray, "H W"]:
    """How much of each object survives the network's downsampling, 0..1: an even chance at ``small`` pixels."""
    size = object_sizes(view)
    doubt = rng.normal(size=len(size))
    share = 1 / (1 + np.exp(-(2.0 * np.log(np.maximum(size, 1) / small) + doubt))) if small > 0 else np.ones(len(size))
    share[0] = 1
    return share.astype(np.float32)[view.instance.clip(0)]
