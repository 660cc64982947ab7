"""A small site, made of formulas: a pit, a heap, an excavator, a container, a hedge; seen by two cameras."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from excavatwin.scene.elevation_map import ElevationMap, MapObject
from excavatwin.scene.frames import invert_rigid, transform
from excavatwin.scene.grid import Grid
from excavatwin.scene.observations import Georeference, Lattice, Observations, Unplaced, View
from excavatwin.scene.site import FusedPoints, MappedView, Site
from excavatwin.scene.taxonomy import NOT_OBSERVED, PALETTE, Reason, Support, TaskClass

UTM = Georeference(32617, (454_321.25, 4_432_101.5, 212.75), 0.42)
#: class, centre x, y, length, width, height, yaw [deg]
BOXES = (
    (TaskClass.EXCAVATOR, 3.0, 2.0, 5.0, 2.6, 2.8, 30.0),
    (TaskClass.OBSTACLE, -7.0, 5.5, 4.0, 2.0, 2.2, -10.0),
)


def terrain(x: Float[np.ndarray, "*n"], y: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """A gentle slope with a pit 2 m deep and a heap 1.8 m high [m]."""
    pit = -2.0 / (1 + np.exp(-(3.0 - np.hypot((x + 1) / 1.4, y + 3)) * 4))
    heap = 1.8 * np.exp(-((x - 8) ** 2 + (y + 4) ** 2) / 5)
    ripples = 0.05 * np.sin(2.1 * x + 1.3 * y) * np.cos(1.7 * y - 0.6 * x)
    return 0.04 * x - 0.02 * y + pit + heap + ripples


def hedge(x: Float[np.ndarray, "*n"], y: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Height of a hedge along the north edge [m]."""
    along = np.exp(-(((y - 9.0 - 0.4 * np.sin(x)) / 0.9) ** 4))
    return 1.4 * along * (1 + 0.15 * np.sin(5 * x) * np.sin(4 * y))


def surface(
    x: Float[np.ndarray, "*n"], y: Float[np.ndarray, "*n"]
) -> tuple[Float[np.ndarray, "*n"], np.ndarray, np.ndarray]:
    """Height of the visible surface, its class and its object."""
    z = terrain(x, y)
    label = np.where(np.hypot(x - 2, y + 3) < 8.5, TaskClass.CONSTRUCTION_TERRAIN, TaskClass.OTHER_TERRAIN)
    cover = hedge(x, y)
    label = np.where(cover > 0.15, TaskClass.REMOVABLE_COVER, label)
    z = z + np.where(cover > 0.15, cover, 0)
    owner = np.zeros(np.shape(x), int)
    for i, (k, cx, cy, length, width, height, yaw) in enumerate(BOXES, start=1):
        c, s = np.cos(np.deg2rad(yaw)), np.sin(np.deg2rad(yaw))
        u, v = c * (x - cx) + s * (y - cy), -s * (x - cx) + c * (y - cy)
        inside = (np.abs(u) < length / 2) & (np.abs(v) < width / 2)
        z = np.where(inside, terrain(np.array(cx), np.array(cy)) + height, z)
        label, owner = np.where(inside, k, label), np.where(inside, i, owner)
    return z, label.astype(np.uint8), owner


def example_map(georeferenced: bool = True, metric: bool = True, cell: float = 0.1) -> ElevationMap:
    """The map of the example; its west edge is not observed."""
    grid = Grid(-12.0, 11.0, cell, round(20 / cell), round(24 / cell))
    x, y = np.meshgrid(grid.x, grid.y)
    z, label, owner = surface(x, y)
    seen = x > -11 + 0.5 * np.sin(y)
    ground = seen & np.isin(label, (1, 2))
    label = np.where(seen, label, NOT_OBSERVED)
    label[(np.hypot(x + 5, y + 6) < 0.7) & seen] = TaskClass.UNKNOWN
    on = seen & (owner > 0)
    nan = np.float32(np.nan)
    unknown = np.where(seen, Reason.INSUFFICIENT, Reason.UNOBSERVED)
    return ElevationMap(
        grid=grid,
        elevation=np.where(ground, z, nan).astype(np.float32),
        elevation_std=np.where(ground, 0.01 + 0.002 * np.abs(x), nan).astype(np.float32),
        label=label.astype(np.uint8),
        confidence=np.where(seen, 0.8, 0).astype(np.float32),
        observed=seen.astype(np.uint8),
        reason=np.where(seen & (label > 0), Reason.CLASSIFIED, unknown).astype(np.uint8),
        object_id=np.where(on, owner, 0).astype(np.int32),
        object_top=np.where(on, z, nan).astype(np.float32),
        object_base=np.where(on, z - 2, nan).astype(np.float32),
        support=np.where(ground, Support.TERRAIN, np.where(seen, Support.NON_TERRAIN, Support.NONE)).astype(np.uint8),
        objects=tuple(_object(i) for i in (1, 2)),
        metric=metric,
        georeference=UTM if georeferenced and metric else None,
        doubts=("The GPS track is nearly one line: tilt across it is not observable.",),
        provenance={"gravity": "gps", "parameters": {"tau": 0.4}},
    )


def _object(i: int) -> MapObject:
    k, cx, cy, length, width, height, yaw = BOXES[i - 1]
    a = np.deg2rad(yaw)
    R = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array([length, width]) / 2 @ R.T + (cx, cy)
    base = float(terrain(np.array(cx), np.array(cy)))
    return MapObject(i, k, (cx, cy, base + height / 2), (length, width, height), yaw, base, base + height, 0.9, corners)


