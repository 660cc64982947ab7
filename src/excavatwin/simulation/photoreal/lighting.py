"""The light on what a camera sees: soft sun, sky and one bounce, by Mitsuba's ray tracing (Monte Carlo).

The picture is rendered as irradiance, apart from the colour of things: irradiance is smooth and can be filtered, colour
has all the detail and needs no light. ``photo`` multiplies them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64, UInt32

from excavatwin.simulation.camera import Camera
from excavatwin.simulation.photoreal.backend import backend, vectors
from excavatwin.simulation.photoreal.sky import SUN_ANGLE, TABLE, Daylight
from excavatwin.simulation.photoreal.stage import Stage

THROUGH = 0.4
"""Light that comes through a leaf, over that which it reflects."""
SHININESS = 90.0
"""Exponent of the sun's highlight on a clear coat (Blinn and Phong, normalised)."""
AROUND_EVERY = 2
"""Samples of which one looks around, the others only to the sun: what comes from around is filtered afterwards."""
NOTHING = 0xFFFFFFFF
"""Triangle of a ray that meets nothing."""


@dataclass(frozen=True, eq=False)
class Hits:
    """What rays met first, one row a ray."""

    t: Float64[np.ndarray, "n"]
    """Ray parameter; inf where there is nothing."""
    triangle: UInt32[np.ndarray, "n"]
    """``NOTHING`` where there is nothing."""
    normal: Float32[np.ndarray, "n 3"]
    """For shading, turned against the ray, frame M."""


@dataclass(frozen=True, eq=False)
class Sample:
    """One ray through every pixel and the light found where it ends, one row a pixel."""

    place: Float32[np.ndarray, "n 3"]
    """Frame M [m]."""
    triangle: UInt32[np.ndarray, "n"]
    sun: Float32[np.ndarray, "n"]
    """Cosine times visibility of the sun."""
    around: Float32[np.ndarray, "n 3"]
    """Irradiance from sky and surroundings; zero in samples that do not look around."""
    gloss: Float32[np.ndarray, "n 3"]
    """Radiance mirrored by a clear coat, and that of the sky itself where nothing was met."""


def first_hits(stage: Stage, origin: Float64[np.ndarray, "n 3"], rays: Float64[np.ndarray, "n 3"]) -> Hits:
    """What rays meet; their parameter counts lengths of ``rays``, which need not be 1."""
    mi, dr = backend()
    length = np.linalg.norm(rays, axis=1)
    d = vectors(rays / length[:, None])
    si = stage.scene.ray_intersect(mi.Ray3f(mi.Point3f(vectors(np.broadcast_to(origin, rays.shape))), d))
    triangle = dr.select(si.is_valid(), si.prim_index, mi.UInt32(NOTHING))
    normal = facing(si.sh_frame.n, d)
    return Hits(np.array(si.t, np.float64) / length, np.array(triangle), np.array(normal, np.float32).T)


def facing(n: Any, d: Any) -> Any:
    """A normal turned against a ray."""
    dr = backend().dr
    return dr.select(dr.dot(n, d) > 0, -n, n)


