"""Loop closures: where a sequence comes back to a place, its chunks must agree; what they miss each other by is drift.

A place seen again is proven by matched features whose points fit one similarity, measured by one more prediction of
photos from both chunks, and judged by the matched features, which took no part in that measurement.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8

from excavatwin.backbones.sequence.alignment import Pairs, align, joined, shared_pairs
from excavatwin.backbones.sequence.chunking import Chunking
from excavatwin.backbones.sequence.pose_graph import Edge, optimised
from excavatwin.backbones.sequence.revisits import Revisit, matched_pairs, revisits, sights
from excavatwin.backbones.sequence.similarities import Matrix, inverse, scale_of
from excavatwin.backbones.sequence.store import Chunk

LEAST_MATCHES = 20
"""Matched features that fit one similarity, of which at least ``LEAST_SHARE`` of all: less proves nothing."""
LEAST_SHARE = 0.3
SCALE = 2.0
"""Neighbouring and other chunks differ in scale from what the chain says by less than this factor."""
SOUND = 0.6
"""Share of the pairs that must agree when the joint prediction is aligned with either chunk."""

Joint = Callable[[tuple[int, ...]], Chunk]
"""Predicts some photos together."""


@dataclass(frozen=True)
class Loop:
    """A place that was seen again."""

    edge: Edge
    matches: Pairs
    """Matched features of chunk b and chunk a: they judge the edge, and did not make it."""

    def gap(self, frames: Sequence[Matrix]) -> float:
        """By how much the chunks miss each other there: median, as a share of the distance from the camera."""
        between = inverse(frames[self.edge.a]) @ frames[self.edge.b]
        return float(np.median(self.matches.residual(between)))


@dataclass(frozen=True)
class Closed:
    """The chain after its loops were closed."""

    frames: list[Matrix]
    loops: tuple[Loop, ...]
    """That were accepted."""
    tried: int
    """Pairs of photos that were compared."""
    before: float
    """Median gap of the loops in the chain alone (share of the viewing distance); NaN without loops."""
    after: float


def close(
    chunks: Sequence[Chunk],
    owned: Sequence[range],
    chain: list[Matrix],
    seams: Sequence[Edge],
    image: Callable[[int], UInt8[np.ndarray, "H W 3"]],
    joint: Joint,
    chunking: Chunking,
    size: int,
) -> Closed:
    """Find places seen again, measure them, and spread the drift; the chain stays as it is where that does not help.

    Args:
        chunks: with their predictions on disk.
        owned: photos that are taken from each.
        chain: their frames from neighbours alone.
        seams: the edges between neighbours.
        image: a photo on the lattice.
        joint: asks the network about photos of two chunks.
        chunking: how many loops are wanted, and what agrees.
        size: photos of a chunk.
    """
    seen = sights(chunks, owned)
    found: list[Loop] = []
    closed = dict.fromkeys(range(len(chunks)), 0)
    tried = 0
    for one in revisits(seen, chain, chunks, chunking.loops):
        if min(closed[one.a], closed[one.b]) >= chunking.loops:
            continue
        tried += 1
        matches = _proven(one, chunks, chain, image, chunking.tolerance)
        loop = None if matches is None else _measured(one, chunks, matches, joint, chunking, size)
        if loop is not None:
            found.append(loop)
            closed[one.a] += 1
            closed[one.b] += 1
    return _spread(chain, seams, found, tried)


def _proven(
    one: Revisit,
    chunks: Sequence[Chunk],
    chain: Sequence[Matrix],
    image: Callable[[int], UInt8[np.ndarray, "H W 3"]],
    tolerance: float,
) -> Pairs | None:
    """The matches that fit one similarity of a plausible scale; None when they are too few."""
    pairs = matched_pairs(chunks[one.a], chunks[one.b], one, image(one.photo_a), image(one.photo_b))
    fit = align(pairs, joined([]), tolerance)
    if fit is None:
        return None
    fits = pairs.residual(fit.S_a_b) <= tolerance
    expected = scale_of(inverse(chain[one.a]) @ chain[one.b])
    if (
        fits.sum() < LEAST_MATCHES
        or fits.mean() < LEAST_SHARE
        or not 1 / SCALE < scale_of(fit.S_a_b) / expected < SCALE
    ):
        return None
    return Pairs(pairs.a[fits], pairs.b[fits], pairs.distance[fits], pairs.weight[fits])


def _measured(
    one: Revisit, chunks: Sequence[Chunk], matches: Pairs, joint: Joint, chunking: Chunking, size: int
) -> Loop | None:
    """The similarity between two chunks by way of a joint prediction; None when it does not hold."""
    a, b = chunks[one.a], chunks[one.b]
    many = chunking.overlap(size)
    both = joint((*_around(a, one.photo_a, many), *_around(b, one.photo_b, many)))
    try:
        S_a_J = align(*shared_pairs(a, both), chunking.tolerance)
        S_b_J = align(*shared_pairs(b, both), chunking.tolerance)
    finally:
        both.delete()
    if S_a_J is None or S_b_J is None or min(S_a_J.agreeing, S_b_J.agreeing) < SOUND:
        return None
    S_a_b = S_a_J.S_a_b @ inverse(S_b_J.S_a_b)
    if np.median(matches.residual(S_a_b)) > chunking.tolerance:
        return None
    middle = S_b_J.S_a_b[:3, :3] @ S_b_J.middle + S_b_J.S_a_b[:3, 3]
    reach = scale_of(S_b_J.S_a_b) * S_b_J.reach
    edge = Edge(one.a, one.b, S_a_b, float(np.hypot(S_a_J.miss, S_b_J.miss)), middle, reach)
    return Loop(edge, matches)


def _around(chunk: Chunk, photo: int, many: int) -> tuple[int, ...]:
    """So many sound photos of a chunk around one."""
    sound = [p for p in chunk.photos if p not in chunk.faults]
    at = sound.index(photo)
    first = min(max(0, at - many // 2), max(0, len(sound) - many))
    return tuple(sound[first : first + many])


def _spread(chain: list[Matrix], seams: Sequence[Edge], found: list[Loop], tried: int) -> Closed:
    """Spread the drift; loops that it leaves worse than the chain did are dropped, the worst first."""
    kept = list(found)
    while kept:
        frames = optimised(chain, [*seams, *(loop.edge for loop in kept)])
        before, after = [loop.gap(chain) for loop in kept], [loop.gap(frames) for loop in kept]
        worse = np.array(after) - np.array(before)
        floor = max(1.5 * float(np.median(after)), 2 * float(np.median([loop.edge.miss for loop in kept])))
        bad = [i for i in range(len(kept)) if worse[i] > 0 and after[i] > floor]
        if bad:
            kept.pop(max(bad, key=lambda i: after[i]))
            continue
        if np.median(after) < np.median(before):
            return Closed(frames, tuple(kept), tried, float(np.median(before)), float(np.median(after)))
        break
    nothing = float("nan")
    return Closed(chain, (), tried, nothing, nothing)
