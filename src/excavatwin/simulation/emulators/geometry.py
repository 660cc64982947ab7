"""Geometry as a frozen multi-view network delivers it: right in shape, wrong in frame, scale, detail and edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float32, Float64

from excavatwin.errors import InputError, require
from excavatwin.scene.frames import invert_rigid, transform
from excavatwin.scene.observations import Observations, View
from excavatwin.scene.taxonomy import K
from excavatwin.simulation.camera import Camera
from excavatwin.simulation.emulators.fields import anchored, spread, stream
from excavatwin.simulation.render import RenderedView, pixel_rays

GEOMETRY = 0x6E0
"""Key of the random streams of this stage; others use others, so that the same seed gives independent errors."""


@dataclass(frozen=True)
class Exact:
    """True geometry in frame M, with gravity and scale declared: the oracle's."""

    def __call__(self, views: Sequence[RenderedView], cameras: Sequence[Camera], seed: int = 0) -> Observations:
        """Observations without evidence; nothing is drawn."""
        made = tuple(
            observed(number, camera, view.points, np.where(np.isfinite(view.depth), 8.0, 0.0), camera.T_M_cam)
            for number, (view, camera) in enumerate(zip(views, cameras, strict=True))
        )
        return Observations(
            made, np.array([0, 0, 1.0]), 1.0, source={"reconstructor": "simulation: true geometry"},
        )  # fmt: skip


