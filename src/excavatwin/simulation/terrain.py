"""The ground: rolling meadow on a slope, a work area of bare soil, pit, trench, spoil heap and gravel track."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Float32, Float64, UInt8

from excavatwin.kernels.noise import noise_raster
from excavatwin.scene.taxonomy import TaskClass


@dataclass(frozen=True)
class Ground:
    """Terrain vertices, row 0 south, and how far each lies inside the areas of each material."""

    height: Float32[np.ndarray, "Y X"]
    """[m, frame M]"""
    west: float
    south: float
    cell: float
    plane: Float64[np.ndarray, "3"]
    """The slope that the terrain fades into at the border and beyond it: z = a x + b y + c."""
    materials: Float32[np.ndarray, "Y X 3"]
    """Signed distance-like depth inside bare soil, freshly dug soil and gravel: positive inside [m]."""

    @cached_property
    def label(self) -> UInt8[np.ndarray, "Y X"]:
        """Task class of each vertex: bare and dug soil are construction terrain; meadow and gravel track are not."""
        soil, dug, gravel = np.moveaxis(self.materials > 0, -1, 0)
        diggable = dug | (soil & ~gravel)
        return np.where(diggable, TaskClass.CONSTRUCTION_TERRAIN, TaskClass.OTHER_TERRAIN).astype(np.uint8)


@dataclass(frozen=True)
class Pad:
    """A place that was levelled for something to stand on."""

    x: float
    y: float
    radius: float


def smoothstep(low: float, high: float, value: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """0 below ``low``, 1 above ``high``, smooth between; reversed bounds fall instead."""
    t = np.clip((value - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def local(
    x: Float[np.ndarray, "*n"], y: Float[np.ndarray, "*n"], centre: tuple[float, float], yaw: float
) -> tuple[Float[np.ndarray, "*n"], Float[np.ndarray, "*n"]]:
    """Coordinates along and across a direction ``yaw`` [deg] from ``centre``."""
    c, s = np.cos(np.deg2rad(yaw)), np.sin(np.deg2rad(yaw))
    dx, dy = x - centre[0], y - centre[1]
    return c * dx + s * dy, c * dy - s * dx


def inside_box(
    u: Float[np.ndarray, "*n"], v: Float[np.ndarray, "*n"], length: float, width: float, corner: float
) -> Float[np.ndarray, "*n"]:
    """Distance inside a rounded rectangle about the origin, negative outside [m]."""
    a, b = np.abs(u) - length / 2 + corner, np.abs(v) - width / 2 + corner
    outside = np.hypot(np.maximum(a, 0), np.maximum(b, 0)) + np.minimum(np.maximum(a, b), 0)
    return corner - outside


def inside_heap(
    u: Float[np.ndarray, "*n"], v: Float[np.ndarray, "*n"], ridge: float, reach: float
) -> Float[np.ndarray, "*n"]:
    """Distance inside the foot of material tipped along a ridge, negative outside; its top is rounded [m]."""
    distance = np.hypot(np.maximum(np.abs(u) - ridge / 2, 0), v)
    return reach - np.hypot(distance, 0.3) + 0.3


@dataclass(frozen=True)
class Earthworks:
    """Shape of the ground; positions in metres of frame M, whose origin is the site's centre."""

    slope: tuple[float, float] = (0.02, -0.015)
    """Fall of the whole site along x and y [m/m]."""
    relief: float = 0.3
    """Amplitude of the rolling meadow [m]."""
    roughness: float = 1.0
    """Scale of clods, ruts and turf; 0 makes the ground smooth."""
    area: tuple[float, float] = (10.5, 8.8)
    """Half axes of the work area of bare soil."""
    pit_at: tuple[float, float] = (2.8, 1.2)
    pit_yaw: float = 12.0
    """[deg]"""
    pit_size: tuple[float, float] = (6.0, 4.6)
    """Length and width at the top."""
    pit_depth: float = 1.6
    pit_wall: float = 72.0
    """Steepness of the walls [deg]."""
    trench_at: tuple[float, float] = (-4.6, -3.6)
    trench_yaw: float = 24.0
    trench_size: tuple[float, float] = (6.5, 1.3)
    trench_depth: float = 0.9
    heap_at: tuple[float, float] = (-4.6, 4.0)
    heap_yaw: float = -18.0
    heap_ridge: float = 2.2
    heap_height: float = 1.9
    repose: float = 35.0
    """Angle of repose [deg]."""
    track_at: float = 9.6
    """x of the gravel track where it passes the centre."""
    track_width: float = 3.4

    def ground(self, half: float, cell: float, pads: tuple[Pad, ...], seed: int) -> Ground:
        """Terrain on a square of half edge ``half`` about the origin."""
        count = int(round(2 * half / cell)) + 1
        axis = -half + cell * np.arange(count)
        x, y = axis[None, :], axis[:, None]
        plane = np.array([*self.slope, 0.0])
        border = smoothstep(half, half - 3, np.maximum(np.abs(x), np.abs(y)))
        z = self.relief * border * noise_raster(axis, axis, 11.0, 2.1, 0.4, 4, seed) + plane[0] * x + plane[1] * y
        quiet = np.ones_like(z)
        for pad in pads:
            near = smoothstep(pad.radius + 1.0, pad.radius + 0.1, np.hypot(x - pad.x, y - pad.y))
            col, row = int(round((pad.x + half) / cell)), int(round((pad.y + half) / cell))
            z += near * (z[row, col] - z)
            quiet *= 1 - near
        wobble = noise_raster(axis, axis, 2.2, 2.2, 0.5, 5, seed + 1)
        lumps = noise_raster(axis, axis, 0.5, 1.9, 0.62, 5, seed + 2)
        soil, dug, gravel, dig = self._areas(x, y, wobble)
        u, v = local(x, y, self.heap_at, self.heap_yaw)
        flank = np.tan(np.deg2rad(self.repose))
        tipped = inside_heap(u, v, self.heap_ridge, self.heap_height / flank)
        tip = flank * np.maximum(tipped, 0)
        z += tip - dig
        on_heap = smoothstep(0.0, 0.3, tip)
        rough = np.where(dug > 0, 0.022, np.where(gravel > 0, 0.008, np.where(soil > 0, 0.014, 0.012)))
        z += self.roughness * border * quiet * (rough * lumps + 0.05 * on_heap * wobble)
        z -= self.roughness * border * quiet * self._ruts(x, y, gravel)
        materials = np.stack(np.broadcast_arrays(soil, np.maximum(dug, tipped), gravel), -1).astype(np.float32)
        return Ground(z.astype(np.float32), -half, -half, cell, plane, materials)

    def _track(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Signed offset from the middle of the track, positive to the east [m]."""
        return x - self.track_at - 1.6 * np.sin(0.11 * y + 0.4) + 0.6

    def _ruts(self, x: np.ndarray, y: np.ndarray, gravel: np.ndarray) -> np.ndarray:
        """Depth of the two wheel ruts of the track [m]."""
        across = np.abs(self._track(x, y)) - 0.8
        return np.where(gravel > 0, 0.05 * np.exp(-((across / 0.22) ** 2)), 0)

    def _areas(
        self, x: np.ndarray, y: np.ndarray, wobble: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Depth inside soil, dug soil, gravel, and depth of the excavations [m]."""
        a, b = self.area
        blob = 1 - ((x / a) ** 4 + ((y + 0.3) / b) ** 4) ** 0.25
        soil = 8 * blob + 1.1 * wobble
        gravel = self.track_width / 2 - np.abs(self._track(x, y)) + 0.22 * wobble
        steep = np.tan(np.deg2rad(self.pit_wall))
        u, v = local(x, y, self.pit_at, self.pit_yaw)
        pit = inside_box(u, v, *self.pit_size, 0.8) + 0.12 * wobble
        u, v = local(x, y, self.trench_at, self.trench_yaw)
        trench = inside_box(u, v, *self.trench_size, 0.3) + 0.05 * wobble
        dig = np.maximum(np.clip(pit * steep, 0, self.pit_depth), np.clip(trench * steep, 0, self.trench_depth))
        return soil, np.maximum(pit + 0.15, trench + 0.12), gravel, dig
