"""Beams of a laser scanner: many origins, one direction each."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from excavatwin.kernels.ray_tracing import ground_class, meet


@njit(cache=True, parallel=True)
def returns(ground, bodies, ground_label, origin, direction, far):
    """First returns of beams (n, 3), (n, 3) of unit length.

    Returns:
        Range (n,), inf where there is none before ``far``; body index (n,), -1 the ground, -2 nothing; task class (n,),
        255 for nothing.
    """
    n = origin.shape[0]
    t, index, label = np.empty(n), np.empty(n, np.int64), np.full(n, np.uint8(255), np.uint8)
    for k in prange(n):
        t[k], index[k] = meet(ground, bodies, origin[k], direction[k], far)
        if t[k] >= far:
            t[k], index[k] = np.inf, -2
        elif index[k] == -1:
            p = origin[k] + t[k] * direction[k]
            label[k] = ground_class(ground, ground_label, p[0], p[1])
        elif index[k] >= 0:
            label[k] = bodies.label[index[k]]
    return t, index, label
