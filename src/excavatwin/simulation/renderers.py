"""Two ways to take the same photo: our own tracer, which needs nothing, and Mitsuba, which looks real."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from excavatwin.errors import require
from excavatwin.scene.observations import Georeference
from excavatwin.scene.truth import Truth, ViewTruth
from excavatwin.simulation.camera import Camera
from excavatwin.simulation.conditions import Conditions
from excavatwin.simulation.render import EXPOSURE, RenderedView, pixel_rays, traced
from excavatwin.simulation.sensor import bucket_place, develop, dusty
from excavatwin.simulation.site import DigSite, contents
from excavatwin.simulation.truth import site_truth

NAMED = Sequence[tuple[str, Camera]]
LONG_SIDE = 640
"""Longest side of the class images in ``truth.npz`` [px]."""


@dataclass(frozen=True)
class Fast:
    """Numba: hard shadows, no bounce, porous shells for leaves; about a second a photo."""

    samples: int = 2
    """Rays per pixel along each axis."""
    conditions: Conditions = field(default_factory=Conditions)

    def __post_init__(self) -> None:
        require(self, "samples", 1, 8)

    def check(self) -> None:
        """Nothing can be missing."""

    def __call__(self, site: DigSite, camera: Camera) -> RenderedView:
        """Take a photo."""
        from excavatwin.kernels.ray_shading import SKY, SUN

        site = self.conditions.at(site)
        colour, view = traced(site, camera, self.samples)
        at = bucket_place(contents(site)) if self.conditions.dust else None
        if at is not None:
            rays = pixel_rays(camera) @ camera.T_M_cam[:3, :3].T
            falling = np.pi * (SUN * site.to_sun[2] + SKY)  # the tracer leaves pi out
            depth = view.depth.astype(float)
            colour = dusty(colour, camera, rays, depth, at, self.conditions.dust, falling)
        seed = (site.seed, *np.frombuffer(camera.T_M_cam.tobytes(), np.uint32).tolist())
        return replace(view, image=develop(colour, self.conditions, EXPOSURE, seed))

    def truth(self, site: DigSite, cameras: NAMED, georeference: Georeference | None) -> Truth:
        """The truth of the site and of its photos."""
        return site_truth(site, cameras, long_side=lattice_side(cameras), georeference=georeference)


@dataclass(frozen=True)
class Photoreal:
    """Mitsuba 3 (extra ``sim``): soft sun, sky, one bounce, leaves and blades."""

    samples: int = 16
    """Light rays per pixel."""
    conditions: Conditions = field(default_factory=Conditions)

    def __post_init__(self) -> None:
        require(self, "samples", 1, 1024)

    def check(self) -> None:
        """Say at once what is missing, before a site is built.

        Raises:
            MissingExtraError: Mitsuba or LLVM's library.
        """
        from excavatwin.simulation.photoreal.backend import backend

        backend()

    def __call__(self, site: DigSite, camera: Camera) -> RenderedView:
        """Take a photo.

        Raises:
            MissingExtraError: Mitsuba or LLVM's library is missing.
        """
        from excavatwin.simulation.photoreal import render

        return render(site, camera, self.samples, self.conditions)

    def truth(self, site: DigSite, cameras: NAMED, georeference: Georeference | None) -> Truth:
        """The truth of the site and of its photos: leaves are where the photos show them, not porous shells."""
        from excavatwin.simulation.photoreal import render, seen_from_above

        bare = site_truth(site, georeference=georeference)
        surface, label, instance = seen_from_above(site, bare.grid)
        side = lattice_side(cameras)
        views = tuple(
            ViewTruth(name, c.width, c.height, c.K_cam, c.T_M_cam, render(site, c.resized(side), samples=0).label)
            for name, c in cameras
        )
        return replace(bare, surface=surface, label=label, instance=instance, views=views)


Renderer = Fast | Photoreal
RENDERERS: dict[str, type[Fast] | type[Photoreal]] = {"fast": Fast, "photoreal": Photoreal}


def lattice_side(cameras: NAMED) -> int:
    """Width of the class images in ``truth.npz``: that of the photos, at most ``LONG_SIDE``."""
    return min([LONG_SIDE, *(camera.width for _, camera in cameras)])