def camera(azimuth: float, distance: float = 22.0, height: float = 14.0) -> np.ndarray:
    """Camera-to-map pose that looks at the middle of the site; OpenCV axes."""
    eye = np.array([distance * np.cos(azimuth), distance * np.sin(azimuth), height])
    forward = -eye / np.linalg.norm(eye)
    right = np.cross(forward, (0, 0, 1.0))
    right /= np.linalg.norm(right)
    T = np.eye(4)
    T[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    T[:3, 3] = eye
    return T


def example_view(name: str, azimuth: float, shape: tuple[int, int] = (60, 90)) -> View:
    """What a perfect model would deliver: marched rays, true classes, lit colours; NaN above the horizon."""
    H, W = shape
    K = np.array([[0.9 * W, 0, W / 2], [0, 0.9 * W, H / 2], [0, 0, 1.0]])
    T = camera(azimuth)
    col, row = np.meshgrid(np.arange(W) + 0.5, np.arange(H) + 0.5)
    rays = np.stack([(col - K[0, 2]) / K[0, 0], (row - K[1, 2]) / K[1, 1], np.ones_like(col)], -1) @ T[:3, :3].T
    near, step = np.full(shape, 8.0), 0.4
    hit = np.zeros(shape, bool)
    for _ in range(110):  # march to the first sample below the surface, then halve the step
        p = T[:3, 3] + near[..., None] * rays
        hit |= p[..., 2] <= surface(p[..., 0], p[..., 1])[0]
        near = np.where(hit, near, near + step)
    for _ in range(12):
        step /= 2
        p = T[:3, 3] + (near - step)[..., None] * rays
        near = np.where(p[..., 2] <= surface(p[..., 0], p[..., 1])[0], near - step, near)
    p = T[:3, 3] + near[..., None] * rays
    hit &= (np.abs(p[..., 0]) < 14) & (np.abs(p[..., 1]) < 12)
    _, label, _ = surface(p[..., 0], p[..., 1])
    e = 0.15
    tilt = (surface(p[..., 0] - e, p[..., 1])[0] - surface(p[..., 0] + e, p[..., 1] - e)[0]) / e
    light = 0.75 + 0.25 * np.tanh(tilt) + 0.05 * np.sin(9 * p[..., 0]) * np.sin(8 * p[..., 1])
    colours = np.array([PALETTE.get(k, (0, 0, 0)) for k in range(6)])  # type: ignore[call-overload]
    image = np.where(hit[..., None], colours[label] * light[..., None] * 0.8 + 30, (150, 185, 220))
    points = np.where(hit[..., None], p, np.nan).astype(np.float32)
    evidence = (np.eye(6, dtype=np.float32)[label] * hit[..., None])[..., 1:]
    lattice = Lattice(4 * W, 4 * H, np.array([[0.25, 0, 0], [0, 0.25, 0]]), K * [[4], [4], [1]], (-0.01, 0.0, 0.0, 0.0))
    return View(
        name, points, np.where(hit, 3, 0).astype(np.float32), np.ascontiguousarray(evidence), T, K,
        np.clip(image, 0, 255).astype(np.uint8), lattice,
    )  # fmt: skip


def example_observations(count: int = 2, shape: tuple[int, int] = (40, 60)) -> Observations:
    """Observations of the example with everything that our own stages would add."""
    return Observations(
        tuple(example_view(f"IMG_{i:04d}.JPG", 0.4 + 1.9 * i, shape) for i in range(count)),
        up=np.array([0.0, 0.0, 1.0]),
        metres_per_unit=1.0,
        georeference=UTM,
        unplaced=(Unplaced("IMG_0099.JPG", "too few matches"),),
        doubts=("The focal length is from EXIF.",),
        source={"reconstructor": "photogrammetry"},
    )


def example_site(
    georeferenced: bool = True, metric: bool = True, cell: float = 0.1, shape: tuple[int, int] = (60, 90)
) -> Site:
    """The whole example."""
    views = [example_view(f"IMG_{i:04d}.JPG", 0.4 + 1.9 * i, shape) for i in range(2)]
    mapped = []
    for view in views:
        label = np.where(view.confidence > 0, view.evidence.argmax(-1) + 1, NOT_OBSERVED).astype(np.uint8)
        mapped.append(MappedView(view.name, label, view.K_cam, view.T_R_cam, view.image, view.lattice))
    xyz = np.concatenate([view.points[view.confidence > 0] for view in views])
    _, label, owner = surface(xyz[:, 0].astype(float), xyz[:, 1].astype(float))
    points = FusedPoints(
        xyz=xyz,
        label=label,
        confidence=np.linspace(0, 1, len(xyz), dtype=np.float32),
        rgb=np.concatenate([v.image[v.confidence > 0] for v in views if v.image is not None]),
        object_id=owner.astype(np.int32),
        support=np.where(np.isin(label, (1, 2)), Support.TERRAIN, Support.NON_TERRAIN).astype(np.uint8),
    )
    run = {
        "config": {"tau": 0.4, "voxel": {"size": None}},
        "seconds": 1.5,
        "cached": True,
        "peak": None,
        "inputs": {"IMG_0000.JPG": "sha256:00"},
    }
    return Site(
        example_map(georeferenced, metric, cell),
        points,
        tuple(mapped),
        (Unplaced("IMG_0099.JPG", "too few matches"),),
        run,
    )


def misses(view: View) -> float:
    """Median distance of a view's points from their own pixels [px], by the plainest formula."""
    p = transform(invert_rigid(view.T_R_cam), view.points[view.confidence > 0].astype(float))
    row, col = np.nonzero(view.confidence > 0)
    u = view.K_cam[0, 0] * p[:, 0] / p[:, 2] + view.K_cam[0, 2]
    v = view.K_cam[1, 1] * p[:, 1] / p[:, 2] + view.K_cam[1, 2]
    return float(np.median(np.hypot(u - col - 0.5, v - row - 0.5)))
