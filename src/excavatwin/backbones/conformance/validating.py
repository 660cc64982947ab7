"""The one place where the suite asks the validator of the contract."""

from __future__ import annotations

from collections.abc import Sequence

from excavatwin.contract.borders import borders
from excavatwin.contract.evidence import evidence_range
from excavatwin.contract.findings import Finding
from excavatwin.contract.pictures import Photos, pictures
from excavatwin.contract.validation import validate
from excavatwin.scene.observations import Observations, View


def of_geometry(observations: Observations) -> tuple[Finding, ...]:
    """Cameras, units, agreement of the views, confidence: all that needs no photo."""
    return validate(observations)


def of_pictures(observations: Observations, photos: Photos) -> tuple[Finding, ...]:
    """Whether every lattice says where it lies in its photo."""
    return pictures(observations.views, photos)


def of_evidence(views: Sequence[View]) -> tuple[Finding, ...]:
    """Values of evidence, and whether it lies on the picture."""
    return (*evidence_range(views), *borders(views))
