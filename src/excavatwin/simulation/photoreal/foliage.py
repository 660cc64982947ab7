"""Leaves and blades: the real geometry that stands for a porous ellipsoid when a site is photographed."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int32

from excavatwin.simulation.bodies import Body, Material
from excavatwin.simulation.photoreal.meshes import Triangles

LAYERS = 1.7
"""Area of a closed shell's leaves over the shell's own area."""
LEAF_SHAPE = 0.6
"""Width of a leaf over its length."""
BLADES = 700.0
"""Blades of tall grass on a square metre of tuft."""


def leafage(body: Body, owner: int, first: int, rng: np.random.Generator) -> tuple[Triangles, int]:
    """Leaves or blades within a porous ellipsoid.

    Args:
        owner: index of the body.
        first: number of the first leaf.

    Returns:
        The triangles, and how many leaves they are.
    """
    grown = blades(body, rng) if body.material == Material.GRASS else leaves(body, rng)
    count, corners = grown.shape[:2]
    strip = np.array([(0, 1, 2), (1, 3, 2), (2, 3, 4)][: corners - 2], np.uint32)
    face = (np.arange(count, dtype=np.uint32)[:, None, None] * np.uint32(corners) + strip).reshape(-1, 3)
    normal = np.cross(grown[:, 1] - grown[:, 0], grown[:, 2] - grown[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    number: Int32[np.ndarray, "f"] = np.repeat(np.arange(first, first + count, dtype=np.int32), len(strip))
    return (
        Triangles(
            grown.reshape(-1, 3).astype(np.float32),
            np.repeat(normal, corners, axis=0).astype(np.float32),
            face,
            np.full(len(face), owner, np.int32),
            number,
        ),
        count,
    )


def leaves(body: Body, rng: np.random.Generator) -> Float64[np.ndarray, "n 4 3"]:
    """Rhombic leaves in the outer half of the ellipsoid, facing outwards and up, each its own way."""
    length = float(np.clip(0.24 * body.half.mean(), 0.05, 0.15))
    a, b, c = body.half
    shell = 4 * np.pi * (((a * b) ** 1.6 + (a * c) ** 1.6 + (b * c) ** 1.6) / 3) ** (1 / 1.6)  # Thomsen's formula
    area = 0.5 * LEAF_SHAPE * length**2 * 0.62  # 0.62: mean square of the sizes drawn below
    count = max(8, int(LAYERS * (1 - body.porosity) * shell / area))
    direction = unit(rng.normal(size=(count, 3)))
    place = direction * rng.uniform(0.5, 1.0, (count, 1)) ** 0.5
    outward = (direction / body.half) @ body.axes.T
    facing = unit(unit(outward) + np.array([0, 0, 0.5]) + 0.7 * rng.normal(size=(count, 3)))
    along = unit(np.cross(facing, rng.normal(size=(count, 3))))
    across = np.cross(facing, along)
    size = length * rng.uniform(0.55, 1.0, (count, 1))
    middle = body.centre + (place * body.half) @ body.axes.T
    droop = 0.15 * size * np.array([0, 0, -1.0])
    return np.stack(
        [
            middle - 0.5 * size * along,
            middle + 0.5 * LEAF_SHAPE * size * across,
            middle - 0.5 * LEAF_SHAPE * size * across,
            middle + 0.5 * size * along + droop,
        ],
        axis=1,
    )


def blades(body: Body, rng: np.random.Generator) -> Float64[np.ndarray, "n 5 3"]:
    """Tapering blades from the ellipsoid's foot to its upper half, bent outwards."""
    a, b, c = body.half
    count = max(12, int(BLADES * (1 - body.porosity) * np.pi * a * b))
    turn, reach = rng.uniform(0, 2 * np.pi, count), np.sqrt(rng.uniform(0, 1, count))
    flat = np.c_[np.cos(turn) * reach * a, np.sin(turn) * reach * b]
    root = np.c_[0.75 * flat, np.full(count, -c)]
    top = 2 * c * np.sqrt(1 - 0.75 * reach**2) * rng.uniform(0.6, 1.0, count)
    lean = 0.25 * flat + 0.22 * c * rng.normal(size=(count, 2))
    tip = root + np.c_[lean, top]
    middle = root + np.c_[0.3 * lean, 0.6 * top]
    side = unit(np.c_[rng.normal(size=(count, 2)), np.zeros(count)]) * (0.5 * 0.03 * rng.uniform(0.6, 1.2, (count, 1)))
    local = np.stack([root - side, root + side, middle - 0.8 * side, middle + 0.8 * side, tip], axis=1)
    return body.centre + local @ body.axes.T


def unit(v: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
    """Rows of length one."""
    return v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-12)
