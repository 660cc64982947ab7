"""What stands on the site, built of bodies in a local frame: x forward, y left, z up, ground at z = 0 [m]."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from excavatwin.simulation.bodies import Body, Kind, Material

M = Material


def turn_z(angle: float) -> Float64[np.ndarray, "3 3"]:
    """Rotation about z, counter-clockwise [rad]."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def box(low: tuple[float, ...], high: tuple[float, ...], material: Material) -> Body:
    """Box between two corners."""
    a, b = np.array(low, float), np.array(high, float)
    return Body(Kind.BOX, (a + b) / 2, np.eye(3), (b - a) / 2, material)


def along(direction: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    """Axes with local z along ``direction`` and local x as level as can be."""
    z = direction / np.linalg.norm(direction)
    x = np.cross([0, 0, 1.0], z) if abs(z[2]) < 0.999 else np.array([1.0, 0, 0])
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def rod(
    a: tuple[float, ...],
    b: tuple[float, ...],
    half: tuple[float, float],
    material: Material,
    kind: Kind = Kind.CYLINDER,
) -> Body:
    """Cylinder, tube, cone or beam from a to b with half extents across."""
    p, q = np.array(a, float), np.array(b, float)
    return Body(kind, (p + q) / 2, along(q - p), np.array([*half, np.linalg.norm(q - p) / 2]), material)


def excavator(swing: float = 0.2) -> list[Body]:
    """A compact excavator of about 3 t: 1.55 m wide, 2.45 m high, boom forward, bucket half lowered.

    Args:
        swing: angle of the house against the tracks [rad].
    """
    under = [box((1.05, -0.77, 0.08), (1.15, 0.77, 0.42), M.YELLOW_PAINT)]
    for y in (-0.62, 0.62):
        under += [
            box((-0.75, y - 0.15, 0.0), (0.75, y + 0.15, 0.46), M.DARK_STEEL),
            rod((-0.75, y - 0.15, 0.23), (-0.75, y + 0.15, 0.23), (0.23, 0.23), M.DARK_STEEL),
            rod((0.75, y - 0.15, 0.23), (0.75, y + 0.15, 0.23), (0.23, 0.23), M.DARK_STEEL),
            rod((0.5, 0.5 * y, 0.25), (1.1, 0.5 * y, 0.25), (0.05, 0.05), M.YELLOW_PAINT, Kind.BOX),
        ]
    under += [box((-0.5, -0.5, 0.2), (0.5, 0.5, 0.42), M.DARK_STEEL)]
    upper = [
        rod((0, 0, 0.4), (0, 0, 0.6), (0.4, 0.4), M.DARK_STEEL),
        box((-0.75, -0.74, 0.56), (0.85, 0.74, 0.72), M.YELLOW_PAINT),
        box((-0.95, -0.72, 0.62), (-0.2, 0.72, 1.3), M.YELLOW_PAINT),
        rod((-0.55, 0, 0.6), (-0.55, 0, 1.25), (0.55, 0.74), M.DARK_STEEL),
        box((-0.2, -0.74, 0.7), (0.6, -0.35, 1.12), M.YELLOW_PAINT),
        box((-0.32, -0.08, 0.72), (0.82, 0.7, 2.36), M.GLASS),
        box((-0.36, -0.12, 2.36), (0.86, 0.74, 2.45), M.YELLOW_PAINT),
        box((-0.36, -0.12, 0.7), (0.86, 0.74, 1.2), M.YELLOW_PAINT),
    ]
    for x, y in ((-0.34, -0.1), (-0.34, 0.72), (0.84, -0.1), (0.84, 0.72)):
        upper.append(box((x - 0.04, y - 0.04, 0.7), (x + 0.04, y + 0.04, 2.4), M.DARK_STEEL))
    y = -0.22
    upper += [
        rod((0.75, y, 0.8), (1.65, y, 2.3), (0.1, 0.15), M.YELLOW_PAINT, Kind.BOX),
        rod((1.6, y, 2.25), (2.75, y, 2.2), (0.1, 0.13), M.YELLOW_PAINT, Kind.BOX),
        rod((2.55, y, 2.4), (3.25, y, 1.0), (0.09, 0.11), M.YELLOW_PAINT, Kind.BOX),
        rod((0.95, y, 0.75), (1.6, y, 1.65), (0.06, 0.06), M.DARK_STEEL),
        rod((1.5, y, 2.5), (2.5, y, 2.45), (0.055, 0.055), M.DARK_STEEL),
        rod((2.65, y, 1.95), (3.3, y, 1.15), (0.05, 0.05), M.DARK_STEEL),
        box((2.9, y - 0.3, 0.5), (3.3, y + 0.3, 1.0), M.DARK_STEEL),
        box((2.8, y - 0.3, 0.46), (3.0, y + 0.3, 0.62), M.DARK_STEEL),
    ]
    return under + [body.moved(turn_z(swing), np.zeros(3)) for body in upper]


def pickup() -> list[Body]:
    """A white pickup of 5.2 x 1.85 x 1.78 m."""
    parts = [
        box((-2.6, -0.925, 0.38), (2.6, 0.925, 0.72), M.WHITE_PAINT),
        box((0.95, -0.9, 0.72), (2.5, 0.9, 1.08), M.WHITE_PAINT),
        box((-0.95, -0.85, 0.72), (0.95, 0.85, 1.02), M.WHITE_PAINT),
        box((-0.85, -0.78, 1.02), (0.75, 0.78, 1.7), M.GLASS),
        box((-0.8, -0.8, 1.68), (0.6, 0.8, 1.78), M.WHITE_PAINT),
        box((-2.55, -0.9, 0.72), (-2.48, 0.9, 1.15), M.WHITE_PAINT),
        box((-2.55, -0.9, 0.72), (-0.95, -0.83, 1.15), M.WHITE_PAINT),
        box((-2.55, 0.83, 0.72), (-0.95, 0.9, 1.15), M.WHITE_PAINT),
        box((-2.2, -0.5, 0.72), (-1.4, 0.3, 0.95), M.WOOD),
    ]
    for x in (-1.65, 1.65):
        for y in (-0.78, 0.78):
            parts.append(rod((x, y - 0.13, 0.37), (x, y + 0.13, 0.37), (0.37, 0.37), M.DARK_STEEL))
    return parts


def pipe_row(count: int = 4, diameter: float = 0.9, length: float = 2.2) -> list[Body]:
    """Concrete pipes side by side, touching: one obstacle of (length, count * diameter, diameter)."""
    r = diameter / 2
    ys = (np.arange(count) - (count - 1) / 2) * diameter
    return [rod((-length / 2, y, r), (length / 2, y, r), (r, r), M.CONCRETE, Kind.TUBE) for y in ys]


def skip(length: float = 3.2, width: float = 1.7, height: float = 1.35, wall: float = 0.08) -> list[Body]:
    """An open steel skip with a little rubble in it."""
    x, y = length / 2, width / 2
    return [
        box((-x, -y, 0), (x, y, 0.5), M.BLUE_PAINT),
        box((-x, -y, 0.4), (x, -y + wall, height), M.BLUE_PAINT),
        box((-x, y - wall, 0.4), (x, y, height), M.BLUE_PAINT),
        box((-x, -y, 0.4), (-x + wall, y, height), M.BLUE_PAINT),
        box((x - wall, -y, 0.4), (x, y, height), M.BLUE_PAINT),
        rod((-1.2, -0.3, 0.55), (0.1, 0.2, 0.8), (0.35, 0.06), M.CONCRETE, Kind.BOX),
        rod((0.1, 0.5, 0.6), (1.3, -0.4, 0.75), (0.09, 0.05), M.WOOD, Kind.BOX),
        rod((0.3, -0.5, 0.55), (1.2, 0.5, 0.7), (0.4, 0.08), M.CONCRETE, Kind.BOX),
        rod((-0.9, 0.45, 0.55), (0.6, 0.6, 0.6), (0.08, 0.08), M.BARK),
    ]


def block(length: float = 1.8, width: float = 1.0, height: float = 1.0) -> list[Body]:
    """A concrete block."""
    return [box((-length / 2, -width / 2, 0), (length / 2, width / 2, height), M.CONCRETE)]


def toolbox(length: float = 1.5, width: float = 1.2, height: float = 0.9) -> list[Body]:
    """A red steel box for tools, with a grey handle's recess in its lid."""
    x, y = length / 2, width / 2
    return [
        box((-x, -y, 0.08), (x, y, height - 0.004), M.RED_PAINT),
        box((-x + 0.1, -y + 0.1, 0), (x - 0.1, y - 0.1, 0.08), M.DARK_STEEL),
        box((-0.25, -0.12, height - 0.02), (0.25, 0.12, height), M.DARK_STEEL),
    ]


def cone() -> list[Body]:
    """A traffic cone of 0.75 m."""
    return [
        box((-0.2, -0.2, 0), (0.2, 0.2, 0.04), M.DARK_STEEL),
        rod((0, 0, 0.04), (0, 0, 0.75), (0.16, 0.16), M.ORANGE_PLASTIC, Kind.CONE),
    ]


def foliage(
    rng: np.random.Generator,
    centre: tuple[float, float, float],
    spread: tuple[float, float, float],
    count: int,
    size: float,
    material: Material,
    porosity: float,
) -> list[Body]:
    """Porous ellipsoids of about ``size`` scattered through an ellipsoid of half axes ``spread``."""
    bodies = []
    for _ in range(count):
        direction = rng.normal(size=3)
        direction *= rng.uniform(0.35, 1) / np.linalg.norm(direction)
        half = size * rng.uniform(0.6, 1.3) * np.array([1, rng.uniform(0.7, 1), rng.uniform(0.6, 0.9)])
        p = np.array(centre) + direction * np.array(spread)
        bodies.append(Body(Kind.ELLIPSOID, p, turn_z(rng.uniform(0, np.pi)), half, material, porosity))
    return bodies


def tree(rng: np.random.Generator, height: float) -> list[Body]:
    """A small round-crowned tree."""
    r = 0.36 * height
    crown = foliage(rng, (0, 0, 0.62 * height), (0.8 * r, 0.8 * r, 0.3 * height), 60, 0.3 * r, M.LEAVES, 0.45)
    return [rod((0, 0, -0.2), (0, 0, 0.6 * height), (0.03 * height, 0.03 * height), M.BARK), *crown]


def bush(rng: np.random.Generator, height: float) -> list[Body]:
    """A bush a little wider than high."""
    return foliage(
        rng, (0, 0, 0.42 * height), (0.65 * height, 0.55 * height, 0.3 * height), 14, 0.3 * height, M.LEAVES, 0.35
    )


def tuft(rng: np.random.Generator, height: float) -> list[Body]:
    """A tuft of tall grass."""
    bodies = []
    for _ in range(4):
        x, y = rng.normal(0, 0.3 * height, 2)
        half = height * np.array([0.3, 0.25, 0.5]) * rng.uniform(0.8, 1.1)
        bodies.append(Body(Kind.ELLIPSOID, np.array([x, y, 0.4 * height]), np.eye(3), half, M.GRASS, 0.5))
    return bodies
