"""Places that chunks far apart in the sequence have both seen: found by where cameras look."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, UInt8

from excavatwin.backbones.sequence.alignment import Pairs
from excavatwin.backbones.sequence.similarities import Matrix, scale_of
from excavatwin.backbones.sequence.store import Chunk

LOOKED_AT = 200
"""Points of a photo that tell what it looks at."""
APART = 1.0
"""Two photos may show the same place when the middles of what they show lie closer than the sum of the radii."""
TURNED = 60.0
"""Views whose directions differ by more are not compared: features look different [deg]."""
FEATURES = 1500
RATIO = 0.8
"""A match is this much nearer than the next best one (Lowe, IJCV 2004)."""


@dataclass(frozen=True)
class Revisit:
    """Two photos of different chunks that may show the same place."""

    a: int
    """Chunk that comes first."""
    b: int
    photo_a: int
    photo_b: int
    score: float
    """The smaller the better."""


@dataclass(frozen=True)
class Sights:
    """What the photos look at, each in the frame of the chunk that it is taken from."""

    photo: tuple[int, ...]
    chunk: tuple[int, ...]
    middle: Float64[np.ndarray, "n 3"]
    radius: Float64[np.ndarray, "n"]
    direction: Float64[np.ndarray, "n 3"]


def sights(chunks: Sequence[Chunk], owned: Sequence[range]) -> Sights:
    """What every sound photo looks at."""
    photos, chunk_of, middles, radii, directions = [], [], [], [], []
    for k, (chunk, mine) in enumerate(zip(chunks, owned, strict=True)):
        for photo in mine:
            if photo in chunk.faults:
                continue
            _, points = chunk.sample(photo, LOOKED_AT)
            points = points[np.isfinite(points).all(axis=1)]
            if not len(points):
                continue
            middle = np.median(points, axis=0)
            photos.append(photo)
            chunk_of.append(k)
            middles.append(middle)
            radii.append(float(np.median(np.linalg.norm(points - middle, axis=1))))
            directions.append(chunk.T_C_cam[chunk.at(photo)][:3, 2])
    n = len(photos)
    return Sights(
        tuple(photos),
        tuple(chunk_of),
        np.array(middles).reshape(n, 3),
        np.array(radii),
        np.array(directions).reshape(n, 3),
    )


def revisits(seen: Sights, frames: Sequence[Matrix], chunks: Sequence[Chunk], each: int) -> list[Revisit]:
    """For every pair of chunks without a common photo the two photos that most likely show the same place.

    Args:
        seen: what the photos look at.
        frames: of the chunks, as far as they are known by now.
        chunks: to tell which of them share photos.
        each: how many partners are wanted for each chunk; three times as many are given, the best first.
    """
    S = np.array([frames[k] for k in seen.chunk])
    scale = np.array([scale_of(frame) for frame in frames])[list(seen.chunk)]
    middle = np.einsum("nij,nj->ni", S[:, :3, :3], seen.middle) + S[:, :3, 3]
    direction = np.einsum("nij,nj->ni", S[:, :3, :3], seen.direction) / scale[:, None]
    radius = scale * seen.radius
    best: dict[tuple[int, int], Revisit] = {}
    for i, (photo, a) in enumerate(zip(seen.photo, seen.chunk, strict=True)):
        apart = np.linalg.norm(middle[i + 1 :] - middle[i], axis=1) / (radius[i + 1 :] + radius[i])
        turned = np.degrees(np.arccos(np.clip(direction[i + 1 :] @ direction[i], -1, 1)))
        score = apart + turned / TURNED
        for j in np.flatnonzero((apart < APART) & (turned < TURNED)):
            b, other = seen.chunk[i + 1 + j], seen.photo[i + 1 + j]
            known = best.get((a, b))
            if (known is None or score[j] < known.score) and not set(chunks[a].photos) & set(chunks[b].photos):
                best[a, b] = Revisit(a, b, photo, other, float(score[j]))
    tried = dict.fromkeys(range(len(chunks)), 0)
    chosen = []
    for one in sorted(best.values(), key=lambda one: one.score):
        if min(tried[one.a], tried[one.b]) < 3 * each:
            tried[one.a] += 1
            tried[one.b] += 1
            chosen.append(one)
    return chosen


def matched_pairs(
    a: Chunk, b: Chunk, one: Revisit, image_a: UInt8[np.ndarray, "H W 3"], image_b: UInt8[np.ndarray, "H W 3"]
) -> Pairs:
    """Points of chunk b and of chunk a at pixels whose surroundings look the same."""
    uv_a, uv_b = _matches(image_a, image_b)
    H, W = image_a.shape[:2]
    (col_a, row_a), (col_b, row_b) = (np.clip(uv.astype(int), 0, (W - 1, H - 1)).T for uv in (uv_a, uv_b))
    p_a = np.asarray(a.points(one.photo_a)[row_a, col_a], float)
    p_b = np.asarray(b.points(one.photo_b)[row_b, col_b], float)
    use = np.isfinite(p_a).all(axis=1) & np.isfinite(p_b).all(axis=1)
    eye = a.T_C_cam[a.at(one.photo_a)][:3, 3]
    distance = np.maximum(np.linalg.norm(p_a[use] - eye, axis=1), 1e-12)
    return Pairs(p_a[use], p_b[use], distance, np.ones(int(use.sum())))


def _matches(
    image_a: UInt8[np.ndarray, "H W 3"], image_b: UInt8[np.ndarray, "H W 3"]
) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, "n 2"]]:
    """Pixels of mutual best SIFT matches; some are wrong."""
    import cv2

    nothing = np.empty((0, 2)), np.empty((0, 2))
    sift = cv2.SIFT.create(FEATURES)
    found = [sift.detectAndCompute(cv2.cvtColor(np.asarray(x), cv2.COLOR_RGB2GRAY), None) for x in (image_a, image_b)]
    (spots_a, codes_a), (spots_b, codes_b) = found
    if min(len(spots_a), len(spots_b)) < 8:
        return nothing
    there = cv2.BFMatcher().knnMatch(codes_a, codes_b, k=2)
    back = {m.queryIdx: m.trainIdx for m in cv2.BFMatcher().match(codes_b, codes_a)}
    kept = [m for m, n in there if m.distance < RATIO * n.distance and back[m.trainIdx] == m.queryIdx]
    if not kept:
        return nothing
    uv_a = np.array([spots_a[m.queryIdx].pt for m in kept]) + 0.5
    uv_b = np.array([spots_b[m.trainIdx].pt for m in kept]) + 0.5
    return uv_a, uv_b
