"""Rendered views on the lattices of networks, and whether a prediction is their truth up to one similarity."""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

import numpy as np

from excavatwin.backbones.lattices import Fit, fit, lattice_shape
from excavatwin.contract.reprojection import reprojection
from excavatwin.scene.frames import umeyama
from excavatwin.simulation import DigSite, orbit, render_view
from excavatwin.simulation.camera import Camera

STAND_INS = Path(__file__).parent / "stand_ins"
SITE = DigSite(cell=0.1, margin=4.0)


@lru_cache(maxsize=4)
def photos(width: int, height: int, views: int = 3):
    """Rendered photos with their truth and K.

    The principal point lies half a pixel beyond the middle, at (W + 1) / 2: the only one that a network can mean which
    delivers W / 2 and counts pixel centres at whole numbers.
    """
    cameras = orbit(18, width=width + 1, aspect=1.0)[:views]
    cameras = [Camera(width + 1, height + 1, camera.focal, camera.T_M_cam) for camera in cameras]
    rendered = [render_view(SITE, camera, samples=1) for camera in cameras]
    images = np.stack([view.image[:height, :width] for view in rendered])
    depth = np.stack([view.depth[:height, :width] for view in rendered])
    return images, depth, np.stack([camera.T_M_cam for camera in cameras]), np.stack([c.K_cam for c in cameras])


def truth_on_lattice(width: int, height: int, long_side: int, multiple: int = 14, mode: str = "crop", views: int = 3):
    """Truth (see ``stand_ins/rendered_truth``) of photos of a size, brought onto a lattice as the driver does."""
    from rendered_truth import Truth

    images, depth, T, K = photos(width, height, views)
    onto: Fit = fit((width, height), lattice_shape((width, height), long_side, multiple, mode), mode)
    assert onto.resized == (width, height), "the truth cannot be resampled exactly"
    moved = np.vstack([onto.affine, [0, 0, 1]]) @ K
    pictures = np.stack([onto.image(image) for image in images])
    rows, cols, from_rows, from_cols = onto._overlap()
    on_lattice = np.full(pictures.shape[:3], np.nan)
    on_lattice[:, rows, cols] = depth[:, from_rows, from_cols]
    return Truth(pictures, on_lattice, T.copy(), moved)


def weights_folder(folder: Path, truth, settings: dict | None = None, **more) -> str:
    """A folder as the hub keeps it, whose tensors are the truth."""
    from safetensors.torch import save_file

    folder.mkdir(parents=True, exist_ok=True)
    save_file(truth.state() | more, folder / "model.safetensors")
    (folder / "config.json").write_text(json.dumps(settings or {}))
    return str(folder)


def assert_true(prediction, truth, metric: bool = False) -> None:
    """Whether points, poses and K are the truth up to one similarity for all views.

    Raises:
        AssertionError: they are not.
    """
    S, H, W = truth.depth.shape
    assert prediction.points.shape == (S, H, W, 3)
    assert prediction.points.dtype == np.float32
    assert prediction.confidence.shape == (S, H, W)
    assert prediction.confidence.dtype == np.float32
    assert np.isfinite(prediction.confidence).all()
    assert (prediction.confidence >= 0).all()
    known = np.stack([truth.points(s) for s in range(S)])
    use = np.isfinite(known).all(-1) & np.isfinite(prediction.points).all(-1)
    assert use.sum() > 0.5 * np.isfinite(truth.depth).sum()
    source, target = prediction.points[use][::31].astype(float), known[use][::31]
    s, R, t = umeyama(source, target, np.ones(len(source)))
    miss = np.linalg.norm(s * prediction.points[use] @ R.T + t - known[use], axis=-1)
    assert miss.max() < 5e-3, f"points miss the truth by up to {miss.max():.4f} m"
    assert_cameras(prediction, truth, s, R, t)
    assert prediction.metric == metric
    if metric:
        assert abs(s - 1) < 1e-3
    for view in range(S):
        there = np.where(np.isfinite(truth.depth[view])[..., None], prediction.points[view], np.float32(np.nan))
        found = reprojection(there, prediction.T_world_cam[view], prediction.K_cam[view])
        assert found is not None
        assert found.median < 0.05, found


def assert_cameras(prediction, truth, s, R, t) -> None:
    """Whether poses, after the similarity, and K are the truth."""
    assert prediction.T_world_cam.dtype == prediction.K_cam.dtype == np.float64
    centres = s * prediction.T_world_cam[:, :3, 3] @ R.T + t
    assert np.linalg.norm(centres - truth.T[:, :3, 3], axis=-1).max() < 5e-3
    turned = R @ prediction.T_world_cam[:, :3, :3]
    assert np.abs(turned - truth.T[:, :3, :3]).max() < 1e-4
    assert np.abs(np.linalg.det(turned) - 1).max() < 1e-9
    assert np.allclose(prediction.K_cam, truth.K, rtol=1e-4, atol=0.02), (prediction.K_cam[0], truth.K[0])


@contextmanager
def stand_ins() -> Iterator[None]:
    """Inside, the stand-ins are importable; outside, nothing is left of them."""
    sys.path.insert(0, str(STAND_INS))
    importlib.invalidate_caches()
    try:
        yield
    finally:
        sys.path.remove(str(STAND_INS))
        for name in [name for name in sys.modules if name.partition(".")[0] in _PACKAGES]:
            del sys.modules[name]


_PACKAGES = ("vggt", "pi3", "mapanything", "uniception", "dust3r", "mast3r", "roma", "rendered_truth")


def swapped_channels(images, *arguments):
    """What an adapter would give the network that forgot that images are RGB."""
    from excavatwin.backbones.reconstructors.tensors import pictures

    return pictures(images[..., ::-1], *arguments)
