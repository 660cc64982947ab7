"""What single views cannot show: whether they see one and the same surface."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from excavatwin.contract.cameras import off_middle
from excavatwin.contract.conventions import Mistake, mistakes
from excavatwin.contract.crossing import FEWEST, Agreement, Glimpse, Reading, agreement, glimpse
from excavatwin.contract.findings import Finding, named, refusal, report
from excavatwin.scene.observations import View

#: Views that disagree in depth by less than this are at one, unless their pictures say otherwise.
AT_ONE = 0.01
#: Views that disagree by more are reported, whether or not a mistake explains it.
REPORTED = 0.1
#: Views that disagree by more than this belong to no surface: refused.
HOPELESS = 0.2
#: The greatest gap that a reading may leave if it is to be the right one.
RIGHT = 0.05
#: Correlation of pictures that show one place.
ALIKE = 0.5
#: Most views that are compared.
MOST = 20
_RUN = 5


def crossed(views: Sequence[View]) -> tuple[Finding, ...]:
    """Whether the points of views lie on the surfaces of others, and if not, which mistake explains it.

    Args:
        views: whose points meet their own pixels. Of many, some runs of neighbours are compared.
    """
    compared = chosen(views)
    glimpses = [one for one in (glimpse(view) for view in compared) if one is not None]
    if len(glimpses) < 2:
        return ()
    if _same_pose(glimpses):
        return (_lost_poses(len(views)),)
    pairs = [(a, b) for a in range(len(glimpses)) for b in range(len(glimpses)) if a != b]
    found = agreement(glimpses, pairs, Reading())
    if _good(found) and all(off_middle(view) < 0.02 for view in compared):
        return _strangers(glimpses)
    explained = _explanation(glimpses, pairs, found)
    if explained is not None:
        mistake, then = explained
        return (refusal(_said(found, then), mistake.cause, mistake.remedy, **_figures(found, then)),)
    if found.met >= FEWEST and found.gap > REPORTED:
        return (
            (refusal if found.gap > HOPELESS else report)(
                f"the views disagree about the surface by a median of {found.gap:.0%} of its distance, and no usual "
                "mistake of convention explains it",
                "",
                "the reconstruction is weak (little overlap, moving scene, weights of another model?)",
                **_figures(found),
            ),
        )
    return _strangers(glimpses) if found.met >= FEWEST else ()


def chosen(views: Sequence[View]) -> list[View]:
    """All views, or of many some runs of neighbours, which overlap where photos were taken in order."""
    if len(views) <= MOST:
        return list(views)
    starts = np.linspace(0, len(views) - _RUN, MOST // _RUN).astype(int)
    return [views[start + i] for start in starts for i in range(_RUN)]


def _good(found: Agreement) -> bool:
    return found.met >= FEWEST and found.gap <= AT_ONE and not found.likeness < ALIKE


def _explanation(
    glimpses: Sequence[Glimpse], pairs: Sequence[tuple[int, int]], found: Agreement
) -> tuple[Mistake, Agreement] | None:
    """The mistake that explains a disagreement best, if any does so clearly."""
    best: tuple[Mistake, Agreement] | None = None
    for mistake in mistakes(glimpses):
        then = agreement(glimpses, pairs, mistake.reading)
        if _clearly_better(found, then) and (best is None or _beats(then, best[1])):
            best = mistake, then
    return best


def _beats(new: Agreement, old: Agreement) -> bool:
    """Whether another reading is better still; of equals the first, more frequent mistake stands."""
    if new.likeness > old.likeness + 0.1:
        return True
    return new.gap < 0.7 * old.gap and not new.likeness < old.likeness - 0.1


def _clearly_better(found: Agreement, then: Agreement) -> bool:
    """Whether a reading is right where the reported one is not.

    Surfaces can meet by chance (flat ground seen from one height fits nearly any pose), pictures cannot.
    """
    if then.met < 2 * FEWEST or not then.gap < RIGHT:
        return False
    met = found.met >= FEWEST
    closer = met and then.gap < 0.03 and then.gap < 0.35 * found.gap and then.met > 0.2 * found.met
    if math.isnan(then.likeness):
        return closer
    before = 0.0 if math.isnan(found.likeness) or not met else found.likeness
    more_alike = then.likeness > before + 0.2 and not then.gap > 2 * found.gap
    return then.likeness > ALIKE and (more_alike or (closer and then.likeness > before))


def _same_pose(glimpses: Sequence[Glimpse]) -> bool:
    first = glimpses[0].T
    reach = float(np.nanmedian(glimpses[0].depth))
    return all(
        np.abs(one.T[:3, :3] - first[:3, :3]).max() < 1e-6
        and np.linalg.norm(one.T[:3, 3] - first[:3, 3]) < 1e-6 * reach
        for one in glimpses
    )


def _lost_poses(total: int) -> Finding:
    return report(
        f"all {total} views have one and the same pose",
        "the points are in camera coordinates and the poses are lost",
        "give every view its own camera-to-world pose, unless the camera stood on a tripod",
    )


def _strangers(glimpses: Sequence[Glimpse]) -> tuple[Finding, ...]:
    """Single views that do not fit the others, although these fit each other."""
    odd = []
    for at, one in enumerate(glimpses):
        pairs = [(at, other) for other in range(len(glimpses)) if other != at]
        own = agreement(glimpses, pairs, Reading())
        if own.met >= 2 * FEWEST and own.gap > 3 * RIGHT:
            odd.append(one.name)
    if not odd or len(glimpses) < 3:
        return ()
    return (
        report(
            f"{named(odd, len(glimpses))} do not fit the others, which agree among themselves",
            "poses or depths belong to other photos",
            "check the order of the photos, or leave these out",
        ),
    )


def _said(found: Agreement, then: Agreement) -> str:
    if found.met < FEWEST:
        return f"no view sees what the others report, but with one change they agree within {then.gap:.1%}"
    if not found.gap > AT_ONE:
        return f"the views agree in depth but not in what they show (correlation {found.likeness:.2f})"
    return (
        f"the views disagree about the surface by a median of {found.gap:.1%} of its distance; with one change by "
        f"{then.gap:.1%}"
    )


def _figures(found: Agreement, then: Agreement | None = None) -> dict[str, float]:
    figures = {"gap": found.gap, "likeness": found.likeness, "overlap": found.overlap}
    if then is not None:
        figures |= {"gap_if_mended": then.gap, "likeness_if_mended": then.likeness}
    return figures
