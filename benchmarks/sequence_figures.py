"""Errors of a reconstructed flight against truth, what seams add to them, and their table: for long_sequences.py."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from excavatwin.scene.frames import umeyama
from excavatwin.scene.observations import Observations
from excavatwin.simulation import DigSite, render_view
from excavatwin.simulation.camera import Camera

CELL = 2.0
"""Errors are averaged on cells of this size before they are compared [m]."""


def scored(site: DigSite, obs: Observations, cameras: tuple[Camera, ...], mine: tuple[range, ...]) -> dict[str, float]:
    """Errors against truth [m], and the extents of what is seen [m]."""
    true = np.stack([render_view(site, camera, samples=0).points[::4, ::4].reshape(-1, 3) for camera in cameras])
    seen = np.stack([np.asarray(view.points[::4, ::4], float).reshape(-1, 3) for view in obs.views])
    seen[~np.isfinite(true).all(-1)] = np.nan
    use = np.isfinite(seen).all(-1)
    s, R, t = umeyama(seen[use], true[use].astype(float), np.ones(int(use.sum())))
    error = s * seen @ R.T + t - true
    for _ in range(3):  # without flying pixels
        miss = np.linalg.norm(error, axis=-1)
        good = use & (miss < np.quantile(miss[use], 0.95))
        s, R, t = umeyama(seen[good], true[good].astype(float), np.ones(int(good.sum())))
        error = s * seen @ R.T + t - true
    miss = np.linalg.norm(error, axis=-1)[use]
    cuts = {part.stop - 1 for part in mine[:-1]}
    steps = {i: step(error[i], error[i + 1], true[i], true[i + 1]) for i in range(len(cameras) - 1)}
    seams = [steps[i] for i in cuts if np.isfinite(steps[i])]
    inside = [value for i, value in steps.items() if i not in cuts and np.isfinite(value)]
    chunk = [np.linalg.norm(np.ptp(true[list(part)][use[list(part)]], axis=0)[:2]) for part in mine]
    return {
        "error_median": float(np.median(miss)),
        "error_p95": float(np.quantile(miss, 0.95)),
        "step_median": float(np.median(seams)) if seams else float("nan"),
        "step_worst": max(seams, default=float("nan")),
        "inside_median": float(np.median(inside)),
        "scene": float(np.linalg.norm(np.ptp(true[use], axis=0)[:2])),
        "chunk": float(np.median(chunk)),
        "height": float(np.median([camera.T_M_cam[2, 3] for camera in cameras])),
    }


def step(a: np.ndarray, b: np.ndarray, at_a: np.ndarray, at_b: np.ndarray) -> float:
    """Median length of the difference of two error fields on the ground that both views see; NaN below 10 cells."""
    means = []
    for error, at in ((a, at_a), (b, at_b)):
        good = np.isfinite(error).all(-1) & np.isfinite(at).all(-1)
        cells: dict[tuple[int, int], list[np.ndarray]] = {}
        for cell, vector in zip(np.floor(at[good, :2] / CELL).astype(int), error[good], strict=True):
            cells.setdefault((int(cell[0]), int(cell[1])), []).append(vector)
        means.append({cell: np.median(vectors, axis=0) for cell, vectors in cells.items() if len(vectors) >= 5})
    both = means[0].keys() & means[1].keys()
    if len(both) < 10:
        return float("nan")
    return float(np.median([np.linalg.norm(means[0][cell] - means[1][cell]) for cell in both]))


COLUMNS: tuple[tuple[str, int, Callable[[dict[str, Any]], str]], ...] = (
    ("", 32, lambda r: r["name"]),
    ("memory", 7, lambda r: f"{r['memory'] / 1e6:.0f} MB"),
    ("time", 6, lambda r: f"{r['seconds']:.0f} s"),
    ("chunks", 6, lambda r: f"{r['chunks']}"),
    ("step m", 6, lambda r: f"{r['step_median']:.3f}"),
    ("worst m", 7, lambda r: f"{r['step_worst']:.3f}"),
    ("of chunk", 8, lambda r: f"{r['step_worst'] / r['chunk']:.2%}"),
    ("of height", 9, lambda r: f"{r['step_worst'] / r['height']:.2%}"),
    ("inside m", 8, lambda r: f"{r['inside_median']:.3f}"),
    ("error m", 7, lambda r: f"{r['error_median']:.2f}"),
    ("p95 m", 6, lambda r: f"{r['error_p95']:.2f}"),
    ("of scene", 8, lambda r: f"{r['error_p95'] / r['scene']:.2%}"),
    ("loops", 22, lambda r: r["loops"]),
    ("drift", 0, lambda r: r["drift"]),
)


def table(rows: list[dict[str, Any]]) -> str:
    """The rows as text."""
    lines = ["  ".join(f"{name:<{width}s}" for name, width, _ in COLUMNS)]
    lines += ["  ".join(f"{text(row):<{width}s}" for _, width, text in COLUMNS) for row in rows]
    return "\n".join(lines)
