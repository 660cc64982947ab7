"""Metric scale s = d_ref / d_hat_ref (last paragraph of Sec. "Geometry-Semantic Fusion").

The paper applies s at the end. Every stage is scale covariant, so applying it at the start gives the same map, and
lets parameters that are lengths of real things be given in metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from excavatwin.errors import InputError
from excavatwin.scene.observations import Observations, View


@dataclass(frozen=True)
class Reference:
    """A known length: two pixels of one photo and the distance between what they show."""

    view: str
    """Name of the photo."""
    a: tuple[float, float]
    """(x, y) of one end [px of the photo as displayed]."""
    b: tuple[float, float]
    """(x, y) of the other end [px]."""
    metres: float
    """d_ref [m]."""


@dataclass(frozen=True)
class Scale:
    """One global factor for the whole reconstruction."""

    references: tuple[Reference, ...] = ()
    """Known lengths; when given they decide, by the median of their factors, over any scale of the backbone."""
    search: int = 4
    """How far from a reference pixel a pixel with trustworthy depth may lie [px of the lattice]."""

    def __call__(self, observations: Observations) -> tuple[float, bool, tuple[str, ...]]:
        """(s [m per unit of R], whether s is metric, doubts).

        Raises:
            InputError: a reference names an unknown photo, lies outside it, has no depth near an end, or no length.
        """
        if not self.references:
            known = observations.metres_per_unit
            doubt = "no metric scale is known: lengths are in arbitrary units until a --reference length is given."
            return (known, True, ()) if known is not None else (1.0, False, (doubt,))
        factors = [reference.metres / self.measure(observations, reference) for reference in self.references]
        s = float(np.median(factors))
        spread = (max(factors) - min(factors)) / s
        doubts = [f"the reference lengths disagree by {spread:.1%}."] if spread > 0.02 else []
        known = observations.metres_per_unit
        if known is not None and abs(known / s - 1) > 0.02:
            doubts.append(f"the reference length changes the scale of the photos' GPS by {s / known - 1:+.1%}.")
        return s, True, tuple(doubts)

    def measure(self, observations: Observations, reference: Reference) -> float:
        """d_hat_ref: distance of the two reconstructed points [units of R]."""
        view = observations.view(reference.view)
        if view is None:
            placed = ", ".join(v.name for v in observations.views[:5])
            raise InputError(f"--reference names {reference.view!r}, not a placed photo; placed are {placed}, ...")
        ends = np.array([reference.a, reference.b], float)
        on_lattice = view.lattice.from_photo(ends) if view.lattice else ends
        p, q = (self._point_at(view, uv, reference) for uv in on_lattice)
        distance = float(np.linalg.norm(p - q))
        if distance == 0:
            raise InputError(f"--reference has both ends at the same point of {reference.view!r}; give a longer one.")
        return distance

    def _point_at(self, view: View, uv: Float64[np.ndarray, "2"], reference: Reference) -> Float64[np.ndarray, "3"]:
        """The reconstructed point at the pixel nearest to ``uv`` that has one."""
        H, W = view.shape
        x, y = int(np.floor(uv[0])), int(np.floor(uv[1]))
        if not (0 <= x < W and 0 <= y < H):
            raise InputError(f"--reference has a pixel outside {reference.view!r}; give pixels of the photo.")
        top, left = max(0, y - self.search), max(0, x - self.search)
        window = view.points[top : y + self.search + 1, left : x + self.search + 1]
        near = window.reshape(-1, 3).astype(np.float64)
        v, u = np.indices(window.shape[:2])
        distance = np.hypot(left + u.ravel() + 0.5 - uv[0], top + v.ravel() + 0.5 - uv[1])
        distance[~np.isfinite(near).all(axis=1)] = np.inf
        if not np.isfinite(distance).any():
            raise InputError(
                f"--reference has an end in {reference.view!r} where no trustworthy depth was found; "
                "pick two points on textured ground or objects seen in several photos."
            )
        return near[np.argmin(distance)]
