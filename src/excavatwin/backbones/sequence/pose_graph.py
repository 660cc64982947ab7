"""The frames of all chunks from similarities measured between some of them: drift is spread over the chain.

Levenberg's method on the group of similarities, in tangent vectors (Strasdat, Montiel and Davison, RSS 2010).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from excavatwin.backbones.sequence.alignment import Alignment
from excavatwin.backbones.sequence.similarities import Matrix, Tangent, exp, inverse, log, similarity

ROUNDS = 50
CONVERGED = 1e-10
STEP = 1e-6
"""Of the numerical derivatives; the tangent's unit is the size of what two chunks share."""
LEAST_MISS = 1e-4
"""No similarity is trusted more than this (share of the distance)."""


@dataclass(frozen=True)
class Edge:
    """A similarity that was measured between two chunks."""

    a: int
    b: int
    S_a_b: Matrix
    """From the frame of chunk b into that of chunk a."""
    miss: float
    """How well it is known: median residual as a share of the distance."""
    middle: Float64[np.ndarray, "3"]
    """Of what both chunks saw, in frame b."""
    reach: float
    """Its root mean square distance from there [su of b]."""

    @staticmethod
    def of(a: int, b: int, found: Alignment) -> Edge:
        """The edge of an alignment of neighbours."""
        return Edge(a, b, found.S_a_b, found.miss, found.middle, found.reach)

    def error(self, S_R_a: Matrix, S_R_b: Matrix) -> Tangent:
        """What is left between where the chunks are and where they were measured to be.

        In frame b, about the middle of what both saw and in units of its size: so that a turn, a shift and a change of
        scale of equal numbers move the points equally far.
        """
        size = similarity(self.reach, np.eye(3), self.middle)
        left = inverse(size) @ inverse(self.S_a_b) @ inverse(S_R_a) @ S_R_b @ size
        return log(left) / max(self.miss, LEAST_MISS)


def chained(edges: Sequence[Edge], count: int) -> list[Matrix]:
    """The frames of chunks 0, 1, ... in that of chunk 0, from the edges between neighbours alone."""
    frames = [np.eye(4)]
    following = {edge.b: edge for edge in edges if edge.a == edge.b - 1}
    for k in range(1, count):
        frames.append(frames[-1] @ following[k].S_a_b)
    return frames


def cost(frames: Sequence[Matrix], edges: Sequence[Edge]) -> float:
    """Sum of the squared errors of all edges."""
    return float(sum((edge.error(frames[edge.a], frames[edge.b]) ** 2).sum() for edge in edges))


def optimised(frames: Sequence[Matrix], edges: Sequence[Edge]) -> list[Matrix]:
    """The frames that agree best with all edges; chunk 0 stays where it is. Never worse than what was given."""
    best = [np.array(frame) for frame in frames]
    units = _units(edges, len(best))
    now, damping = cost(best, edges), 1e-4
    for _ in range(ROUNDS):
        A, g = _normal_equations(best, edges, units)
        step = np.linalg.solve(A + damping * np.diag(np.diag(A)) + 1e-12 * np.eye(len(g)), -g).reshape(-1, 7)
        tried = [best[0], *(_nudged(S, units[k], step[k - 1]) for k, S in enumerate(best) if k)]
        then = cost(tried, edges)
        if then < now:
            converged = now - then < CONVERGED * now
            best, now, damping = tried, then, damping / 10
            if converged:
                break
        elif damping > 1e6:
            break
        else:
            damping *= 10
    return best


def _units(edges: Sequence[Edge], count: int) -> list[Matrix]:
    """For each chunk a frame about what it shares, in units of its size: makes the steps comparable."""
    units = [np.eye(4)] * count
    for edge in edges:
        size = similarity(edge.reach, np.eye(3), edge.middle)
        units[edge.b] = size
        if np.array_equal(units[edge.a], np.eye(4)):
            units[edge.a] = edge.S_a_b @ size
    return units


def _nudged(S: Matrix, unit: Matrix, step: Tangent) -> Matrix:
    return S @ unit @ exp(step) @ inverse(unit)


def _normal_equations(
    frames: Sequence[Matrix], edges: Sequence[Edge], units: Sequence[Matrix]
) -> tuple[Float64[np.ndarray, "m m"], Float64[np.ndarray, "m"]]:
    """J'J and J'r over chunks 1, 2, ..., with central differences."""
    n = 7 * (len(frames) - 1)
    A, g = np.zeros((n, n)), np.zeros(n)
    for edge in edges:
        r = edge.error(frames[edge.a], frames[edge.b])
        blocks: list[tuple[slice, np.ndarray]] = []
        for k in (edge.a, edge.b):
            if k:
                blocks.append((slice(7 * (k - 1), 7 * k), _derivative(edge, k, frames, units[k])))
        for rows, J in blocks:
            g[rows] += J.T @ r
            for cols, L in blocks:
                A[rows, cols] += J.T @ L
    return A, g


def _derivative(edge: Edge, k: int, frames: Sequence[Matrix], unit: Matrix) -> Float64[np.ndarray, "7 7"]:
    """Of the error of an edge with respect to the step of chunk k."""
    J = np.empty((7, 7))
    for axis in range(7):
        ends = []
        for sign in (STEP, -STEP):
            moved = _nudged(frames[k], unit, sign * np.eye(7)[axis])
            pair = (moved, frames[edge.b]) if k == edge.a else (frames[edge.a], moved)
            ends.append(edge.error(*pair))
        J[:, axis] = (ends[0] - ends[1]) / (2 * STEP)
    return J
