"""A dig site with exact truth for the tests and the benchmark of dense stereo: a heightfield, seen by ray marching."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt8
from numba import njit

from excavatwin.backbones.photogrammetry.placement import PosedImage, SparsePoints
from excavatwin.scene.frames import project

HALF = 32.0
"""The scene spans [-HALF, HALF] in x and y [m]."""


@njit(cache=True, inline="always")
def _height(heights, x, y):
    n = heights.shape[0]
    u = min(max((x + HALF) / (2 * HALF) * n - 0.5, 0.0), n - 1.001)
    v = min(max((y + HALF) / (2 * HALF) * n - 0.5, 0.0), n - 1.001)
    i, j = int(v), int(u)
    fv, fu = v - i, u - j
    return (heights[i, j] * (1 - fu) + heights[i, j + 1] * fu) * (1 - fv) + (
        heights[i + 1, j] * (1 - fu) + heights[i + 1, j + 1] * fu
    ) * fv


@njit(cache=True, nogil=True)
def _march(heights, K, T, width, height, sub, top):
    """Depth along the optical axis of the first hit of ``sub`` x ``sub`` rays a pixel; NaN where there is none."""
    depth = np.full((height * sub, width * sub), np.nan, np.float32)
    step = 2 * HALF / heights.shape[0] * 0.7
    for r in range(height * sub):
        for c in range(width * sub):
            a = ((c + 0.5) / sub - K[0, 2]) / K[0, 0]
            b = ((r + 0.5) / sub - K[1, 2]) / K[1, 1]
            dx = T[0, 0] * a + T[0, 1] * b + T[0, 2]
            dy = T[1, 0] * a + T[1, 1] * b + T[1, 2]
            dz = T[2, 0] * a + T[2, 1] * b + T[2, 2]
            if dz >= -1e-3:
                continue
            t = (top - T[2, 3]) / dz
            dt = step / math.sqrt(dx * dx + dy * dy + dz * dz)
            last = t
            while True:
                x, y, z = T[0, 3] + t * dx, T[1, 3] + t * dy, T[2, 3] + t * dz
                if z < -30.0:
                    break
                if abs(x) < HALF and abs(y) < HALF and z <= _height(heights, x, y):
                    lo, hi = last, t
                    for _ in range(12):
                        m = 0.5 * (lo + hi)
                        if T[2, 3] + m * dz <= _height(heights, T[0, 3] + m * dx, T[1, 3] + m * dy):
                            hi = m
                        else:
                            lo = m
                    depth[r, c] = hi
                    break
                last = t
                t += dt
    return depth


def noise(rng: np.random.Generator, n: int, octaves: tuple[int, ...], fall: float = 0.6) -> Float32[np.ndarray, "n n"]:
    """Value noise of zero mean and unit deviation; ``octaves`` are cells per side."""
    out = np.zeros((n, n), np.float32)
    for i, cells in enumerate(octaves):
        coarse = rng.standard_normal((cells + 3, cells + 3)).astype(np.float32)
        out += fall**i * cv2.resize(coarse, (n, n), interpolation=cv2.INTER_CUBIC)
    return (out - out.mean()) / out.std()


@dataclass(frozen=True)
class DigSite:
    """Pit, trench, heap, pipe and a machine of boxes on rolling ground."""

    heights: Float32[np.ndarray, "n n"]
    """[m]; row 0 is y = -HALF."""
    machine: UInt8[np.ndarray, "n n"]
    """1 on the footprint of the machine."""
    texture: tuple[Float32[np.ndarray, "m m"], ...]
    """Brightness over (x, y), (x, z) and (y, z)."""


def dig_site(seed: int = 0, n: int = 1280, contrast: float = 1.0) -> DigSite:
    """The scene at 5 cm cells (n = 1280)."""
    rng = np.random.default_rng(seed)
    axis = (np.arange(n) + 0.5) / n * 2 * HALF - HALF
    x, y = np.meshgrid(axis, axis)
    z = 0.35 * noise(rng, n, (4, 9)) + 0.03 * noise(rng, n, (150, 300))
    pit = np.clip(np.maximum(np.abs(x + 9) / 6, np.abs(y - 6) / 5), 0, 2)
    z -= 2.5 * np.clip((1.25 - pit) / 0.25, 0, 1)  # walls of about 60 degrees
    z -= 1.5 * np.clip((0.6 - np.abs(y + 12 - 0.15 * x)) / 0.1, 0, 1) * (np.abs(x) < 14)  # trench, 1.2 m wide
    z += np.clip(3.0 - 0.65 * np.hypot(x - 10, y + 3), 0, None)  # heap at 33 degrees
    z += np.clip(1.6 - 0.7 * np.hypot((x - 12) / 1.8, y - 13), 0, None)
    rolled = np.abs(x + 4 + 0.4 * y)
    z += np.sqrt(np.clip(0.4**2 - (rolled / 1.08) ** 2, 0, None)) * 1.6 * (np.abs(y + 22) < 4)  # pipe
    ground = z.copy()
    base = float(z[(np.abs(x - 3) < 2) & (np.abs(y - 6) < 3)].mean())
    for cx, cy, lx, ly, top in ((3, 6, 2.6, 4.2, 1.1), (3, 6.2, 2.4, 3.0, 2.4), (2.3, 7.0, 1.0, 1.6, 3.1)):
        z = np.where((np.abs(x - cx) < lx / 2) & (np.abs(y - cy) < ly / 2), base + top, z)
    boom = (np.abs(x - 3.2) < 0.3) & (y < 4.7) & (y > 0.5)
    z = np.where(boom, base + 2.2 + 1.0 * np.sin((4.7 - y) / 4.2 * 2.6), z)  # an arm on a curve down to the ground
    machine = ((z - ground) > 0.15).astype(np.uint8)
    octaves = (12, 40, 120, 320, 800, 1500)
    texture = tuple((118 + 26 * contrast * noise(rng, 2048, octaves, 0.85)).astype(np.float32) for _ in range(3))
    return DigSite(z.astype(np.float32), machine, texture)


def look_at(eye: Float64[np.ndarray, "3"], target: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "4 4"]:
    """Camera-to-world pose (OpenCV axes) of a camera without roll."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0, 0, 1]) if abs(forward[2]) < 0.9999 else np.array([1.0, 0, 0])
    right = right / np.linalg.norm(right)
    T = np.eye(4)
    T[:3, :3] = np.stack([right, np.cross(forward, right), forward], 1)
    T[:3, 3] = eye
    return T


