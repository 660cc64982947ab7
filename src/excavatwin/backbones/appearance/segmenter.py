"""The segmenter: cues of a photo weighed into evidence for the five task classes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from jaxtyping import Float32

import excavatwin
from excavatwin.backbones.cards import Card, Tried
from excavatwin.backbones.protocols import Picture, Segmentation
from excavatwin.errors import InputError
from excavatwin.scene.taxonomy import K, TaskClass

if TYPE_CHECKING:
    from excavatwin.backbones.appearance.cues import Cues


@dataclass(frozen=True)
class Appearance:
    """Training-free baseline: what colour and texture alone can tell, and no more.

    It knows vegetation by its greenness, turf from crowns by their texture, soil from pavement by warmth and
    roughness, machine paint by a yellow or orange beside dark and grey parts, and other man-made things by colours
    that soil and plants do not have. It does *not* know what things are: a lemon on sand looks like machine paint, a
    chalky patch in a meadow like an obstacle, a grey-brown roof like gravel. Where two classes look alike it splits
    its evidence, and where nothing speaks clearly it gives little. Wrong objects on flat ground are removed by the
    geometry that follows; a missed object is lost, so it leans towards objects. A learned segmenter replaces it by
    giving observations with another evidence.

    All colour cues are ratios and all brightness cues relative to the surroundings, so that exposure and vignetting
    matter little. Thresholds were set by eye on photos of seven public sets (nadir and oblique, overcast and sunny).
    """

    card: ClassVar[Card] = Card(
        name="appearance",
        kind="segmenter",
        summary="colour, texture and vegetation indices; without weights, knows materials but not things",
        tried=Tried.BUILT_IN,
    )

    work_side: int = 640
    """Long side at which the cues are computed; larger photos are shrunk, evidence is interpolated back [px]."""
    green: tuple[float, float] = (0.022, 0.055)
    """Green leaf index (2G-R-B)/(2G+R+B) above that of the neutral ground: from no to certain vegetation."""
    crown_texture: tuple[float, float] = (0.1, 0.19)
    """Local standard deviation of log luminance: from mown turf to bushes and crowns."""
    soil_warmth: tuple[float, float] = (0.0, 0.07)
    """(R-B)/(R+G+B): from grey pavement to soil."""
    soil_texture: tuple[float, float] = (0.07, 0.16)
    """Local standard deviation of log luminance: from a rolled surface to loose soil."""
    cool: tuple[float, float] = (0.012, 0.045)
    """(B-R)/(R+G+B): from neutral ground to galvanised, painted or concrete things under the sky."""
    bright: tuple[float, float] = (0.45, 0.8)
    """Log luminance above the surroundings: from ground to white things."""
    sky: bool = True
    """Look for sky and water. Without it nothing is abstained on."""

    def identity(self) -> str:
        """The version of ExcavaTwin: there is nothing else."""
        return excavatwin.__version__

    def __call__(self, picture: Picture) -> Segmentation:
        """Evidence (H, W, 5) in id order 1..5 and the no-surface mask (H, W) of an sRGB photo.

        Raises:
            InputError: the image is not (H, W, 3) uint8.
        """
        from excavatwin.backbones.appearance.cues import observe, resized
        from excavatwin.backbones.appearance.surfaceless import find_sky, find_water

        image = picture.image
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
            raise InputError(f"the segmenter needs an RGB image (H, W, 3) uint8, not {image.shape} {image.dtype}.")
        height, width = image.shape[:2]
        scale = min(1.0, self.work_side / max(height, width))
        small = resized(image, max(1, round(width * scale)), max(1, round(height * scale)))
        cues = observe(small)
        none = find_sky(cues) | find_water(cues) if self.sky else np.zeros(cues.shape, bool)
        evidence = self._weigh(cues)
        evidence[none] = 0
        if scale < 1:
            evidence = np.clip(resized(evidence, width, height), 0, 1)
            none = resized(none.astype(np.uint8), width, height, exact=True) > 0
            evidence[none] = 0
        return Segmentation(evidence, none)

    def _weigh(self, cues: Cues) -> Float32[np.ndarray, "H W K"]:
        from excavatwin.backbones.appearance.cues import islands, ramp, surroundings

        machine = np.maximum(cues.paint, cues.near_paint)
        plant = ramp(cues.green, *self.green) * cues.plant_hue
        crown = ramp(cues.texture, *self.crown_texture)
        thicket = surroundings(plant * crown)  # among crowns, dark and bluish is shade and haze
        shade = ramp(-cues.relative, 0.1, 0.9)
        haze = ramp(cues.chroma, 0.06, 0.09) * ramp(cues.green, 0.02, 0.05)
        steel = ramp(-cues.warmth, *self.cool) * ramp(cues.relative - 0.6 * thicket, -0.7, -0.1) * (1 - haze)
        white = ramp(cues.relative, *self.bright) * ramp(-cues.chroma, -0.12, -0.07)
        above = np.log(cues.luminance / np.median(cues.luminance))  # a field of white things is its own surroundings
        dazzling = ramp(above, 0.55, 0.8) * ramp(-cues.warmth, -0.04, -0.015)
        grey = ramp(-cues.odd_warmth, 0.04, 0.07) * ramp(-cues.chroma, -0.045, -0.025) * ramp(cues.relative, 0.0, 0.12)
        bare = (plant < 0.35) & (cues.warmth < 0.09)  # roofs and rocks, not patches of dry grass
        island = islands(bare, largest=0.012, fill=0.4) * (1 - ramp(thicket, 0.3, 0.6)) * (1 - shade)
        island = np.maximum(island, islands(grey * (1 - plant) > 0.5, largest=0.03, fill=0.42, smallest=8e-4))
        signs = [steel, 0.6 * white, 0.75 * dazzling, 0.65 * island]
        thing = np.maximum.reduce([cues.vivid, (1 - plant) * np.maximum.reduce(signs)])
        thing = thing * (1 - machine)
        rest = 1 - machine - thing
        plant = plant * rest
        ground = (rest - plant) * (1 - 0.65 * ramp(shade, 0.8, 1.0))
        warmth = cues.warmth + 0.045 * shade  # the sky alone lights the shade, and it is blue
        soil = np.clip(ramp(warmth, *self.soil_warmth) + 0.35 * ramp(cues.texture, *self.soil_texture), 0, 1)
        share = {
            TaskClass.CONSTRUCTION_TERRAIN: 0.8 * ground * soil,
            TaskClass.OTHER_TERRAIN: 0.8 * ground * (1 - soil) + 0.52 * plant * (1 - crown),
            TaskClass.REMOVABLE_COVER: plant * (0.46 + 0.44 * crown),
            TaskClass.EXCAVATOR: 0.9 * machine,
            TaskClass.OBSTACLE: 0.85 * thing,
        }
        evidence = np.empty((*cues.shape, K), np.float32)
        for task_class, weight in share.items():
            evidence[..., task_class - 1] = weight
        return evidence
