"""Where a picture really lies in its photo: prediction by a lattice, likeness, sub-pixel registration."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from excavatwin.contract.smoothing import slow
from excavatwin.scene.observations import Lattice

Affine = Float64[np.ndarray, "2 3"]

#: Blur at which pictures are compared: resampling kernels differ in what is finer [px].
KERNEL = 1.2


@dataclass(frozen=True)
class Source:
    """A photo, shrunk to about the resolution of the lattice."""

    pixels: UInt8[np.ndarray, "h w 3"]
    """RGB as displayed."""
    lattice: Lattice
    """As reported."""

    @staticmethod
    def of(photo: UInt8[np.ndarray, "h w 3"], lattice: Lattice) -> Source:
        """The photo made ready for a lattice; it may come in any size of the same shape."""
        scale = float(np.sqrt(abs(np.linalg.det(lattice.affine[:, :2])))) * lattice.width / photo.shape[1]
        if 0.01 < scale < 0.75:
            size = (max(8, round(photo.shape[1] * scale)), max(8, round(photo.shape[0] * scale)))
            photo = np.asarray(cv2.resize(photo, size, interpolation=cv2.INTER_AREA))
        return Source(photo, lattice)

    def on(self, shape: tuple[int, int], affine: Affine) -> tuple[UInt8[np.ndarray, "H W 3"], Bool[np.ndarray, "H W"]]:
        """The photo resampled by an affine map, and where the lattice shows it."""
        h, w = self.pixels.shape[:2]
        x, y = _sources(self.lattice, shape, affine)
        x, y = x * np.float32(w / self.lattice.width) - 0.5, y * np.float32(h / self.lattice.height) - 0.5
        inside = (x > 0) & (x < w - 1) & (y > 0) & (y < h - 1)
        return np.asarray(cv2.remap(self.pixels, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)), inside


def _sources(
    lattice: Lattice, shape: tuple[int, int], affine: Affine
) -> tuple[Float32[np.ndarray, "H W"], Float32[np.ndarray, "H W"]]:
    """Photo coordinates (centres at +0.5) of every lattice pixel."""
    u, v = np.meshgrid(np.arange(shape[1]) + 0.5, np.arange(shape[0]) + 0.5)
    back = np.linalg.inv(np.vstack([affine, [0, 0, 1]]))
    x, y = back[0, 0] * u + back[0, 1] * v + back[0, 2], back[1, 0] * u + back[1, 1] * v + back[1, 2]
    k1, k2, p1, p2 = lattice.distortion
    if any(lattice.distortion):
        K = lattice.K_photo
        a, b = (x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1]
        r2 = a * a + b * b
        radial = 1 + k1 * r2 + k2 * r2 * r2
        x = (a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a)) * K[0, 0] + K[0, 2]
        y = (b * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b) * K[1, 1] + K[1, 2]
    return x.astype(np.float32), y.astype(np.float32)


def grey(image: UInt8[np.ndarray, "H W 3"], sigma: float = KERNEL) -> Float32[np.ndarray, "H W"]:
    """Blurred mean of the channels: the same in whatever order they are."""
    mean = cv2.transform(image, np.full((1, 3), 1 / 3, np.float32)).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(mean, (0, 0), sigma))


def likeness(a: Float32[np.ndarray, "H W"], b: Float32[np.ndarray, "H W"], where: Bool[np.ndarray, "H W"]) -> float:
    """Correlation of two pictures without their slow changes, where both are real."""
    where = _inner(where)
    if where.sum() < 50:
        return 0.0
    real, sigma = where.astype(np.float32), max(a.shape) / 12
    weight = np.maximum(slow(real, sigma), 1e-3)
    p, q = ((one - slow(one * real, sigma) / weight)[where] for one in (a, b))
    p, q = p - p.mean(), q - q.mean()
    size = float(np.sqrt((p @ p) * (q @ q)))
    return float(p @ q) / size if size > 0 else 0.0


def register(source: Source, image: UInt8[np.ndarray, "H W 3"], affine: Affine) -> tuple[Affine, float]:
    """The affine map under which the photo fits the image best, from a good first guess, and the likeness there.

    Gauss-Newton on six parameters with gain and offset of the brightness (Lucas and Kanade, IJCAI 1981), coarse
    blur first; pixels that do not fit (padding, moving things) lose their weight.
    """
    shape = image.shape[:2]
    alike = 0.0
    for sigma, rounds in ((4.0, 4), (KERNEL, 4)):
        wanted = grey(image, sigma)
        for _ in range(rounds):
            pixels, inside = source.on(shape, affine)
            moved, step = _improved(grey(pixels, sigma), wanted, _inner(inside), affine)
            affine = moved
            if step < 0.01:
                break
    pixels, inside = source.on(shape, affine)
    alike = likeness(grey(pixels), grey(image), inside)
    return affine, alike


def _inner(inside: Bool[np.ndarray, "H W"]) -> Bool[np.ndarray, "H W"]:
    """Without the border, where blurred pictures mix in what is outside."""
    reach = np.ones((9, 9) if min(inside.shape) > 200 else (5, 5), np.uint8)
    inner = cv2.erode(inside.astype(np.uint8), reach, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(inner) > 0


def _improved(
    here: Float32[np.ndarray, "H W"], wanted: Float32[np.ndarray, "H W"], where: Bool[np.ndarray, "H W"], affine: Affine
) -> tuple[Affine, float]:
    """One step; also how far it moves the corners [px]."""
    H, W = here.shape
    at = np.flatnonzero(where)[:: 1 + where.sum() // 30_000]
    if len(at) < 100:
        return affine, 0.0
    gx, gy = (cv2.Sobel(here, cv2.CV_32F, *d, ksize=3, scale=1 / 8).ravel()[at] for d in ((1, 0), (0, 1)))
    x, y = (at % W + 0.5) / W - 0.5, (at // W + 0.5) / H - 0.5
    value = here.ravel()[at]
    J = np.stack([gx, gx * x, gx * y, gy, gy * x, gy * y, value, np.ones_like(value)], axis=1).astype(np.float64)
    target = wanted.ravel()[at].astype(np.float64)
    weight = np.ones(len(at))
    for _ in range(3):
        A = J * weight[:, None]
        solution = np.linalg.lstsq(A.T @ J, A.T @ target, rcond=None)[0]
        residual = np.abs(target - J @ solution)
        weight = 1 / (1 + (residual / max(1.5 * float(np.median(residual)), 1e-3)) ** 2)
    gain = solution[6] if abs(solution[6]) > 0.05 else 1.0
    d = -solution[:6] / gain  # wanted(p) = here(p - d(p)), d = (d0 + d1 x + d2 y, d3 + d4 x + d5 y)
    d = np.clip(d, -6, 6)
    M = np.array([[d[1] / W, d[2] / H], [d[4] / W, d[5] / H]])
    t = np.array([d[0], d[3]]) - M @ np.array([W / 2, H / 2])
    return (np.eye(2) + M) @ affine + np.stack([np.zeros(2), np.zeros(2), t], axis=1), float(np.abs(d).max())
