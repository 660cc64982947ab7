"""How a photo's rays become its pixels, in whatever lens model another program wrote; COLMAP's code computes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float64

from excavatwin.errors import InputError
from excavatwin.scene.observations import Lattice

#: Models that OpenCV's k1, k2, p1, p2 express exactly.
EXACT = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
#: A lens whose distortion k1, k2, p1, p2 do not express to this is refused [px of the lattice].
WORST = 1.0


@dataclass(frozen=True)
class Lens:
    """A camera's intrinsics as COLMAP names and orders them; pixel centres at +0.5 [px]."""

    width: int
    """Width of the photo as stored, before it is turned for display [px]."""
    height: int
    """Height of the photo as stored [px]."""
    model: str
    """``PINHOLE``, ``OPENCV``, ``FULL_OPENCV``, ``OPENCV_FISHEYE``, ..."""
    params: tuple[float, ...]
    """In COLMAP's order, of the photo as stored."""
    turned: int = 0
    """Quarter turns clockwise from the photo as stored to the photo as displayed."""

    @staticmethod
    def pinhole(width: int, height: int, K: Float64[np.ndarray, "3 3"]) -> Lens:
        """A lens without distortion."""
        return Lens(width, height, "PINHOLE", (float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])))

    @staticmethod
    def brown(width: int, height: int, K: Sequence[float], k: Sequence[float], p: Sequence[float]) -> Lens:
        """Brown's lens from (fx, fy, cx, cy), up to three radial and two tangential terms in OpenCV's sense."""
        k1, k2, k3 = (*k, 0.0, 0.0, 0.0)[:3]
        p1, p2 = (*p, 0.0, 0.0)[:2]
        if k3 == 0:
            return Lens(width, height, "OPENCV", (*K, k1, k2, p1, p2))
        return Lens(width, height, "FULL_OPENCV", (*K, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0))

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the photo as displayed [px]."""
        return (self.height, self.width) if self.turned % 2 else (self.width, self.height)

    @property
    def distorts(self) -> bool:
        """Whether rays do not simply go through a pinhole."""
        if self.model not in (*EXACT, "FULL_OPENCV"):
            return True
        return any(self.params[len(self._camera.focal_length_idxs()) + 2 :])

    @cached_property
    def K(self) -> Float64[np.ndarray, "3 3"]:
        """Intrinsics of the photo as displayed [px]."""
        camera = self._camera
        fx, fy, cx, cy = (
            camera.focal_length_x,
            camera.focal_length_y,
            camera.principal_point_x,
            camera.principal_point_y,
        )
        if self.turned % 2:
            fx, fy = fy, fx
        cx, cy = self._turn(np.array([[cx, cy]]))[0]
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])

    def project(self, rays: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
        """Pixels of the photo as displayed where rays (x, y, 1) of the camera that displays it upright arrive."""
        x, y = rays[:, 0], rays[:, 1]
        for _ in range(self.turned % 4):
            x, y = y, -x
        stored = self._camera.img_from_cam(np.stack([x, y, np.ones_like(x)], axis=1))
        return self._turn(np.asarray(stored, float))

    def resized(self, width: int, height: int) -> Lens:
        """The same lens for a photo stored at another size."""
        camera = self._camera
        camera.rescale(width, height)
        return replace(self, width=width, height=height, params=tuple(float(p) for p in camera.params))

    def rotation(self) -> Float64[np.ndarray, "3 3"]:
        """From the camera axes of the photo as displayed to those of the photo as stored."""
        back = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        return np.linalg.matrix_power(back, self.turned % 4)

    def lattice(self, shape: tuple[int, int], where: str) -> tuple[Lattice, Float64[np.ndarray, "3 3"], float]:
        """The undistorted photo shrunk to (H, W): its place in the photo, its intrinsics, its error [px of it].

        Models with more than k1, k2, p1, p2 are fitted by those (and the focal length) over the lattice.

        Raises:
            InputError: they do not fit.
        """
        (width, height), (H, W) = self.size, shape
        K_cam = np.diag([W / width, H / height, 1.0]) @ self.K
        exact = self._exact()
        if exact is not None:
            return Lattice(width, height, _affine(K_cam, self.K), self.K, exact), K_cam, 0.0
        K_photo, distortion, worst = self._fitted(K_cam, shape)
        if not worst <= WORST:
            raise InputError(
                f"{where}: lens model {self.model} cannot be expressed by k1, k2, p1, p2 (off by {worst:.1f} px on the "
                f"lattice); undistort the photos (colmap image_undistorter, or the program's own undistorted images), "
                "and give those photos with the reconstruction of the undistorted images."
            )
        return Lattice(width, height, _affine(K_cam, K_photo), K_photo, distortion), K_cam, worst

    @property
    def _camera(self) -> Any:
        import pycolmap

        try:
            camera = pycolmap.Camera(
                model=self.model, width=self.width, height=self.height, params=[float(p) for p in self.params]
            )
            known = camera.verify_params()
        except (ValueError, RuntimeError, TypeError):
            known = False
        if not known:
            raise InputError(f"lens model {self.model} with {len(self.params)} parameters is unknown.")
        if not camera.focal_length_idxs():
            raise InputError(f"lens model {self.model} has no focal length; give undistorted, perspective images.")
        return camera

    def _turn(self, uv: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
        """Pixels of the stored photo in the photo as displayed."""
        width, height = self.width, self.height
        for _ in range(self.turned % 4):
            uv = np.stack([height - uv[:, 1], uv[:, 0]], axis=1)
            width, height = height, width
        return uv

    def _exact(self) -> tuple[float, float, float, float] | None:
        """k1, k2, p1, p2 of the photo as displayed, where the model has no more than those."""
        if not self.distorts:
            return (0.0, 0.0, 0.0, 0.0)
        extra = self.params[len(self._camera.focal_length_idxs()) + 2 :]
        if self.model not in EXACT and not (self.model == "FULL_OPENCV" and not any(extra[4:])):
            return None
        k1, k2, p1, p2 = (*extra, 0.0, 0.0, 0.0)[:4]
        for _ in range(self.turned % 4):
            p1, p2 = p2, -p1
        return (k1, k2, p1, p2)

    def _fitted(
        self, K_cam: Float64[np.ndarray, "3 3"], shape: tuple[int, int]
    ) -> tuple[Float64[np.ndarray, "3 3"], tuple[float, float, float, float], float]:
        """K and k1, k2, p1, p2 that fit best where the lattice shows the photo, with the worst error [px there]."""
        v, u = np.meshgrid(np.linspace(0, shape[0], 41), np.linspace(0, shape[1], 41), indexing="ij")
        rays = np.stack([(u.ravel() - K_cam[0, 2]) / K_cam[0, 0], (v.ravel() - K_cam[1, 2]) / K_cam[1, 1]], axis=1)
        uv = self.project(rays)
        inside = np.isfinite(uv).all(1) & (uv >= 0).all(1) & (uv <= self.size).all(1)
        x, y = rays[inside].T
        r2, aspect = x * x + y * y, self.K[1, 1] / self.K[0, 0]
        terms = [
            (x, y),
            (x * r2, y * r2),
            (x * r2**2, y * r2**2),
            (2 * x * y, r2 + 2 * y * y),
            (r2 + 2 * x * x, 2 * x * y),
        ]
        A = np.stack([np.concatenate(pair) for pair in terms], axis=1)
        centred = uv[inside] - self.K[:2, 2]
        wanted = np.concatenate([centred[:, 0], centred[:, 1] / aspect])
        found, *_ = np.linalg.lstsq(A, wanted, rcond=None)
        error = np.abs(A @ found - wanted).max(initial=0.0) * K_cam[0, 0] / self.K[0, 0]
        K_photo = self.K.copy()
        K_photo[0, 0], K_photo[1, 1] = found[0], found[0] * aspect
        k1, k2, p1, p2 = (float(value / found[0]) for value in found[1:])
        return K_photo, (k1, k2, p1, p2), float(error)


def _affine(K_cam: Float64[np.ndarray, "3 3"], K_photo: Float64[np.ndarray, "3 3"]) -> Float64[np.ndarray, "2 3"]:
    return (K_cam @ np.linalg.inv(K_photo))[:2]
