"""Bodies: boxes, cylinders, tubes, cones and ellipsoids, each the unit shape of its kind under an affine map."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from jaxtyping import Float64

from excavatwin.kernels import ray_casting, ray_shading
from excavatwin.kernels.ray_casting import BodyArrays


class Kind(IntEnum):
    """Unit shapes; all fill [-1, 1]^3 and round ones have their axis along local z."""

    BOX = ray_casting.BOX
    CYLINDER = ray_casting.CYLINDER
    TUBE = ray_casting.TUBE  #: cylinder with a bore of ``ray_casting.TUBE_BORE`` of its radius
    CONE = ray_casting.CONE  #: radius 1 at local z = -1, 0 at +1
    ELLIPSOID = ray_casting.ELLIPSOID


class Material(IntEnum):
    """What a body looks like, in the order of ``ALBEDO``; the ground's materials are fields of the terrain."""

    YELLOW_PAINT = 0
    DARK_STEEL = 1
    GLASS = 2
    CONCRETE = 3
    WHITE_PAINT = 4
    ORANGE_PLASTIC = 5
    WOOD = 6
    LEAVES = 7
    GRASS = 8
    BARK = 9
    BLUE_PAINT = 10
    RED_PAINT = 11
    HI_VIS = 12  #: fluorescent cloth
    SKIN = 13
    DENIM = 14
    GREEN_PAINT = 15
    LOOSE_SOIL = 16  #: a load, not ground


ALBEDO = np.array(
    [
        (0.72, 0.42, 0.02),
        (0.055, 0.052, 0.05),
        (0.045, 0.06, 0.07),
        (0.40, 0.39, 0.37),
        (0.66, 0.66, 0.65),
        (0.75, 0.17, 0.03),
        (0.30, 0.225, 0.15),
        (0.055, 0.105, 0.025),
        (0.17, 0.22, 0.06),
        (0.10, 0.07, 0.05),
        (0.05, 0.13, 0.33),
        (0.42, 0.035, 0.03),
        (0.80, 0.62, 0.05),
        (0.42, 0.24, 0.16),
        (0.03, 0.045, 0.09),
        (0.05, 0.20, 0.07),
        (0.20, 0.13, 0.075),
    ]
)
"""Linear reflectance of each material red green blue."""
FINISH = {
    Material.LEAVES: ray_shading.FOLIAGE,
    Material.GRASS: ray_shading.FOLIAGE,
    Material.GLASS: ray_shading.GLASS,
}
"""Surfaces that are not painted."""


@dataclass(frozen=True)
class Body:
    """One convex (or bored) solid."""

    kind: Kind
    centre: Float64[np.ndarray, "3"]
    """Frame M [m]."""
    axes: Float64[np.ndarray, "3 3"]
    """Columns: the local axes in frame M, orthonormal."""
    half: Float64[np.ndarray, "3"]
    """Half extents along the local axes [m]."""
    material: Material
    porosity: float = 0.0
    """Share of the shell that is holes (foliage), 0..1."""

    def moved(self, R: Float64[np.ndarray, "3 3"], t: Float64[np.ndarray, "3"]) -> Body:
        """The body after the rigid motion p -> R p + t."""
        return Body(self.kind, R @ self.centre + t, R @ self.axes, self.half, self.material, self.porosity)

    def outline(self, count: int = 32) -> Float64[np.ndarray, "n 3"]:
        """Points whose convex hull is (for round bodies: approximates) that of the body, frame M [m]."""
        turn = np.linspace(0, 2 * np.pi, count, endpoint=False)
        ring = np.c_[np.cos(turn), np.sin(turn)]
        if self.kind == Kind.BOX:
            local = np.array(np.meshgrid((-1, 1), (-1, 1), (-1, 1))).reshape(3, -1).T.astype(float)
        elif self.kind in (Kind.CYLINDER, Kind.TUBE):
            local = np.concatenate([np.c_[ring, np.full(count, z)] for z in (-1.0, 1.0)])
        elif self.kind == Kind.CONE:
            local = np.concatenate([np.c_[ring, np.full(count, -1.0)], [[0, 0, 1]]])
        else:
            heights = np.sin(np.linspace(-np.pi / 2, np.pi / 2, count // 2))
            local = np.concatenate([np.c_[ring * np.sqrt(1 - z * z), np.full(count, z)] for z in heights])
        return self.centre + (local * self.half) @ self.axes.T

    def farthest(self, directions: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n"]:
        """Largest coordinate of the body along each unit vector: its support function [m, frame M]."""
        x, y, z = ((directions @ self.axes) * self.half).T
        if self.kind == Kind.BOX:
            reach = np.abs(x) + np.abs(y) + np.abs(z)
        elif self.kind in (Kind.CYLINDER, Kind.TUBE):
            reach = np.hypot(x, y) + np.abs(z)
        elif self.kind == Kind.CONE:
            reach = np.maximum(z, np.hypot(x, y) - z)
        else:
            reach = np.sqrt(x * x + y * y + z * z)
        return directions @ self.centre + reach


def body_arrays(bodies: list[Body], labels: list[int], instances: list[int]) -> BodyArrays:
    """Pack bodies with their class and object ids, and build the tree by halving along the longest axis."""
    n = len(bodies)
    centre = np.array([body.centre for body in bodies], float).reshape(n, 3)
    axes = np.array([body.axes for body in bodies], float).reshape(n, 3, 3)
    half = np.array([body.half for body in bodies], float).reshape(n, 3)
    reach = np.abs(axes * half[:, None, :]).sum(-1)  # box of the box: contains every unit shape
    low: list[np.ndarray] = []
    high: list[np.ndarray] = []
    skip: list[int] = []
    leaf: list[int] = []

    def grow(members: np.ndarray) -> None:
        node = len(low)
        low.append((centre - reach)[members].min(0))
        high.append((centre + reach)[members].max(0))
        skip.append(0)
        leaf.append(int(members[0]) if len(members) == 1 else -1)
        if len(members) > 1:
            axis = np.argmax(np.ptp(centre[members], axis=0))
            order = members[np.argsort(centre[members, axis], kind="stable")]
            grow(order[: len(order) // 2])
            grow(order[len(order) // 2 :])
        skip[node] = len(low)

    if n:
        grow(np.arange(n))
    return BodyArrays(
        centre,
        axes,
        half,
        np.array([body.kind for body in bodies], np.int64),
        ALBEDO[[int(body.material) for body in bodies]].reshape(n, 3),
        np.array([FINISH.get(body.material, ray_shading.PAINT) for body in bodies], np.int64),
        np.array([body.porosity for body in bodies], float),
        np.array(labels, np.uint8),
        np.array(instances, np.int32),
        np.array(low, float).reshape(-1, 3),
        np.array(high, float).reshape(-1, 3),
        np.array(skip, np.int64),
        np.array(leaf, np.int64),
    )