@dataclass(frozen=True)
class VggtLike:
    """Point maps, poses and confidence with the errors of VGGT (Wang et al., CVPR 2025; paper key ``vggt``).

    Magnitudes are chosen so that one world point, seen in two views, lies about 0.4 % of its distance apart, and so
    that the elevation error has the size that the paper reports with VGGT on OCES (12.6 cm at some 30 m,
    tab:geometry_accuracy). Every error is zero when its field is zero.
    """

    scale_spread: float = 0.2
    """Spread (log) of the size of the scene about "mean distance of the points from the first camera = 1", the
    normalisation that VGGT is trained with and meets approximately."""
    rotation: float = 0.2
    """Angle by which a camera's pose is turned about the place it looks at, root mean square over views [deg].
    Pose errors of a multi-view network are correlated like this: the scene in the middle of the picture stays, the
    camera moves. 0.2 deg moves it by 0.35 % of its distance."""
    translation: float = 0.001
    """What is left of the position error besides, root mean square, relative to the distance of the scene."""
    focal: float = 0.002
    """Relative error of each view's focal length, standard deviation: VGGT predicts it per view."""
    depth_warp: float = 0.0025
    """Smooth relative depth error of each view, standard deviation; its wavelength is a third of the picture, and its
    mean is that view's own scale error. Different in every view: this is what views disagree by."""
    bend: float = 0.002
    """Height by which the whole reconstruction is bent, relative to the distance of the scene, standard deviation:
    smooth over ``bend_length`` and the same in every view, so that no fusion removes it (doming)."""
    bend_length: float = 25.0
    """Wavelength of the bend [m]."""
    noise: float = 0.001
    """Relative depth noise at the scene's median distance, standard deviation; grows in proportion to the distance.
    Correlated over about 2 px, as the output of an upsampling head is."""
    edge: float = 1.5
    """Reach of the trouble at depth edges [px]. The foreground's depth spreads over up to this many pixels of the
    background (halo), and depth runs smoothly from one to the other (flying pixels): the head is convolutional, it
    draws no steps."""
    edge_jump: float = 0.03
    """Relative depth step between neighbours two pixels apart that counts as an edge."""
    reach: float = 5.0
    """Pixels deeper than this many median depths have no point: towards the horizon the confidence is nil."""
    confidence_correlation: float = 0.6
    """Correlation, 0..1, of log confidence with minus the log of the depth error around the pixel: VGGT's confidence
    is trained as an aleatoric weight; it knows edges and distance, and ranks errors only loosely."""
    vertical_compression: float = 1.0
    """Heights about the mean plane are divided by this; 1 = none. Oblique clips with little parallax come out
    flattened (7.9 measured on one); the points slide along their rays, so that they keep their pixels."""
    declare_scale: float | None = None
    """Relative standard error with which ``metres_per_unit`` is told, as after measuring one object of known size;
    None: not told, as VGGT."""
    declare_up: float | None = None
    """Standard error of the direction in which ``up`` is told [deg]; None: not told, as VGGT."""

    def __post_init__(self) -> None:
        for name in ("scale_spread", "rotation", "translation", "focal", "depth_warp", "bend", "noise", "edge"):
            require(self, name, 0.0)
        for name in ("bend_length", "edge_jump", "reach", "vertical_compression"):
            require(self, name, 0.0, open_low=True)
        require(self, "confidence_correlation", 0.0, 1.0)
        require(self, "declare_scale", 0.0)
        require(self, "declare_up", 0.0)

    def __call__(self, views: Sequence[RenderedView], cameras: Sequence[Camera], seed: int = 0) -> Observations:
        """Observations without evidence in the first camera's frame.

        Args:
            views: the true views.
            cameras: their true cameras.
            seed: of all errors.

        Raises:
            InputError: there is no view, or no view shows anything.
        """
        if not any(np.isfinite(view.depth).any() for view in views):
            raise InputError("no view shows any surface; the cameras must look at the site.")
        rng = stream(seed, GEOMETRY)
        distance = float(np.median(np.concatenate([view.depth[np.isfinite(view.depth)] for view in views])))
        made = [self._view(i, view, cameras[i], distance, seed) for i, view in enumerate(views)]
        T_R_M, unit = self._frame(made, cameras[0], rng)
        moved = tuple(in_frame(view, T_R_M, unit) for view in made)
        up = None
        if self.declare_up is not None:
            up = T_R_M[:3, 2] + np.deg2rad(self.declare_up) * rng.normal(size=3)
            up /= np.linalg.norm(up)
        told = None if self.declare_scale is None else unit * float(np.exp(self.declare_scale * rng.normal()))
        return Observations(moved, up, told, source={"reconstructor": f"emulator: {self!r}", "seed": str(seed)})

    def _frame(
        self, made: Sequence[View], first: Camera, rng: np.random.Generator
    ) -> tuple[Float64[np.ndarray, "4 4"], float]:
        """(rigid part of R from M, metres per unit): the first camera's axes, mean distance about 1."""
        T_R_M = invert_rigid(first.T_M_cam)
        lengths = np.concatenate([np.linalg.norm(v.points - first.T_M_cam[:3, 3], axis=-1).ravel() for v in made])
        return T_R_M, float(np.nanmean(lengths) * np.exp(self.scale_spread * rng.normal()))

    def _view(self, number: int, true: RenderedView, camera: Camera, distance: float, seed: int) -> View:
        """One view with all its errors, still in frame M."""
        rng = stream(seed, GEOMETRY, 1 + number)
        T_M_cam = self._pose(camera, distance, rng) if number else camera.T_M_cam
        seen_as = replace(camera, focal=camera.focal * float(np.exp(self.focal * rng.normal())), T_M_cam=T_M_cam)
        depth = np.where(true.depth <= self.reach * distance, true.depth, np.nan).astype(np.float32)
        depth = depth * self._lift(true, camera, distance, seed)
        wanted = depth
        depth = self._edges(depth, rng)
        warp = self.depth_warp * spread(depth.shape, depth.shape[1] / 3, rng)
        depth = depth * np.exp(warp + self.noise * depth / distance * grain(depth.shape, rng))
        points = T_M_cam[:3, 3] + depth[..., None] * (pixel_rays(seen_as) @ T_M_cam[:3, :3].T)
        confidence = self._confidence(np.abs(depth / wanted - 1), rng)
        return observed(number, seen_as, points, confidence, T_M_cam)

    def _pose(self, camera: Camera, distance: float, rng: np.random.Generator) -> Float64[np.ndarray, "4 4"]:
        """The camera turned about the place that it looks at, and shifted a little."""
        from cv2 import Rodrigues

        turn, _ = Rodrigues(np.deg2rad(self.rotation) / np.sqrt(3) * rng.normal(size=3))
        pivot = camera.T_M_cam[:3, 3] + distance * camera.T_M_cam[:3, 2]
        T = np.eye(4)
        T[:3, :3] = turn @ camera.T_M_cam[:3, :3]
        T[:3, 3] = pivot + turn @ (camera.T_M_cam[:3, 3] - pivot)
        T[:3, 3] += self.translation * distance / np.sqrt(3) * rng.normal(size=3)
        return T

    def _lift(
        self, true: RenderedView, camera: Camera, distance: float, seed: int
    ) -> Float32[np.ndarray, "H W"] | float:
        """Factor on the depth that takes each point along its ray to its bent and compressed height."""
        if self.bend == 0 and self.vertical_compression == 1:
            return 1.0
        ground = np.where(np.isfinite(true.points), true.points, np.float32(0))
        ground[..., 2] = 0
        z = true.points[..., 2]
        target = z / self.vertical_compression + self.bend * distance * anchored(ground, self.bend_length, seed)[..., 0]
        drop = z - camera.T_M_cam[2, 3]
        level = np.abs(drop) < 0.1 * distance  # near the horizon a ray meets no other height nearby
        return np.where(level, 1.0, np.clip((target - camera.T_M_cam[2, 3]) / np.where(level, 1, drop), 0.5, 2.0))

    def _edges(self, depth: Float32[np.ndarray, "H W"], rng: np.random.Generator) -> Float32[np.ndarray, "H W"]:
        """Halos and flying pixels along depth edges."""
        import cv2

        if self.edge == 0:
            return depth
        seen = np.isfinite(depth)
        filled = np.where(seen, depth, 1.5 * np.nanpercentile(depth, 95)).astype(np.float32)
        near, far = cv2.erode(filled, np.ones((3, 3))), cv2.dilate(filled, np.ones((3, 3)))
        band = grown(far > (1 + self.edge_jump) * near, self.edge)
        size = 2 * round(self.edge) + 1
        halo = spread(depth.shape, 12.0, rng) > 0  # half of all outlines grow, piece by piece
        shifted = np.where(halo & band, cv2.erode(filled, np.ones((size, size))), filled)
        flying = cv2.GaussianBlur(shifted, (0, 0), 0.5 * self.edge)
        return np.where(seen, np.where(band, flying, depth), np.nan).astype(np.float32)

    def _confidence(self, error: Float32[np.ndarray, "H W"], rng: np.random.Generator) -> Float32[np.ndarray, "H W"]:
        """1 + exp(.), as VGGT's head: high where the error is small, mostly."""
        import cv2

        rho = self.confidence_correlation
        drawn = spread(error.shape, 25.0, rng)
        seen = np.isfinite(error)
        around = cv2.blur(np.where(seen, error, 0), (5, 5)) / np.maximum(
            cv2.blur(seen.astype(np.float32), (5, 5)), 1e-6
        )
        log_error = np.log(np.maximum(around, 1e-6))
        middle, width = (np.mean(log_error[seen]), np.std(log_error[seen])) if seen.any() else (0.0, 0.0)
        ranked = (log_error - middle) / max(float(width), 1e-6)
        u = np.sqrt(1 - rho**2) * drawn - rho * np.where(seen, ranked, 0)
        return np.where(seen, 1 + np.exp(1.5 + 0.8 * np.clip(u, -4, 3)), 1.0).astype(np.float32)


