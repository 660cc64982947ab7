"""The paper's equation labels, and who in the code claims them.

Every labelled equation of the paper is claimed by exactly one function, tagged ``@equation("eq:vote")``.
``tests/test_equations.py`` holds the naive twin of each and checks that no label is left unclaimed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

Claimant = TypeVar("Claimant", bound=Callable[..., Any])

#: Labels of the equations of ``paper.tex`` in the paper's order, with what each one states.
EQUATIONS: dict[str, str] = {
    "eq:gc_correspondence": "a valid pixel (s, u) is a point with its confidence and its evidence",
    "eq:semantic_elevation_map": "the map is a function of all those triples",
    "eq:multilayer_map": "the map has a work, a noise and an object layer",
    "eq:cov": "covariance of a neighbourhood and its eigen-decomposition",
    "eq:outlier": "Hampel test on the mean neighbour distance",
    "eq:gc_continuity": "two adjacent cells are linked when their reference elevations vary continuously",
    "eq:gc_conf_filter": "per-class confidence quantile and evidence threshold of object points",
    "eq:vote": "reliability-weighted mean of the per-view evidence",
    "eq:score": "vote tempered by class-dependent geometric support, normalised",
    "eq:semantic_decision": "arg-max where the best score reaches tau, unknown elsewhere",
    "eq:semantic_elevation": "median height of the terrain points of a cell",
    "eq:grid_semantics": "confidence-weighted vote of the points of a cell",
}

#: label -> "module.qualname" of the one function that claims it; filled when the stages are imported.
CLAIMS: dict[str, str] = {}


def equation(label: str) -> Callable[[Claimant], Claimant]:
    """Tag a function as *the* implementation of the paper's equation ``label``.

    Raises:
        KeyError: the paper has no such label.
        ValueError: another function already claims it.
    """
    if label not in EQUATIONS:
        raise KeyError(f"the paper has no equation labelled {label!r}; labels: {', '.join(EQUATIONS)}")

    def claim(function: Claimant) -> Claimant:
        name = f"{function.__module__}.{function.__qualname__}"
        if CLAIMS.setdefault(label, name) != name:
            raise ValueError(f"{label} is claimed by {CLAIMS[label]}; {name} cannot claim it too")
        return function

    return claim
