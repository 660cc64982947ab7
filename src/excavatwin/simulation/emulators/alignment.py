"""The true similarity of emulated observations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from excavatwin.scene.frames import umeyama
from excavatwin.scene.observations import Observations
from excavatwin.simulation.render import RenderedView


def true_similarity(
    observations: Observations, views: Sequence[RenderedView], step: int = 7, near: float = 2.0
) -> Float64[np.ndarray, "4 4"]:
    """T_M_R: the similarity that brings the observed points closest to the true ones; for oracles.

    Exact when the observations have no other error. Fitted on every ``step``-th pixel along each axis up to ``near``
    median depths, and once more without the worst tenth (flying pixels).
    """
    seen = np.concatenate([view.points[::step, ::step].reshape(-1, 3) for view in observations.views]).astype(float)
    true = np.concatenate([view.points[::step, ::step].reshape(-1, 3) for view in views]).astype(float)
    depth = np.concatenate([view.depth[::step, ::step].ravel() for view in views])
    use = np.isfinite(seen).all(1) & (depth <= near * np.nanmedian(depth))
    seen, true = seen[use], true[use]
    s, R, t = umeyama(seen, true, np.ones(len(seen)))
    miss = np.linalg.norm(s * seen @ R.T + t - true, axis=1)
    s, R, t = umeyama(seen, true, (miss <= np.quantile(miss, 0.9)).astype(float))
    T_M_R = np.eye(4)
    T_M_R[:3, :3], T_M_R[:3, 3] = s * R, t
    return T_M_R
