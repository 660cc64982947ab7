"""A small rendered site for ``excavatwin check-backbone``, and how far a reconstruction is from its exact truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float32, Float64

from excavatwin.backbones.conformance import Row
from excavatwin.backbones.conformance.report import failed, passed, unchecked

if TYPE_CHECKING:
    from excavatwin.scene.observations import Observations, View
    from excavatwin.scene.progress import Progress

#: Of the photos [px].
WIDTH = 320
VIEWS = 6
#: Neighbours are this part of a circle apart, about 15 degrees.
_CIRCLE = 24
#: Beyond these a reconstruction is not merely poor: centres as a share of the distance, directions [deg], points.
_GROSS = (0.1, 10.0, 0.1)
_NAMES = ("against truth: cameras", "against truth: points", "against truth: scale")


@dataclass(frozen=True, eq=False)
class Known:
    """The truth of one photo."""

    T: Float64[np.ndarray, "4 4"]
    """Camera-to-world, OpenCV axes [m]."""
    points: Float32[np.ndarray, "h w 3"]
    """World point at each pixel of the photo; NaN in the sky [m]."""


def render(folder: Path, progress: Progress) -> dict[str, Known]:
    """Photos as a drone writes them (EXIF, GPS, gimbal) into ``folder``; returns their truth by name."""
    from datetime import datetime, timedelta

    from excavatwin.simulation import DigSite, orbit, render_view
    from excavatwin.simulation.flights import FOCAL_RATIO
    from excavatwin.simulation.recording.drone_photo import write_photo

    folder.mkdir(parents=True)
    site, start = DigSite(cell=0.1, margin=4.0), datetime(2025, 5, 20, 10)
    known = {}
    for number, camera in enumerate(orbit(_CIRCLE, width=WIDTH, focal_ratio=FOCAL_RATIO)[:VIEWS]):
        progress("render", number, VIEWS)
        view = render_view(site, camera)
        name = f"DIG_{number + 1:04d}.jpg"
        write_photo(folder / name, view.image, camera, np.zeros(3), start + timedelta(seconds=5 * number))
        known[name] = Known(camera.T_M_cam, view.points)
    progress("render", VIEWS, VIEWS)
    return known


def truth_rows(observations: Observations | None, known: Mapping[str, Known]) -> tuple[Row, ...]:
    """Errors of cameras, points and scale after the best similarity; only gross ones fail."""
    from excavatwin.scene.frames import umeyama

    views = [] if observations is None else [view for view in observations.views if view.name in known]
    pairs = [_pairs(view, known[view.name]) for view in views]
    points = sum(len(found) for found, _ in pairs)
    if observations is None or points < 50:
        return tuple(unchecked(name, "no points of rendered photos came out of it.") for name in _NAMES)
    found, true = (np.concatenate(part) for part in zip(*pairs, strict=True))
    trusted = np.ones(len(found))
    for _ in range(4):  # what lies far off does not decide the similarity
        s, R, t = umeyama(found, true, trusted)
        miss = np.linalg.norm(s * found @ R.T + t - true, axis=1)
        trusted = (miss <= 3 * np.median(miss) + 1e-9).astype(float)
    reach = float(np.median([np.linalg.norm(known[view.name].points - known[view.name].T[:3, 3], axis=-1)[
        np.isfinite(known[view.name].points[..., 0])].mean() for view in views]))  # fmt: skip
    rows = [_cameras(views, known, (s, R, t), reach), _points(miss, reach)]
    return (*rows, _scale(observations.metres_per_unit, s))


def _pairs(view: View, known: Known) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
    """Points of a view with the true ones of the same pixels of the photo."""
    rows, cols = np.nonzero(np.isfinite(view.points[..., 0]))
    keep = slice(None, None, 1 + len(rows) // 3000)
    rows, cols = rows[keep], cols[keep]
    uv = np.stack([cols + 0.5, rows + 0.5], axis=1)
    h, w = known.points.shape[:2]
    if view.lattice is not None:
        A = view.lattice.affine
        uv = np.linalg.solve(A[:, :2], (uv - A[:, 2]).T).T * (w / view.lattice.width, h / view.lattice.height)
    x, y = np.floor(uv).astype(int).T
    inside = (x >= 0) & (y >= 0) & (x < w) & (y < h)
    found, true = view.points[rows[inside], cols[inside]], known.points[y[inside], x[inside]]
    both = np.isfinite(true[:, 0])
    return found[both].astype(float), true[both].astype(float)


def _cameras(views: list[View], known: Mapping[str, Known], onto: tuple, reach: float) -> Row:
    s, R, t = onto
    centres = [float(np.linalg.norm(s * R @ view.centre + t - known[view.name].T[:3, 3])) for view in views]
    turns = [R @ view.T_R_cam[:3, :3] @ known[view.name].T[:3, :3].T for view in views]
    angles = [float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))) for turn in turns]
    said = (
        f"centres off by {max(centres):.3f} m at most, directions by {max(angles):.2f} degrees, seen from {reach:.0f} m"
    )
    gross = max(centres) > _GROSS[0] * reach or max(angles) > _GROSS[1]
    return failed(_NAMES[0], f"{said}: not the cameras of these photos.") if gross else passed(_NAMES[0], said)


def _points(miss: Float64[np.ndarray, "n"], reach: float) -> Row:
    median, most = float(np.median(miss)), float(np.quantile(miss, 0.9))
    said = f"off by a median of {median:.3f} m ({median / reach:.1%} of the distance), 90 % below {most:.3f} m"
    return failed(_NAMES[1], f"{said}: not this surface.") if median > _GROSS[2] * reach else passed(_NAMES[1], said)


def _scale(metres_per_unit: float | None, s: float) -> Row:
    if metres_per_unit is None:
        return passed(_NAMES[2], f"none is claimed (one unit is {s:.4g} m)")
    return passed(_NAMES[2], f"{metres_per_unit:.4g} m a unit, off by {metres_per_unit / s - 1:+.2%}")
