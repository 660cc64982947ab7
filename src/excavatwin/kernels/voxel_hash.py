"""From points to occupied voxels, and from points to one sample a view and voxel."""

from __future__ import annotations

import numpy as np
from numba import njit

#: Bits of a packed voxel index per axis: three of them fill a non-negative int64.
BITS = 21


@njit(cache=True)
def pack(ijk: np.ndarray) -> np.ndarray:
    """Integer voxel coordinates (N, 3), each in [0, 2^21), as one int64 key, x slowest."""
    key = np.empty(len(ijk), np.int64)
    for i in range(len(ijk)):
        key[i] = (np.int64(ijk[i, 0]) << (2 * BITS)) | (np.int64(ijk[i, 1]) << BITS) | np.int64(ijk[i, 2])
    return key


@njit(cache=True)
def _hash(key: np.int64, mask: np.int64) -> np.int64:
    h = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)  # Fibonacci hashing: spreads the low bits of neighbours
    return np.int64(h >> np.uint64(20)) & mask


@njit(cache=True)
def group_keys(key: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Group equal keys by open addressing.

    Returns:
        (group of every key (N,) int32, in ascending order of the distinct keys; the distinct keys (J,) ascending).
    """
    n = len(key)
    size = 16
    while size < 2 * n:
        size *= 2
    mask = np.int64(size - 1)
    slot_key = np.full(size, -1, np.int64)
    slot_id = np.empty(size, np.int32)
    first_id = np.empty(n, np.int32)
    distinct = np.empty(n, np.int64)
    count = 0
    for i in range(n):
        h = _hash(key[i], mask)
        while slot_key[h] != -1 and slot_key[h] != key[i]:
            h = (h + 1) & mask
        if slot_key[h] == -1:
            slot_key[h] = key[i]
            slot_id[h] = count
            distinct[count] = key[i]
            count += 1
        first_id[i] = slot_id[h]
    distinct = distinct[:count].copy()
    order = np.argsort(distinct)  # canonical order: independent of the order of the views
    rank = np.empty(count, np.int32)
    for r in range(count):
        rank[order[r]] = r
    for i in range(n):
        first_id[i] = rank[first_id[i]]
    return first_id, distinct[order]


@njit(cache=True)
def group_by_view(voxel: np.ndarray, view: np.ndarray, n_voxels: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One sample for every (view, voxel) pair that occurs; ``view`` must be ascending.

    Returns:
        (sample of every point (N,) int32, voxel of every sample (M,) int32, view of every sample (M,) int32).
    """
    n = len(voxel)
    last_view = np.full(n_voxels, -1, np.int32)
    last_sample = np.empty(n_voxels, np.int32)
    sample = np.empty(n, np.int32)
    sample_voxel = np.empty(n, np.int32)
    sample_view = np.empty(n, np.int32)
    count = 0
    for i in range(n):
        j, s = voxel[i], view[i]
        if last_view[j] != s:
            last_view[j] = s
            last_sample[j] = count
            sample_voxel[count] = j
            sample_view[count] = s
            count += 1
        sample[i] = last_sample[j]
    return sample, sample_voxel[:count].copy(), sample_view[:count].copy()


@njit(cache=True)
def group_means(values: np.ndarray, group: np.ndarray, n_groups: int) -> np.ndarray:
    """Mean of the rows of ``values`` (N, C) in every group, summed in float64; (n_groups, C) float32."""
    channels = values.shape[1]
    total = np.zeros((n_groups, channels), np.float64)
    count = np.zeros(n_groups, np.int64)
    for i in range(len(group)):
        g = group[i]
        count[g] += 1
        for c in range(channels):
            total[g, c] += values[i, c]
    mean = np.zeros((n_groups, channels), np.float32)
    for g in range(n_groups):
        if count[g] > 0:
            for c in range(channels):
                mean[g, c] = total[g, c] / count[g]
    return mean
