"""Which photos to compare, and their feature matches.

Descriptors are whole numbers, so that their products are exact in float32 and the matches do not depend on how many
threads the linear algebra uses.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pycolmap
from jaxtyping import Float64, Int64, UInt32
from numba import njit

from excavatwin.backbones.photogrammetry.features import WORKERS, Features
from excavatwin.scene.photo import GpsFix
from excavatwin.scene.progress import Progress

COARSE = 400
"""Features per photo, largest first, that decide which photos look alike."""
GPS_EXTENT = 30.0
"""Within a smaller site the positions of a hand camera (some metres) do not tell neighbours apart [m]."""
EARTH_RADIUS = 6378137.0
"""[m]"""

Pair = tuple[int, int]


def match(a: Features, b: Features, ratio: float, first: int | None = None) -> UInt32[np.ndarray, "m 2"]:
    """Mutual nearest neighbours that pass Lowe's ratio test (Lowe 2004) in both directions; ``first``: largest only."""
    A = a.descriptors[:first].astype(np.float32)
    B = b.descriptors[:first].astype(np.float32)
    if len(A) < 2 or len(B) < 2:
        return np.empty((0, 2), np.uint32)
    return _mutual(A @ B.T, (A**2).sum(1), (B**2).sum(1), np.float32(ratio**2))


@njit(cache=True, nogil=True)
def _mutual(product, a2, b2, ratio2):
    """Matches from inner products and squared norms, in one pass over the product."""
    n, m = product.shape
    row1, row2 = np.full(n, np.inf, np.float32), np.full(n, np.inf, np.float32)
    col1, col2 = np.full(m, np.inf, np.float32), np.full(m, np.inf, np.float32)
    forward, backward = np.zeros(n, np.int64), np.zeros(m, np.int64)
    for i in range(n):
        best, second, at = np.float32(np.inf), np.float32(np.inf), 0
        for j in range(m):
            d = a2[i] + b2[j] - 2 * product[i, j]
            if d < second:
                if d < best:
                    second, best, at = best, d, j
                else:
                    second = d
            if d < col2[j]:
                if d < col1[j]:
                    col2[j], col1[j], backward[j] = col1[j], d, i
                else:
                    col2[j] = d
        row1[i], row2[i], forward[i] = best, second, at
    matches = np.empty((min(n, m), 2), np.uint32)
    count = 0
    for i in range(n):
        j = forward[i]
        if backward[j] == i and row1[i] < ratio2 * row2[i] and col1[j] < ratio2 * col2[j]:
            matches[count, 0], matches[count, 1] = i, j
            count += 1
    return matches[:count].copy()


def choose_pairs(features: Sequence[Features], neighbours: int, exhaustive_up_to: int, ratio: float) -> list[Pair]:
    """Pairs worth matching, sorted: all of a small set, else the nearest by GPS, by looks and by order in time."""
    n = len(features)
    if n <= max(exhaustive_up_to, neighbours + 1):
        return [(i, j) for i in range(n) for j in range(i + 1, n)]
    located = [i for i in range(n) if features[i].photo.gps is not None]
    xy = _metres([features[i].photo.gps for i in located])
    pairs: set[Pair] = set()
    alike = neighbours
    if len(located) >= 0.8 * n and np.ptp(xy, axis=0).max() > GPS_EXTENT:
        alike = neighbours // 3
        pairs |= {_pair(located[i], located[j]) for i, j in _nearest(xy, neighbours - alike)}
    else:
        order = sorted(range(n), key=lambda i: (features[i].photo.time or 0.0, features[i].photo.name))
        pairs |= {_pair(i, j) for step in (1, 2, 3) for i, j in zip(order, order[step:], strict=False)}
    likeness = np.zeros((n, n), int)
    for i in range(n):
        for j in range(i + 1, n):
            likeness[i, j] = likeness[j, i] = len(match(features[i], features[j], ratio, COARSE))
    ranked = np.argsort(-likeness, axis=1, kind="stable")
    return sorted(pairs | {_pair(i, int(j)) for i in range(n) for j in ranked[i, :alike] if likeness[i, j] > 0})


def match_pairs(
    features: Sequence[Features],
    cameras: Sequence[pycolmap.Camera],
    pairs: Sequence[Pair],
    ratio: float,
    seed: int,
    progress: Progress,
) -> dict[Pair, pycolmap.TwoViewGeometry]:
    """Geometrically verified matches of every pair that has enough of them; ``cameras`` are of the shrunk photos."""
    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.random_seed = seed
    options.detect_watermark = False

    def work(pair: Pair) -> pycolmap.TwoViewGeometry | None:
        i, j = pair
        matches = match(features[i], features[j], ratio)
        if len(matches) < options.min_num_inliers:
            return None
        geometry = pycolmap.estimate_two_view_geometry(
            cameras[i],
            features[i].keypoints.astype(float),
            cameras[j],
            features[j].keypoints.astype(float),
            matches,
            options,
        )
        return geometry if len(geometry.inlier_matches) >= options.min_num_inliers else None

    verified: dict[Pair, pycolmap.TwoViewGeometry] = {}
    progress("matching", 0, len(pairs))
    with ThreadPoolExecutor(WORKERS) as pool:
        for done, (pair, geometry) in enumerate(zip(pairs, pool.map(work, pairs), strict=True), 1):
            if geometry is not None:
                verified[pair] = geometry
            progress("matching", done, len(pairs))
    return verified


def _pair(i: int, j: int) -> Pair:
    return (i, j) if i < j else (j, i)


def _metres(fixes: Iterable[GpsFix | None]) -> Float64[np.ndarray, "n 2"]:
    """Positions in metres on a local plane: good enough to find neighbours."""
    lonlat = np.radians([(fix.longitude, fix.latitude) for fix in fixes if fix is not None]).reshape(-1, 2)
    if not len(lonlat):
        return lonlat
    return EARTH_RADIUS * (lonlat - lonlat[0]) * np.array([np.cos(lonlat[0, 1]), 1.0])


def _nearest(xy: Float64[np.ndarray, "n 2"], k: int) -> Int64[np.ndarray, "m 2"]:
    from scipy.spatial import cKDTree

    _, index = cKDTree(xy).query(xy, k=min(k + 1, len(xy)))
    i = np.repeat(np.arange(len(xy)), index.shape[1])
    found = np.stack([i, index.ravel()], 1)
    return found[found[:, 0] != found[:, 1]]
