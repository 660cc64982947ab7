"""The k-nearest-neighbour topology over voxel centres, and clusters within a radius."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32, Int32, Int64


def _cells(xyz: Float32[np.ndarray, "n 3"], edge: float) -> tuple[Int64[np.ndarray, "n 3"], np.ndarray]:
    """Integer cells of edge ``edge`` with coordinates >= 1, and the corner of cell 0."""
    from excavatwin.kernels.voxel_hash import BITS

    origin = xyz.min(axis=0).astype(np.float64) - edge
    cell = np.floor((xyz - origin) / edge).astype(np.int64)
    if cell.max(initial=0) >= (1 << BITS) - 1:
        raise ValueError(f"{edge} is too small a cell for an extent of {np.ptp(xyz, axis=0).max():.3g}")
    return cell, origin


def _sorted_keys(cell: Int64[np.ndarray, "n 3"]) -> tuple[Int64[np.ndarray, "n"], Int64[np.ndarray, "n"]]:
    from excavatwin.kernels.voxel_hash import pack

    key = pack(cell)
    order = np.argsort(key, kind="stable")
    return order, key[order]


def nearest_neighbours(
    xyz: Float32[np.ndarray, "J 3"], k: int, spacing: float
) -> tuple[Int32[np.ndarray, "J k"], Float32[np.ndarray, "J k"]]:
    """Exact k nearest neighbours of every point, nearest first, without itself; k shrinks to J - 1.

    Args:
        xyz: positions.
        k: number of neighbours wanted.
        spacing: typical distance of neighbouring points, for the size of the search cells.
    """
    from scipy.spatial import cKDTree

    from excavatwin.kernels.neighbours import block_neighbours

    J = len(xyz)
    k = min(k, J - 1)
    if k <= 0:
        return np.zeros((J, 0), np.int32), np.zeros((J, 0), np.float32)
    edge = spacing * max(1.0, 0.55 * np.sqrt(k))  # nine cells of a surface hold about 2.7 k points
    cell, origin = _cells(xyz, edge)
    order, key = _sorted_keys(cell)
    occupied, first = np.unique(key, return_index=True)
    start = np.append(first, J).astype(np.int64)
    local = (xyz[order] - origin).astype(np.float32)
    neighbour, distance, complete = block_neighbours(local, np.zeros(3), edge, occupied, start, k)
    stragglers = np.flatnonzero(~complete)
    if len(stragglers):  # sparse fringes, a per cent or so
        d, who = cKDTree(local).query(local[stragglers], k + 1, workers=-1)
        keep = who != stragglers[:, None]
        keep[keep.all(axis=1), -1] = False  # the point itself is not among its k + 1 nearest: drop the farthest
        neighbour[stragglers] = who[keep].reshape(-1, k)
        distance[stragglers] = d[keep].reshape(-1, k)
    result, result_distance = np.empty_like(neighbour), np.empty_like(distance)
    result[order], result_distance[order] = order[neighbour], distance
    return result, result_distance


def radius_clusters(
    xyz: Float32[np.ndarray, "n 3"], radius: float, kind: Int32[np.ndarray, "n"] | None = None
) -> tuple[Int32[np.ndarray, "n"], Int64[np.ndarray, "c"]]:
    """Single-linkage clusters: points of the same ``kind`` at most ``radius`` apart share a cluster.

    Returns:
        (cluster of every point, from 0 in order of its first point; size of every cluster).
    """
    from excavatwin.kernels.union_find import radius_components

    if len(xyz) == 0:
        return np.zeros(0, np.int32), np.zeros(0, np.int64)
    cell, _ = _cells(xyz, radius)
    order, key = _sorted_keys(cell)
    kinds = np.zeros(len(xyz), np.int32) if kind is None else kind.astype(np.int32)
    return radius_components(xyz, kinds, float(radius), order, key, cell)