def observed(
    number: int,
    camera: Camera,
    points: Float64[np.ndarray, "H W 3"],
    confidence: Float64[np.ndarray, "H W"],
    T_R_cam: Float64[np.ndarray, "4 4"],
) -> View:
    """A view without evidence."""
    return View(
        name=f"view_{number:03d}",
        points=points.astype(np.float32),
        confidence=confidence.astype(np.float32),
        evidence=np.zeros((*points.shape[:2], K), np.float32),
        T_R_cam=np.array(T_R_cam),
        K_cam=camera.K_cam,
    )


def in_frame(view: View, T_R_M: Float64[np.ndarray, "4 4"], unit: float) -> View:
    """The view in frame R = (rigid motion of M) / unit."""
    T_R_cam = T_R_M @ view.T_R_cam
    T_R_cam[:3, 3] /= unit
    points = transform(T_R_M, view.points.astype(np.float64)) / unit
    return replace(view, points=points.astype(np.float32), T_R_cam=T_R_cam)


def grown(mask: Bool[np.ndarray, "H W"], reach: float) -> Bool[np.ndarray, "H W"]:
    """The mask with everything within ``reach`` pixels of it."""
    import cv2

    return cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5) <= reach - 0.5


def grain(shape: tuple[int, int], rng: np.random.Generator) -> Float32[np.ndarray, "H W"]:
    """Gaussian noise of unit standard deviation, correlated over about two pixels."""
    import cv2

    blurred = cv2.GaussianBlur(rng.normal(size=shape).astype(np.float32), (0, 0), 1.0)
    return blurred * np.float32(2 * np.sqrt(np.pi))  # std of white noise after a Gaussian of sigma s: 1 / (2 s sqrt pi)
