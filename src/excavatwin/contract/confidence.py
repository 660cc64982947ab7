"""Confidence: its range, what is declared about it, and whether it is larger where views agree."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from excavatwin.contract.crossing import FEWEST, Reading, gaps, glimpse
from excavatwin.contract.findings import Finding, named, report
from excavatwin.scene.observations import Observations, View

#: Kind as declared in ``source["confidence"]`` -> least and greatest value it can take.
KINDS = {"1 + exp": (1.0, np.inf), "exp": (0.0, np.inf), "sigmoid": (0.0, 1.0), "probability": (0.0, 1.0)}
#: Rank correlation of confidence and disagreement beyond which it speaks against the confidence.
AGAINST = 0.1
#: Views that agree better than this have nothing that a confidence could rank: what is left is the lattice's grain.
NOTICEABLE = 0.002
_MOST = 12


def confidences(observations: Observations) -> tuple[Finding, ...]:
    """What is doubtful about the confidence of observations whose views meet the contract."""
    views = observations.views
    values = [_values(view) for view in views]
    known = [v for v in values if len(v)]
    if not known:
        return ()
    zero = [view.name for view, v in zip(views, values, strict=True) if len(v) and not v.any()]
    if zero:
        return (
            report(
                f"the confidence of {named(zero, len(views))} is 0 at every point",
                "the confidence was never filled",
                "give the model's confidence, or 1 where there is none",
            ),
        )
    found = _declared(observations, known)
    if np.ptp(np.concatenate(known)) == 0:
        what = f"the confidence is {known[0][0]:g} at every point, so that it does not rank views"
        return (*found, report(what, remedy="give the model's confidence if it has one"))
    return (*found, *_against_agreement(views))


def _values(view: View) -> np.ndarray:
    flat = view.confidence[np.isfinite(view.points[..., 0])]
    return flat[:: 1 + len(flat) // 20_000]


def _declared(observations: Observations, values: Sequence[np.ndarray]) -> tuple[Finding, ...]:
    kind = observations.source.get("confidence", "")
    low, high = KINDS.get(kind, (0.0, np.inf))
    pooled = np.concatenate(values)
    least, most = float(pooled.min()), float(pooled.max())
    if least >= low - 1e-3 and most <= high + 1e-3:
        return ()
    cause = "the confidence is another activation than declared (logits, or a second exp or sigmoid)"
    return (
        report(
            f"the confidence is declared to be {kind!r}, at least {low:g} and at most {high:g}, but lies in "
            f"{least:.3g}..{most:.3g}",
            cause,
            "apply the activation of the model's own head once",
            least=least,
            most=most,
        ),
    )


def _against_agreement(views: Sequence[View]) -> tuple[Finding, ...]:
    """Rank correlation of confidence and disagreement, view by view; a t-test over views."""
    chosen = [views[i] for i in np.unique(np.linspace(0, len(views) - 1, min(_MOST, len(views))).astype(int))]
    made = [(view, one) for view, one in ((view, glimpse(view)) for view in chosen) if one is not None]
    correlations = []
    for at, (view, one) in enumerate(made):
        apart = gaps(one, [other for _, other in made[:at] + made[at + 1 :]], Reading())
        use = np.isfinite(apart)
        confidence = view.confidence[one.pixels[:, 0], one.pixels[:, 1]][use]
        if use.sum() >= 4 * FEWEST and np.ptp(confidence) > 0 and np.median(apart[use]) > NOTICEABLE:
            correlations.append(float(np.corrcoef(_ranks(confidence), _ranks(apart[use]))[0, 1]))
    if len(correlations) < 4:
        return ()
    mean, spread = float(np.mean(correlations)), float(np.std(correlations, ddof=1)) / np.sqrt(len(correlations))
    if mean < AGAINST or mean < 4 * spread:
        return ()
    return (
        report(
            f"the confidence is larger where views disagree (rank correlation {mean:+.2f} with the disagreement)",
            "an uncertainty (variance, error, distance) is given as confidence",
            "give its inverse: more must mean better",
            correlation=mean,
        ),
    )


def _ranks(values: np.ndarray) -> np.ndarray:
    from scipy.stats import rankdata

    return np.asarray(rankdata(values), float)