def cameras(kind: str, count: int, width: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """(K, T_R_cam) of a nadir grid or of an oblique orbit at 47 degrees."""
    f = 0.85 * width
    K = np.array([[f, 0, width / 2], [0, f, width * 3 / 8], [0, 0, 1.0]])
    rng = np.random.default_rng(7)
    poses = []
    for i in range(count):
        jitter = rng.normal(0, 0.4, 3)
        if kind == "nadir":
            side = math.ceil(math.sqrt(count))
            eye = np.array([(i % side - (side - 1) / 2) * 8.0, (i // side - (side - 1) / 2) * 6.5, 36.0]) + jitter
            target = eye * [1, 1, 0] + [0, 0.3, 0]
        else:
            angle = 2 * math.pi * i / count
            eye = np.array([27 * math.cos(angle), 27 * math.sin(angle), 28.0]) + jitter
            target = rng.normal(0, 0.5, 3) * [1, 1, 0]
        poses.append((K, look_at(eye, target)))
    return poses


def _shade(site: DigSite, K: np.ndarray, T: np.ndarray, depth: np.ndarray, sub: int) -> Float32[np.ndarray, "h w"]:
    h, w = depth.shape
    u, v = np.meshgrid((np.arange(w) + 0.5) / sub, (np.arange(h) + 0.5) / sub)
    ray = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones_like(u)], -1)
    p = (ray * depth[..., None]) @ T[:3, :3].T + T[:3, 3]
    p = np.where(np.isfinite(p), p, 0).astype(np.float32)

    def sample(image: np.ndarray, a: np.ndarray, b: np.ndarray, span: float = 2 * HALF) -> np.ndarray:
        size = image.shape[0]
        return cv2.remap(
            image,
            ((a / span + 0.5) * size - 0.5).astype(np.float32),
            ((b / span + 0.5) * size - 0.5).astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REFLECT,
        )

    gy, gx = np.gradient(site.heights, 2 * HALF / site.heights.shape[0])
    nx, ny = -sample(gx.astype(np.float32), p[..., 0], p[..., 1]), -sample(gy.astype(np.float32), p[..., 0], p[..., 1])
    length = np.sqrt(nx**2 + ny**2 + 1)
    wx, wy, wz = np.abs(nx) / length, np.abs(ny) / length, 1 / length
    light = 0.55 + 0.45 * np.clip((0.5 * nx + 0.3 * ny + 0.8) / length, 0, 1)
    tone = (
        wz * sample(site.texture[0], p[..., 0], p[..., 1])
        + wx * sample(site.texture[1], p[..., 1], p[..., 2])
        + wy * sample(site.texture[2], p[..., 0], p[..., 2])
    ) / (wx + wy + wz)
    paint = sample(site.machine.astype(np.float32), p[..., 0], p[..., 1])
    tone = tone * (1 - paint) + paint * (60 + tone)
    tone = np.where(np.isfinite(depth), tone * light, 215.0)
    return tone.astype(np.float32)


def render(
    site: DigSite, K: np.ndarray, T: np.ndarray, width: int, height: int, seed: int = 0, grain: float = 2.0
) -> tuple[UInt8[np.ndarray, "H W 3"], Float32[np.ndarray, "H W"]]:
    """The photo of one camera (2 x 2 rays a pixel, sensor noise, exposure jitter) and its exact depth map."""
    rng = np.random.default_rng(seed)
    top = float(site.heights.max()) + 0.01
    fine = _march(site.heights, K, T, width, height, 2, top)
    tone = cv2.resize(_shade(site, K, T, fine, 2), (width, height), interpolation=cv2.INTER_AREA)
    depth = _march(site.heights, K, T, width, height, 1, top)
    tone = tone * rng.uniform(0.93, 1.07) + rng.uniform(-5, 5) + rng.normal(0, grain, tone.shape)
    image = np.clip(np.round(tone[..., None] * [1.04, 1.0, 0.9]), 0, 255).astype(np.uint8)
    return image, depth


def sparse_points(
    views: list[tuple[np.ndarray, np.ndarray]], depths: list[np.ndarray], seed: int = 0, count: int = 300
) -> SparsePoints:
    """Random surface points with the cameras that see them, as structure from motion would leave them."""
    rng = np.random.default_rng(seed)
    xyz = []
    for (K, T), depth in zip(views, depths, strict=True):
        r, c = rng.integers(0, depth.shape[0], count), rng.integers(0, depth.shape[1], count)
        z = depth[r, c].astype(float)
        p = np.stack([(c + 0.5 - K[0, 2]) / K[0, 0] * z, (r + 0.5 - K[1, 2]) / K[1, 1] * z, z], -1)
        xyz.append((p @ T[:3, :3].T + T[:3, 3])[np.isfinite(z)])
    points = np.concatenate(xyz)
    visible = []
    for (K, T), depth in zip(views, depths, strict=True):
        uv, z = project(K, T, points)
        inside = (z > 0) & (uv[:, 0] > 0) & (uv[:, 0] < depth.shape[1]) & (uv[:, 1] > 0) & (uv[:, 1] < depth.shape[0])
        index = np.flatnonzero(inside)
        seen = depth[uv[index, 1].astype(int), uv[index, 0].astype(int)]
        visible.append(index[np.abs(seen - z[index]) < 0.01 * z[index]])
    return SparsePoints(points, tuple(visible))


def photograph(
    site: DigSite, kind: str, count: int, width: int, grain: float = 2.0
) -> tuple[list[PosedImage], SparsePoints, list[Float32[np.ndarray, "H W"]]]:
    """Posed images, sparse points and exact depth maps of one flight over the scene."""
    views = cameras(kind, count, width)
    shots = [render(site, K, T, width, width * 3 // 4, i, grain) for i, (K, T) in enumerate(views)]
    images = [PosedImage(f"{kind}_{i:02d}.jpg", shot[0], *views[i]) for i, shot in enumerate(shots)]
    depths = [shot[1] for shot in shots]
    return images, sparse_points(views, depths), depths
