"""Score, decision and the reason for every unknown (eq:score, eq:semantic_decision)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, UInt8

from excavatwin.errors import require
from excavatwin.paper import equation
from excavatwin.scene.labels import Labels
from excavatwin.scene.taxonomy import Reason


@dataclass(frozen=True)
class Decision:
    """Temper the vote by geometric support, and say unknown below tau."""

    lambda_v: float = 1.0
    """Contribution of the semantic evidence."""
    epsilon: float = 0.02
    """Evidence floor of eq:score: what a class with no vote at all still counts."""
    tau: float = 0.475
    """Decision threshold: a class may be called when it outweighs the others, but of two alike neither is."""
    least: float = 0.002
    """Total vote below which there is no evidence, and the place is unknown: geometry alone never names a class."""

    def __post_init__(self) -> None:
        require(self, "lambda_v", 0.0)
        require(self, "epsilon", 0.0, open_low=True)
        require(self, "tau", 0.0, 1.0)
        require(self, "least", 0.0)

    def __call__(self, v: Float32[np.ndarray, "J K"], g: Float32[np.ndarray, "J K"]) -> Labels:
        """Label, confidence and reason of every voxel."""
        q = score(v, g, self.epsilon, self.lambda_v)
        silent = v.sum(axis=1) < self.least
        label = np.where(silent, 0, decide(q, self.tau)).astype(np.uint8)
        reason = np.full(len(label), Reason.CONFLICTING, np.uint8)
        favourite = v.argmax(axis=1)
        rows = np.arange(len(v))
        forbidden = g[rows, favourite] <= 0.5 * np.maximum(g.max(axis=1), 1e-12)
        reason[forbidden | (g.max(axis=1) == 0)] = Reason.INADMISSIBLE
        reason[silent] = Reason.INSUFFICIENT
        reason[label > 0] = Reason.CLASSIFIED
        return Labels(v, g, q, label, q.max(axis=1), reason)


@equation("eq:score")
def score(
    v: Float32[np.ndarray, "J K"], g: Float32[np.ndarray, "J K"], epsilon: float, lambda_v: float
) -> Float32[np.ndarray, "J K"]:
    """q_j(k) = g_j(k) [v_j(k) + epsilon]^lambda_v, normalised over k; all zero where every g is zero."""
    q = g * (v + np.float32(epsilon)) ** np.float32(lambda_v)
    total = q.sum(axis=1, keepdims=True)
    return np.divide(q, total, out=np.zeros_like(q), where=total > 0)


@equation("eq:semantic_decision")
def decide(q: Float32[np.ndarray, "J K"], tau: float) -> UInt8[np.ndarray, "J"]:
    """arg-max_k q_j(k) where it reaches tau (and is not zero), else 0 = unknown."""
    best = q.max(axis=1)
    return np.where((best >= tau) & (best > 0), q.argmax(axis=1) + 1, 0).astype(np.uint8)
