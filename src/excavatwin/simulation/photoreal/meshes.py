"""Triangles of a site: the terrain on a grid that is finer where truth is kept, bodies as polyhedra."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, Int32, UInt32

from excavatwin.kernels.ray_casting import TUBE_BORE
from excavatwin.simulation.bodies import Body, Kind
from excavatwin.simulation.terrain import Ground

GROUND = -1
"""Owner of the terrain's triangles."""
FAR = 1500.0
"""The plane beyond the modelled terrain ends here [m]."""
SAGITTA = 0.001
"""Largest distance between a round body and its polyhedron [m]."""


class Triangles(NamedTuple):
    """A mesh, and whose each triangle is."""

    vertex: Float32[np.ndarray, "v 3"]
    """Frame M [m]."""
    normal: Float32[np.ndarray, "v 3"]
    """Unit, for shading."""
    face: UInt32[np.ndarray, "f 3"]
    owner: Int32[np.ndarray, "f"]
    """Index of the body, or ``GROUND``."""
    leaf: Int32[np.ndarray, "f"]
    """Number of the leaf or blade within all foliage, -1 elsewhere."""


def join(parts: list[Triangles]) -> Triangles:
    """Several meshes as one."""
    start = np.cumsum([0] + [len(part.vertex) for part in parts[:-1]])
    return Triangles(
        np.concatenate([part.vertex for part in parts]),
        np.concatenate([part.normal for part in parts]),
        np.concatenate([part.face + np.uint32(s) for part, s in zip(parts, start, strict=True)]),
        np.concatenate([part.owner for part in parts]),
        np.concatenate([part.leaf for part in parts]),
    )


def grid_faces(rows: int, cols: int) -> UInt32[np.ndarray, "f 3"]:
    """Two triangles for each cell of a vertex grid, counter-clockwise where rows go north and columns east."""
    index = np.arange(rows * cols, dtype=np.uint32).reshape(rows, cols)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    return np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])


def chosen_lines(ground: Ground, extent: float, spacing: float) -> Int32[np.ndarray, "n"]:
    """Columns (rows are the same) of the terrain that become mesh lines: all within the extent, few outside."""
    count = ground.height.shape[1]
    along = ground.west + ground.cell * np.arange(count)
    stride = max(1, round(spacing / ground.cell))
    keep = (np.abs(along) <= extent / 2 + 2 * ground.cell) | (np.arange(count) % stride == 0)
    keep[[0, -1]] = True
    return np.flatnonzero(keep).astype(np.int32)


def terrain(ground: Ground, extent: float, spacing: float = 0.1) -> Triangles:
    """The height raster as triangles; a product of lines, so that fine and coarse parts meet without cracks.

    Args:
        extent: edge of the square within which every vertex is kept [m].
        spacing: of the lines outside it [m].
    """
    lines = chosen_lines(ground, extent, spacing)
    x = ground.west + ground.cell * lines
    y = ground.south + ground.cell * lines
    z = ground.height[np.ix_(lines, lines)].astype(float)
    gy, gx = np.gradient(z, y, x)
    normal = np.stack([-gx, -gy, np.ones_like(z)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    vertex = np.stack(np.broadcast_arrays(x[None, :], y[:, None], z), -1)
    inner = _mesh(vertex.reshape(-1, 3), normal.reshape(-1, 3), grid_faces(len(lines), len(lines)), GROUND)
    return join([inner, _beyond(ground)])


def _beyond(ground: Ground) -> Triangles:
    """The plane outside the raster, a frame of four trapezoids that overlaps it by a centimetre."""
    half = -ground.west - 0.01
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], float)
    xy = np.concatenate([half * corners, FAR * corners])
    vertex = np.c_[xy, xy @ ground.plane[:2] + ground.plane[2]]
    face = [f for k in range(4) for f in ((k, k + 4, (k + 1) % 4 + 4), (k, (k + 1) % 4 + 4, (k + 1) % 4))]
    up = np.array([-ground.plane[0], -ground.plane[1], 1.0])
    return _mesh(vertex, np.tile(up / np.linalg.norm(up), (8, 1)), np.array(face, np.uint32), GROUND)


def solid(body: Body, owner: int) -> Triangles:
    """A body without holes as a polyhedron."""
    local, normal, face = _unit(body.kind, _segments(body))
    vertex = body.centre + (local * body.half) @ body.axes.T
    normal = (normal / body.half) @ body.axes.T
    return _mesh(vertex, normal / np.linalg.norm(normal, axis=1, keepdims=True), face, owner)


def _mesh(vertex: np.ndarray, normal: np.ndarray, face: np.ndarray, owner: int) -> Triangles:
    count = len(face)
    return Triangles(
        vertex.astype(np.float32),
        normal.astype(np.float32),
        face.astype(np.uint32),
        np.full(count, owner, np.int32),
        np.full(count, -1, np.int32),
    )


