"""Photos without their lens: resampled once onto the lattice on which everything else works."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

from excavatwin.backbones.photogrammetry.placement import PlacedCamera, PosedImage
from excavatwin.capture import read_photo
from excavatwin.scene.observations import Lattice
from excavatwin.scene.photo import Photo


def lattice_of(camera: PlacedCamera, long_side: int) -> tuple[Lattice, tuple[int, int]]:
    """The lattice of a photo and its (width, height): the undistorted photo, shrunk but never enlarged."""
    factor = min(1.0, long_side / max(camera.width, camera.height))
    width, height = max(1, round(camera.width * factor)), max(1, round(camera.height * factor))
    affine = np.array([[width / camera.width, 0.0, 0.0], [0.0, height / camera.height, 0.0]])
    return Lattice(camera.width, camera.height, affine, camera.K_photo, camera.distortion), (width, height)


def undistort(camera: PlacedCamera, photo: Photo, long_side: int) -> tuple[PosedImage, Lattice]:
    """The photo on its lattice. With a lens to undo it is resampled at twice the size first, then averaged.

    Raises:
        InputError: the photo can no longer be read.
    """
    lattice, (width, height) = lattice_of(camera, long_side)
    scale = np.diag([lattice.affine[0, 0], lattice.affine[1, 1], 1.0])
    K = scale @ camera.K_photo
    if not any(camera.distortion):
        image = read_photo(photo, long_side=max(width, height))
        return PosedImage(camera.name, _sized(image, width, height), K, camera.T_R_cam), lattice
    source = read_photo(photo, long_side=2 * max(width, height))
    x, y = _sources(camera, source.shape[1], source.shape[0], 2 * width, 2 * height)
    fine = cv2.remap(source, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    inside = (x > -0.5) & (x < source.shape[1] - 0.5) & (y > -0.5) & (y < source.shape[0] - 0.5)
    image = cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA)
    valid = inside.reshape(height, 2, width, 2).all(axis=(1, 3)).astype(np.uint8)
    image[valid == 0] = 0
    return PosedImage(camera.name, image, K, camera.T_R_cam, None if valid.all() else valid), lattice


def _sources(
    camera: PlacedCamera, from_width: int, from_height: int, width: int, height: int
) -> tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    """Where in a photo of the given size each undistorted pixel comes from, in OpenCV's indices (centres at 0)."""
    to_photo = np.diag([camera.width / width, camera.height / height, 1.0])
    to_photo[:2, 2] = 0.5 * np.diag(to_photo)[:2]  # index 0 has its centre at +0.5
    K_index = np.linalg.inv(to_photo) @ camera.K_photo
    from_photo = np.diag([from_width / camera.width, from_height / camera.height, 1.0])
    K_source = from_photo @ camera.K_photo
    k1, k2, p1, p2 = camera.distortion
    u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    a, b = (u - K_index[0, 2]) / K_index[0, 0], (v - K_index[1, 2]) / K_index[1, 1]
    r2 = a * a + b * b
    radial = 1 + k1 * r2 + k2 * r2 * r2
    x = a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a)
    y = b * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b
    x, y = x * K_source[0, 0] + K_source[0, 2] - 0.5, y * K_source[1, 1] + K_source[1, 2] - 0.5
    return x.astype(np.float32), y.astype(np.float32)


def _sized(image: UInt8[np.ndarray, "h w 3"], width: int, height: int) -> UInt8[np.ndarray, "H W 3"]:
    if image.shape[:2] == (height, width):
        return image
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
