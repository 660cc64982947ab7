"""Four small views of the default site, for the tests of the emulators."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from excavatwin.simulation import DigSite, look_at, orbit, render_view
from excavatwin.simulation.camera import Camera

SITE = DigSite(cell=0.1, margin=4.0)
CAMERAS = orbit(4, width=260, aspect=392 / 518)


@lru_cache
def true_views():
    """The true views of ``CAMERAS``, with colours."""
    return tuple(render_view(SITE, camera, samples=1) for camera in CAMERAS)


@lru_cache
def horizon():
    """A view with sky in it, and its camera."""
    camera = Camera(200, 150, 160.0, look_at(np.array([20.0, 5.0, 4.0]), np.array([0, 0, 3.0])))
    view = render_view(SITE, camera, samples=1)
    assert 0.05 < np.isnan(view.depth).mean() < 0.9
    return view, camera


def by_cell(views, values, cell=0.5):
    """Mean of ``values`` (S, H, W) on ground cells, (S, cells); NaN where a view does not see one."""
    out = []
    for view, value in zip(views, values, strict=True):
        use = np.isfinite(value) & (np.abs(view.points[..., :2]) < 15).all(-1)
        col, row = np.floor((view.points[use][:, :2] + 15) / cell).astype(int).T
        flat, n = row * int(30 / cell) + col, int(30 / cell) ** 2
        count = np.bincount(flat, minlength=n)
        out.append(np.where(count > 2, np.bincount(flat, value[use], n) / np.maximum(count, 1), np.nan))
    return np.array(out)


def agreement(first, second):
    """Correlation of two arrays where both are finite."""
    use = np.isfinite(first) & np.isfinite(second)
    assert use.sum() > 200
    return np.corrcoef(first[use], second[use])[0, 1]