def _segments(body: Body) -> int:
    radius = max(body.half[:2]) if body.kind != Kind.ELLIPSOID else max(body.half)
    if radius <= SAGITTA:
        return 8
    return int(np.clip(np.ceil(np.pi / np.arccos(1 - SAGITTA / radius)), 12, 96))


Unit = tuple[Float64[np.ndarray, "v 3"], Float64[np.ndarray, "v 3"], UInt32[np.ndarray, "f 3"]]


def _unit(kind: Kind, segments: int) -> Unit:
    """Vertices, normals and faces of a unit shape."""
    if kind == Kind.BOX:
        sides = [_box_side(axis, sign) for axis in range(3) for sign in (-1.0, 1.0)]
    elif kind == Kind.ELLIPSOID:
        sides = [_turned(np.linspace(-np.pi / 2, np.pi / 2, segments // 2 + 1), segments)]
    elif kind == Kind.CONE:
        sides = [_mantle(1.0, 0.0, segments, 0.5), _cap(-1.0, 0.0, segments)]
    else:
        bore = TUBE_BORE if kind == Kind.TUBE else 0.0
        sides = [_mantle(1.0, 1.0, segments, 0.0), _cap(-1.0, bore, segments), _cap(1.0, bore, segments)]
        if kind == Kind.TUBE:
            vertex, normal, face = _mantle(bore, bore, segments, 0.0)
            sides.append((vertex, -normal, face[:, ::-1]))
    start = np.cumsum([0] + [len(side[0]) for side in sides[:-1]])
    return (
        np.concatenate([side[0] for side in sides]),
        np.concatenate([side[1] for side in sides]),
        np.concatenate([side[2] + np.uint32(s) for side, s in zip(sides, start, strict=True)]),
    )


def _box_side(axis: int, sign: float) -> Unit:
    u, v = (axis + 1) % 3, (axis + 2) % 3
    vertex = np.zeros((4, 3))
    vertex[:, axis] = sign
    vertex[:, u], vertex[:, v] = (-1, 1, 1, -1), (-1, -1, 1, 1)
    normal = np.zeros((4, 3))
    normal[:, axis] = sign
    face = np.array([(0, 1, 2), (0, 2, 3)], np.uint32)
    return vertex, normal, face if sign > 0 else face[:, ::-1]


def _ring(segments: int) -> Float64[np.ndarray, "n 2"]:
    turn = 2 * np.pi * np.arange(segments) / segments
    return np.c_[np.cos(turn), np.sin(turn)]


def _mantle(low: float, high: float, segments: int, lift: float) -> Unit:
    """Between the circle of radius ``low`` at z = -1 and that of ``high`` at z = +1."""
    ring = _ring(segments)
    vertex = np.concatenate([np.c_[low * ring, np.full(segments, -1.0)], np.c_[high * ring, np.full(segments, 1.0)]])
    normal = np.tile(np.c_[ring, np.full(segments, lift)], (2, 1))
    k = np.arange(segments)
    n = (k + 1) % segments
    lower = np.stack([k, n, n + segments], -1)
    upper = np.stack([k, n + segments, k + segments], -1)
    return vertex, normal, np.concatenate([lower, upper]).astype(np.uint32)


def _cap(z: float, bore: float, segments: int) -> Unit:
    """A disc, or a ring about a bore."""
    ring = _ring(segments)
    vertex = np.concatenate([np.c_[bore * ring, np.full(segments, z)], np.c_[ring, np.full(segments, z)]])
    normal = np.tile([0.0, 0.0, np.sign(z)], (2 * segments, 1))
    k = np.arange(segments)
    n = (k + 1) % segments
    face = np.concatenate([np.stack([k, k + segments, n + segments], -1), np.stack([k, n + segments, n], -1)])
    return vertex, normal, (face if z > 0 else face[:, ::-1]).astype(np.uint32)


def _turned(latitude: Float64[np.ndarray, "n"], segments: int) -> Unit:
    """A sphere of rings."""
    ring = _ring(segments)
    rings = [np.c_[np.cos(a) * ring, np.full(segments, np.sin(a))] for a in latitude]
    vertex = np.concatenate(rings)
    rows = len(latitude)
    k, n = np.arange(segments), (np.arange(segments) + 1) % segments
    face = []
    for row in range(rows - 1):
        a, b = row * segments, (row + 1) * segments
        face += [np.stack([k + a, n + a, n + b], -1), np.stack([k + a, n + b, k + b], -1)]
    return vertex, vertex.copy(), np.concatenate(face).astype(np.uint32)
