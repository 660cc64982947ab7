"""Earthworks as a list: any number of cuts and heaps, a track, gravel pads, on a rolling meadow with bare soil.

Height = natural ground (levelled where something stands) + heaps - cuts, and the roughness of the natural ground does
not know of either. Two sites that differ in a cut or a heap therefore differ there and nowhere else, to the last bit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from excavatwin.kernels.noise import noise_raster
from excavatwin.simulation.terrain import Ground, Pad, inside_box, inside_heap, local, smoothstep

FOOT, RIM = 0.18, 0.08
"""Half width over which the foot of a heap and the rim of a cut wander [m]."""
AROUND = 3.0
"""Margin about cuts and heaps in which the distance to them is known [m]."""
CLODS = 0.07
"""Amplitude of the clods on freshly moved soil [m]."""


@dataclass(frozen=True)
class Cut:
    """A pit or a trench: a rounded rectangle with sloping walls and a level floor."""

    at: tuple[float, float]
    """Centre [m]."""
    yaw: float
    """Direction of its length [deg]."""
    size: tuple[float, float]
    """Length and width at the top [m]."""
    depth: float
    """Of the floor below the natural ground at its datum [m]."""
    wall: float = 70.0
    """Steepness of the walls [deg]."""
    corner: float = 0.4
    """Radius of the corners [m]."""
    datum: tuple[float, float] | None = None
    """Where the depth is measured, if not at the centre: a cut that is lengthened keeps its floor."""

    def inside(self, x: np.ndarray, y: np.ndarray, wobble: np.ndarray | float = 0.0) -> np.ndarray:
        """Distance inside its upper edge, negative outside [m]."""
        u, v = local(x, y, self.at, self.yaw)
        return inside_box(u, v, *self.size, self.corner) + RIM * wobble

    def taken(self, natural: np.ndarray, floor: float, inside: np.ndarray) -> np.ndarray:
        """Height of soil taken away [m], given the natural ground and the elevation of the floor."""
        steep = np.tan(np.deg2rad(self.wall))
        return np.clip(inside * steep, 0, np.maximum(natural - floor, 0))


@dataclass(frozen=True)
class Heap:
    """Soil tipped along a ridge, at its angle of repose."""

    at: tuple[float, float]
    """Middle of the ridge [m]."""
    yaw: float
    """Direction of the ridge [deg]."""
    ridge: float
    """Length of the ridge; 0 makes a cone [m]."""
    height: float
    """Of the ridge above the natural ground, but for clods [m]."""
    repose: float = 35.0
    """Angle of repose [deg]."""

    @property
    def reach(self) -> float:
        """Horizontal distance from the ridge to the foot [m]."""
        return self.height / np.tan(np.deg2rad(self.repose))

    def inside(self, x: np.ndarray, y: np.ndarray, wobble: np.ndarray | float = 0.0) -> np.ndarray:
        """Distance inside its foot, negative outside [m]."""
        u, v = local(x, y, self.at, self.yaw)
        return inside_heap(u, v, self.ridge, self.reach) + FOOT * wobble

    def added(self, inside: np.ndarray, wobble: np.ndarray | float = 0.0) -> np.ndarray:
        """Height of soil laid on the ground [m]; it grows with ``height`` everywhere, as clods fade in slowly."""
        tip = np.tan(np.deg2rad(self.repose)) * np.maximum(inside, 0)
        return tip + CLODS * smoothstep(0.0, 0.4, tip) * wobble


@dataclass(frozen=True)
class Track:
    """A gravel track that bends across the site."""

    offset: float
    """Of its middle from the site's centre, to the left of its direction [m]."""
    yaw: float
    """[deg]"""
    width: float = 3.4
    bend: float = 1.5
    """Amplitude of its bends [m]."""
    phase: float = 0.0
    """Of its bends [rad]."""

    def across(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Signed offset from its middle [m]."""
        u, v = local(x, y, (0.0, 0.0), self.yaw)
        return v - self.offset - self.bend * np.sin(0.11 * u + self.phase)


@dataclass(frozen=True)
class GravelPad:
    """A rectangle of gravel, to park and to store on."""

    at: tuple[float, float]
    yaw: float
    """[deg]"""
    size: tuple[float, float]
    """Length and width [m]."""


@dataclass(frozen=True, eq=False)
class Layers:
    """What the ground's height is the sum of, at the places that were asked for [m]."""

    natural: Float64[np.ndarray, "Y X"]
    """Meadow, slope and levelled places, without roughness."""
    rough: Float64[np.ndarray, "Y X"]
    """Turf, clods of bare soil, ruts: the same whatever is dug."""
    added: Float64[np.ndarray, "Y X"]
    taken: Float64[np.ndarray, "Y X"]
    soil: Float64[np.ndarray, "Y X"]
    """Distance inside the work area; the next two likewise."""
    dug: Float64[np.ndarray, "Y X"]
    gravel: Float64[np.ndarray, "Y X"]


def window(
    xs: Float64[np.ndarray, "X"], ys: Float64[np.ndarray, "Y"], at: tuple[float, float], reach: float
) -> tuple[slice, slice]:
    """Rows and columns of two ascending axes within ``reach`` of a place."""
    rows, cols = (np.searchsorted(axis, (c - reach, c + reach)) for axis, c in ((ys, at[1]), (xs, at[0])))
    return slice(int(rows[0]), int(rows[1])), slice(int(cols[0]), int(cols[1]))


@dataclass(frozen=True)
class Worksite:
    """Shape of the ground; positions in metres of frame M, whose origin is the site's centre."""

    slope: tuple[float, float] = (0.0, 0.0)
    """Fall of the whole site along x and y [m/m]."""
    relief: float = 0.3
    """Amplitude of the rolling meadow [m]."""
    swell: float = 11.0
    """Longest wavelength of the rolling meadow [m]."""
    roughness: float = 1.0
    """Scale of clods, ruts and turf; 0 makes the ground smooth."""
    area_at: tuple[float, float] = (0.0, 0.0)
    """Centre of the work area of bare soil."""
    area_yaw: float = 0.0
    """[deg]"""
    area: tuple[float, float] = (10.5, 8.8)
    """Half axes of the work area."""
    area_power: float = 4.0
    """Exponent of its outline: 2 is an ellipse, larger ones tend to a rectangle."""
    cuts: tuple[Cut, ...] = ()
    heaps: tuple[Heap, ...] = ()
    track: Track | None = None
    gravel_pads: tuple[GravelPad, ...] = ()
    levelled: tuple[Pad, ...] = ()
    """Places that are level besides those of the objects: where something stands in another epoch."""

    def ground(self, half: float, cell: float, pads: tuple[Pad, ...], seed: int) -> Ground:
        """Terrain on a square of half edge ``half`` about the origin."""
        count = int(round(2 * half / cell)) + 1
        axis = -half + cell * np.arange(count)
        parts = self.layers(axis, axis, half, pads, seed)
        height = (parts.natural + parts.rough) + (parts.added - parts.taken)
        materials = np.stack([parts.soil, parts.dug, parts.gravel], -1).astype(np.float32)
        plane = np.array([*self.slope, 0.0])
        return Ground(height.astype(np.float32), -half, -half, cell, plane, materials)

    def layers(
        self,
        xs: Float64[np.ndarray, "X"],
        ys: Float64[np.ndarray, "Y"],
        half: float,
        pads: tuple[Pad, ...],
        seed: int,
    ) -> Layers:
        """The parts of the terrain at every (x, y) of two axes.

        Args:
            half: the relief fades into the slope within 3 m of this distance from the origin [m].
            pads: places to level, with ``levelled``; their order does not matter.
        """
        x, y = xs[None, :], ys[:, None]
        border = smoothstep(half, half - 3, np.maximum(np.abs(x), np.abs(y)))
        natural, quiet = self._natural(xs, ys, half, pads, seed)
        wobble = self.wobble(xs, ys, seed)
        lumps = noise_raster(xs, ys, 0.5, 1.9, 0.62, 5, seed + 2).astype(float)
        soil, gravel = self.soil_depth(x, y) + 1.1 * wobble, self.gravel_depth(x, y) + 0.22 * wobble
        grain = np.where(gravel > 0, 0.008, np.where(soil > 0, 0.014, 0.012))
        rough = self.roughness * border * quiet * (grain * lumps - self._ruts(x, y))
        added, taken = np.zeros_like(natural), np.zeros_like(natural)
        dug = np.full_like(natural, -AROUND)
        clods = self.roughness * wobble
        for heap in self.heaps:
            near = window(xs, ys, heap.at, heap.ridge / 2 + heap.reach + AROUND)
            inside = heap.inside(x[:, near[1]], y[near[0]], clods[near])
            added[near] = np.maximum(added[near], heap.added(inside, clods[near]))
            dug[near] = np.maximum(dug[near], inside)
        for cut in self.cuts:
            near = window(xs, ys, cut.at, float(np.hypot(*cut.size)) / 2 + AROUND)
            inside = cut.inside(x[:, near[1]], y[near[0]], clods[near])
            floor = self.floor(cut, half, pads, seed)
            taken[near] = np.maximum(taken[near], cut.taken(natural[near], floor, inside))
            dug[near] = np.maximum(dug[near], inside + 0.15)
        return Layers(natural, rough, added, taken, soil, dug, gravel)

    @staticmethod
    def wobble(xs: Float64[np.ndarray, "X"], ys: Float64[np.ndarray, "Y"], seed: int) -> Float64[np.ndarray, "Y X"]:
        """Noise of metres and less, about -1..1, that makes outlines ragged and moved soil lumpy."""
        return noise_raster(xs, ys, 2.2, 2.2, 0.5, 5, seed + 1).astype(float)

    def floor(self, cut: Cut, half: float, pads: tuple[Pad, ...], seed: int) -> float:
        """Elevation of the floor of a cut [m]."""
        at = np.array(cut.datum or cut.at, float)
        natural, _ = self._natural(at[:1], at[1:], half, pads, seed)
        return float(natural[0, 0]) - cut.depth

    def _natural(
        self, xs: np.ndarray, ys: np.ndarray, half: float, pads: tuple[Pad, ...], seed: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Meadow and slope with levelled places, and how much of the roughness these leave (0..1).

        A place within a pad takes the height of its middle; where surroundings of pads overlap, the nearer counts more.
        """
        z = self._meadow(xs, ys, half, seed)
        weight, quiet = np.ones_like(z), np.ones_like(z)
        for px, py, radius in sorted({(p.x, p.y, p.radius) for p in (*pads, *self.levelled)}):
            near = window(xs, ys, (px, py), radius + 1.0)
            distance = np.hypot(xs[None, near[1]] - px, ys[near[0], None] - py)
            level = smoothstep(radius + 1.0, radius + 0.1, distance)
            pull = level / (1 - level + 1e-6)
            z[near] += pull * self._meadow(np.array([px]), np.array([py]), half, seed)
            weight[near] += pull
            quiet[near] *= 1 - level
        return z / weight, quiet

    def _meadow(self, xs: np.ndarray, ys: np.ndarray, half: float, seed: int) -> np.ndarray:
        """Rolling ground on the slope [m]."""
        x, y = xs[None, :], ys[:, None]
        border = smoothstep(half, half - 3, np.maximum(np.abs(x), np.abs(y)))
        rolling = noise_raster(xs.astype(float), ys.astype(float), self.swell, 2.1, 0.4, 4, seed).astype(float)
        return self.relief * border * rolling + self.slope[0] * x + self.slope[1] * y

    def soil_depth(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Distance inside the smooth outline of the work area, about [m]."""
        u, v = local(x, y, self.area_at, self.area_yaw)
        a, b = self.area
        radius = (np.abs(u / a) ** self.area_power + np.abs(v / b) ** self.area_power) ** (1 / self.area_power)
        return min(a, b) * (1 - radius)

    def gravel_depth(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Distance inside the smooth outline of track and gravel pads [m]."""
        inside = np.full(np.broadcast_shapes(x.shape, y.shape), -100.0)
        if self.track is not None:
            inside = np.maximum(inside, self.track.width / 2 - np.abs(self.track.across(x, y)))
        for pad in self.gravel_pads:
            u, v = local(x, y, pad.at, pad.yaw)
            inside = np.maximum(inside, inside_box(u, v, *pad.size, 0.6))
        return inside

    def _ruts(self, x: np.ndarray, y: np.ndarray) -> np.ndarray | float:
        """Depth of the two wheel ruts of the track [m]."""
        if self.track is None:
            return 0.0
        across = np.abs(self.track.across(x, y)) - 0.8
        return 0.05 * np.exp(-((across / 0.22) ** 2))
