"""The validator: everything about observations that numbers, other views, photos and a witness can tell."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float32

from excavatwin.contract.cameras import intrinsics, units
from excavatwin.contract.checks import checked_scale, checked_up
from excavatwin.contract.findings import Finding, refusal
from excavatwin.contract.pictures import Photos
from excavatwin.contract.single import contract, own_pixels
from excavatwin.contract.views import chosen, crossed
from excavatwin.errors import ObservationError
from excavatwin.scene.observations import Observations, View

#: Of longer sequences, so many views are looked at one by one.
MOST = 64


def validate(
    observations: Observations,
    photos: Photos | None = None,
    witness: Mapping[str, Float32[np.ndarray, "H W K"]] | None = None,
) -> tuple[Finding, ...]:
    """Mistakes of convention in observations, whoever made them.

    Single views are held to the contract and to their own pixels; views to each other; pictures to photos; evidence
    to pictures. A check that lacks its input says nothing. Of long sequences a part is looked at. Two seconds for
    twelve views of 518 x 392 pixels with photos and witness.

    Args:
        observations: with or without evidence; all zero means that nobody has segmented yet.
        photos: RGB as displayed by name of the view; some will do, of any size. Read when asked for.
        witness: independent evidence for the same classes and pixels by name of the view, such as colour cues give.

    Returns:
        Findings, refusals first; empty when all is well.
    """
    views = observations.views
    if not views:
        return (refusal("there is no view", remedy="give observations with at least one view"),)
    if len(views) > MOST:
        views = tuple(views[i] for i in np.linspace(0, len(views) - 1, MOST).astype(int))
    sound, found = contract(views)
    findings = [*_whole(observations), *found]
    meeting, found = own_pixels(sound)
    findings += found
    findings += intrinsics(sound)
    findings += crossed(meeting if len(views) == len(observations.views) else _sound(observations.views))
    findings += _pictured(sound, photos)
    if len(meeting) == len(views):
        findings += _judged(observations, views)
    if sound and any(view.evidence.any() for view in sound):
        findings += _segmented(sound, witness)
    return tuple(sorted(findings, key=lambda finding: finding.severity == "report"))


def _sound(views: Sequence[View]) -> list[View]:
    """Of a long sequence, the runs of neighbours that are compared, without views that break the contract."""
    return own_pixels(contract(chosen(views))[0])[0]


def _whole(observations: Observations) -> list[Finding]:
    """What concerns no single view."""
    findings = []
    for check, value in ((checked_up, observations.up), (checked_scale, observations.metres_per_unit)):
        try:
            if value is not None:
                check(value)
        except ObservationError as error:
            findings.append(refusal(str(error).rstrip(".")))
    twice = [name for name, count in Counter(view.name for view in observations.views).items() if count > 1]
    if twice:
        findings.append(refusal(f"{len(twice)} names are used twice ({twice[0]!r})", remedy="names must differ"))
    return findings


def _pictured(views: Sequence[View], photos: Photos | None) -> tuple[Finding, ...]:
    if photos is None:
        return ()
    from excavatwin.contract.pictures import pictures

    return pictures(views, photos)


def _judged(observations: Observations, views: Sequence[View]) -> tuple[Finding, ...]:
    """Scale and confidence, of views whose geometry is sound."""
    from dataclasses import replace

    from excavatwin.contract.confidence import confidences

    part = replace(observations, views=tuple(views))
    return (*units(part), *confidences(part))


def _segmented(
    views: Sequence[View], witness: Mapping[str, Float32[np.ndarray, "H W K"]] | None
) -> tuple[Finding, ...]:
    from excavatwin.contract.borders import borders
    from excavatwin.contract.evidence import evidence_range
    from excavatwin.contract.witness import witnessed

    return (*evidence_range(views), *borders(views), *(witnessed(views, witness) if witness else ()))
