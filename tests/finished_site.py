"""A simulated site as other programs would have photographed and reconstructed it, with the truth to compare with."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from PIL import Image

from excavatwin.capture import find_photos
from excavatwin.scene.frames import invert_rigid
from excavatwin.simulation import DigSite, orbit, render_view
from excavatwin.simulation.camera import Camera

SITE = DigSite(cell=0.2, margin=4.0)
WIDTH, HEIGHT = 240, 180
#: What is cut off at the left and at the top, so that principal points lie off the middle [px].
LEFT, TOP = 12, 6
CAMERAS = orbit(6, width=WIDTH, radius=17.0, height=13.0)


@dataclass(frozen=True, eq=False)
class Shot:
    """One photo without distortion, and its truth."""

    name: str
    image: np.ndarray
    depth: np.ndarray
    """[m]"""
    points: np.ndarray
    T: np.ndarray
    """Camera-to-world, OpenCV axes."""
    K: np.ndarray
    """Pixel centres at +0.5."""


@lru_cache
def shots() -> tuple[Shot, ...]:
    """Photos whose principal point is not in the middle."""
    found = []
    for number, camera in enumerate(CAMERAS):
        view = render_view(SITE, camera, samples=1)
        K = camera.K_cam.copy()
        K[:2, 2] -= LEFT, TOP
        part = np.s_[TOP:, LEFT:]
        found.append(
            Shot(f"shot_{number:02d}.png", view.image[part], view.depth[part], view.points[part], camera.T_M_cam, K)
        )
    return tuple(found)


@lru_cache
def sharp(number: int) -> tuple[Camera, np.ndarray]:
    """A finer and wider camera at the place of a shot, with its true depth: to ask for the depth of any ray."""
    camera = Camera(800, 640, 0.62 * 800, CAMERAS[number].T_M_cam)
    return camera, render_view(SITE, camera, samples=0).depth


def true_depth(number: int, rays: np.ndarray) -> np.ndarray:
    """Depth along the optical axis of rays (n, 2) at unit depth, between pixels of ``sharp``; NaN next to edges."""
    camera, depth = sharp(number)
    x, y = (rays * camera.focal + (camera.width / 2, camera.height / 2) - 0.5).T
    inside = (x >= 0) & (y >= 0) & (x < camera.width - 1) & (y < camera.height - 1)
    out = np.full(len(rays), np.nan)
    x, y = x[inside], y[inside]
    j, i = x.astype(int), y.astype(int)
    a, b, c, d = depth[i, j], depth[i, j + 1], depth[i + 1, j], depth[i + 1, j + 1]
    four = np.stack([a, b, c, d])
    fx, fy = x - j, y - i
    value = (a * (1 - fx) + b * fx) * (1 - fy) + (c * (1 - fx) + d * fx) * fy
    out[inside] = np.where(np.ptp(four, axis=0) < 0.02 * value, value, np.nan)
    return out


def write_photos(folder: Path, images=None, suffix: str = ".png", orientation: int = 1):
    """The shots (or other images by name) as files, read back as photos."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, image in (images or {shot.name: shot.image for shot in shots()}).items():
        picture = Image.fromarray(image)
        exif = picture.getexif()
        exif[0x0112] = orientation
        picture.save((folder / name).with_suffix(suffix), exif=exif)
    return find_photos(folder)


def depth_error(view, number: int, T: np.ndarray | None = None, metres: float = 1.0) -> np.ndarray:
    """|depth - truth| of the pixels that have both, relative.

    Args:
        T: where frame R has the camera; the true pose when None.
        metres: of one unit.
    """
    H, W = view.shape
    v, u = np.mgrid[:H, :W] + 0.5
    K = view.K_cam
    rays = np.stack([(u.ravel() - K[0, 2]) / K[0, 0], (v.ravel() - K[1, 2]) / K[1, 1]], axis=1)
    inverse = invert_rigid(view.T_R_cam if T is None else T)
    found = (view.points.reshape(-1, 3).astype(float) @ inverse[:3, :3].T + inverse[:3, 3])[:, 2] * metres
    true = true_depth(number, rays)
    both = np.isfinite(found) & np.isfinite(true)
    return np.abs(found[both] / true[both] - 1)


def assert_true(obs, *, poses=True, tolerance=2e-3, most=0.03, covered=0.85, metres=1.0, shift=(0, 0, 0)) -> None:
    """Views equal the truth: pose, depth (median below tolerance, 95 % below ``most``), coverage, image."""
    assert len(obs.views) == len(CAMERAS)
    for number, view in enumerate(obs.views):
        shot = shots()[number]
        assert Path(view.name).stem == Path(shot.name).stem
        if poses:
            T = shot.T.copy()
            T[:3, 3] = T[:3, 3] / metres - shift
            np.testing.assert_allclose(view.T_R_cam, T, atol=1e-5 * max(1, 1 / metres))
        error = depth_error(view, number, metres=metres)
        assert np.median(error) < tolerance, (view.name, np.median(error))
        assert np.quantile(error, 0.95) < most, (view.name, np.quantile(error, 0.95))
        assert np.isfinite(view.points[..., 0]).mean() > covered * np.isfinite(shot.depth).mean(), view.name
        assert not view.evidence.any()
        assert np.array_equal(np.isfinite(view.points[..., 0]), view.confidence > 0)


def write_colmap(folder: Path, cameras, poses, *, binary: bool = True, points=None) -> None:
    """A sparse model by COLMAP's own writer. ``cameras``: name -> pycolmap camera parameters; poses camera-to-world."""
    import pycolmap

    model = pycolmap.Reconstruction()
    for number, (name, spec) in enumerate(cameras.items(), 1):
        model.add_camera_with_trivial_rig(pycolmap.Camera(camera_id=number, **spec))
        T = invert_rigid(poses[name])
        image = pycolmap.Image(name=name, keypoints=np.zeros((0, 2)), camera_id=number, image_id=number)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(T[:3]))
    for xyz in np.zeros((0, 3)) if points is None else points:
        model.add_point3D(np.asarray(xyz, float), pycolmap.Track(), np.zeros(3, np.uint8))
    folder.mkdir(parents=True, exist_ok=True)
    (model.write_binary if binary else model.write_text)(folder)


def spec(model: str, width: int, height: int, *params: float) -> dict:
    """Arguments of a COLMAP camera."""
    return {"model": model, "width": width, "height": height, "params": [float(p) for p in params]}


def distorted(camera, shot: Shot) -> np.ndarray:
    """The shot as a camera of COLMAP with a lens would have taken it (its own code inverts the lens)."""
    import cv2

    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    xy = camera.cam_from_img(np.stack([u.ravel(), v.ravel()], axis=1))
    at = (xy * (shot.K[0, 0], shot.K[1, 1]) + shot.K[:2, 2] - 0.5).astype(np.float32)
    at = at.reshape(camera.height, camera.width, 2)
    return cv2.remap(shot.image, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