def sample_light(stage: Stage, daylight: Daylight, camera: Camera, number: int, seed: int) -> Sample:
    """Follow one ray through every pixel, to the sun, and once around.

    Args:
        number: of the sample within the picture; samples of one picture spread evenly over the pixel and over the sky.
        seed: of the picture.
    """
    mi, dr = backend()
    count = camera.width * camera.height
    pixel = dr.arange(mi.UInt32, count)
    d = _through(camera, pixel, *even(number))
    si = stage.scene.ray_intersect(mi.Ray3f(_point(camera.T_M_cam[:3, 3]), d))
    valid = si.is_valid()
    n = facing(si.sh_frame.n, d)
    owner = dr.gather(mi.UInt32, stage.owner_of, si.prim_index, valid)
    leafy = dr.gather(mi.Float, stage.leafy, owner, valid)
    random = mi.PCG32(initstate=dr.opaque(mi.UInt64, 1000 * seed + number), initseq=mi.UInt64(pixel))
    to_sun = _towards_sun(daylight, random)
    open_sky = ~stage.scene.ray_test(si.spawn_ray(to_sun), valid)
    cosine = dr.dot(n, to_sun)
    cosine = dr.maximum(cosine, 0) + THROUGH * leafy * dr.maximum(-cosine, 0)
    sun = dr.select(open_sky & valid, cosine, 0)
    light = _Surroundings(stage, daylight)
    around = mi.Color3f(0)
    if number % AROUND_EVERY == 0:
        around = light.from_hemisphere(si, n, pixel, number // AROUND_EVERY, seed, valid) * (1 + 0.5 * THROUGH * leafy)
    gloss = dr.select(valid, light.mirrored(si, n, d, to_sun, open_sky, owner, random, valid), light.sky(d))
    triangle = dr.select(valid, si.prim_index, mi.UInt32(NOTHING))
    place = si.p
    dr.eval(place, triangle, sun, around, gloss)
    return Sample(
        np.array(place, np.float32).T,
        np.array(triangle),
        np.array(sun, np.float32),
        np.array(around, np.float32).T,
        np.array(gloss, np.float32).T,
    )


def even(number: int, start: float = 0.5) -> tuple[float, float]:
    """The number-th of points that fill the unit square evenly: Roberts' R2 sequence."""
    return (start + 0.7548776662466927 * number) % 1.0, (start + 0.5698402909980532 * number) % 1.0


def _through(camera: Camera, pixel: Any, du: float, dv: float) -> Any:
    """Unit directions through (du, dv) of the pixels."""
    mi, dr = backend()
    width = dr.opaque(mi.UInt32, camera.width)
    col, row = pixel % width, pixel // width
    x = (mi.Float(col) + dr.opaque(mi.Float, du - camera.width / 2)) / dr.opaque(mi.Float, camera.focal)
    y = (mi.Float(row) + dr.opaque(mi.Float, dv - camera.height / 2)) / dr.opaque(mi.Float, camera.focal)
    right, down, forward = (_vector(camera.T_M_cam[:3, k]) for k in range(3))
    return dr.normalize(right * x + down * y + forward)


def _vector(v: Float64[np.ndarray, "3"]) -> Any:
    mi, dr = backend()
    return mi.Vector3f(*(dr.opaque(mi.Float, float(c)) for c in v))


def _point(v: Float64[np.ndarray, "3"]) -> Any:
    return backend().mi.Point3f(_vector(v))


def _colour(v: Float64[np.ndarray, "3"]) -> Any:
    return backend().mi.Color3f(_vector(v))


def _towards_sun(daylight: Daylight, random: Any) -> Any:
    """Directions into the sun's disc."""
    mi, dr = backend()
    disc = mi.warp.square_to_uniform_disk(mi.Point2f(random.next_float32(), random.next_float32()))
    frame = mi.Frame3f(_vector(daylight.to_sun))
    radius = float(np.tan(np.deg2rad(SUN_ANGLE / 2)))
    return dr.normalize(frame.to_world(mi.Vector3f(disc.x * radius, disc.y * radius, 1)))


class _Surroundings:
    """What comes from all directions but the sun's: the sky, and what things throw back."""

    def __init__(self, stage: Stage, daylight: Daylight) -> None:
        mi, dr = backend()
        self.stage, self.daylight = stage, daylight
        self.table = mi.Texture2f(mi.TensorXf(daylight.sky), wrap_mode=dr.WrapMode.Clamp)

    def sky(self, d: Any) -> Any:
        """Radiance of the sky; below the horizon that of the horizon."""
        mi, dr = backend()
        turn = dr.atan2(d.y, d.x) * (0.5 / dr.pi)
        turn = dr.select(turn < 0, turn + 1, turn)
        up = dr.clip(d.z, 0.5 / TABLE[0], 1)
        return mi.Color3f(*self.table.eval(mi.Point2f(turn, up)))

    def from_hemisphere(self, si: Any, n: Any, pixel: Any, number: int, seed: int, active: Any) -> Any:
        """Irradiance from one direction drawn with the cosine, one bounce included."""
        mi, dr = backend()
        # Each pixel shifts the same even sequence by its own amount (Cranley and Patterson).
        shift_u, shift_v = (
            mi.sample_tea_float32(pixel, dr.opaque(mi.UInt32, seed)),
            mi.sample_tea_float32(pixel, dr.opaque(mi.UInt32, seed + 7919)),
        )
        u, v = (dr.opaque(mi.Float, c) for c in even(number))
        place = mi.Point2f(_fraction(u + shift_u), _fraction(v + shift_v))
        w = mi.Frame3f(n).to_world(mi.warp.square_to_cosine_hemisphere(place))
        met = self.stage.scene.ray_intersect(si.spawn_ray(w), active)
        found = dr.select(met.is_valid(), self._thrown_back(met, w), self.sky(w))
        return dr.select(active, found * dr.pi, 0)

    def _thrown_back(self, met: Any, w: Any) -> Any:
        """Radiance of a surface that is seen by a surface: broad colours, real shadows, a plain sky."""
        dr = backend().dr
        valid = met.is_valid()
        n = facing(met.sh_frame.n, w)
        to_sun = _vector(self.daylight.to_sun)
        lit = ~self.stage.scene.ray_test(met.spawn_ray(to_sun), valid) & valid
        sun = dr.select(lit, dr.maximum(dr.dot(n, to_sun), 0), 0)
        falling = _colour(self.daylight.sun) * sun + _colour(self.daylight.skylight) * (0.3 + 0.3 * n.z)
        return self._broad_albedo(met, valid) * falling / dr.pi

    def _broad_albedo(self, met: Any, valid: Any) -> Any:
        mi, dr = backend()
        stage, ground = self.stage, self.stage.contents.ground
        owner = dr.gather(mi.UInt32, stage.owner_of, met.prim_index, valid)
        body = mi.Color3f(*(dr.gather(mi.Float, table, owner, valid) for table in stage.body_albedo))
        edge = -2 * ground.west
        under = mi.Color3f(*stage.ground_albedo.eval(mi.Point2f(met.p.x / edge + 0.5, met.p.y / edge + 0.5)))
        return dr.select(owner == 0, under, body)

    def mirrored(self, si: Any, n: Any, d: Any, to_sun: Any, open_sky: Any, owner: Any, random: Any, valid: Any) -> Any:
        """Radiance that a clear coat mirrors: surroundings and the sun's highlight (Schlick's Fresnel term)."""
        mi, dr = backend()
        gloss = dr.gather(mi.Float, self.stage.gloss, owner, valid)
        glossy = valid & (gloss > 0)
        wobble = mi.Vector3f(random.next_float32(), random.next_float32(), random.next_float32()) - 0.5
        r = dr.normalize(d - 2 * dr.dot(n, d) * n + 0.12 * wobble)
        met = self.stage.scene.ray_intersect(si.spawn_ray(r), glossy)
        seen = dr.select(met.is_valid(), self._thrown_back(met, r), self.sky(r))
        half = dr.normalize(to_sun - d)
        lobe = (SHININESS + 8) / (8 * dr.pi) * dr.power(dr.maximum(dr.dot(n, half), 0), SHININESS)
        highlight = dr.select(open_sky, lobe * dr.maximum(dr.dot(n, to_sun), 0), 0) * _fresnel(-dr.dot(d, half))
        return dr.select(glossy, gloss * (_fresnel(-dr.dot(d, n)) * seen + highlight * _colour(self.daylight.sun)), 0)


def _fresnel(cosine: Any) -> Any:
    dr = backend().dr
    return 0.05 + 0.95 * dr.power(1 - dr.clip(cosine, 0, 1), 5)


def _fraction(x: Any) -> Any:
    return x - backend().dr.floor(x)
