"""The last look at what a reader delivers: does it hold together, and with the photos' GPS?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float64

from excavatwin.contract.cameras import intrinsics, units
from excavatwin.contract.findings import Finding, Severity
from excavatwin.contract.reprojection import REPORTED, reprojection
from excavatwin.contract.views import crossed
from excavatwin.errors import InputError
from excavatwin.scene.observations import Observations, View
from excavatwin.scene.photo import Photo

THIN = 0.02
"""Photos of which less than this share has depth are counted in a doubt."""


def held(views: Sequence[View], where: str) -> tuple[str, ...]:
    """Doubts about views as the files have them, before their frame is turned: an inverted pose shows only then.

    Raises:
        InputError: points miss their own pixels, no view has depth, or views contradict each other.
    """
    covered = np.array([float(np.mean(~np.isnan(view.points[..., 0]))) for view in views])
    if not covered.any():
        raise InputError(f"no photo of {where} has a single depth; its depth maps are empty or its poses do not fit.")
    for view in views:
        found = reprojection(view.points, view.T_R_cam, view.K_cam)
        if found is not None and found.median > REPORTED:
            cause = found.cause or "its cameras and depth maps do not belong together"
            raise InputError(f"{view.name} of {where}: points miss their pixels by {found.median:.1f} px; {cause}.")
    doubts = []
    if (covered < THIN).any():
        doubts.append(f"{int((covered < THIN).sum())} of {len(covered)} photos have hardly any depth in {where}.")
    return (*doubts, *_said((*intrinsics(views), *crossed(views)), where))


def scaled(obs: Observations, where: str) -> tuple[str, ...]:
    """Doubts about the unit of observations.

    Raises:
        InputError: what is declared as metres is none.
    """
    return _said(units(obs), where)


def _said(findings: Sequence[Finding], where: str) -> tuple[str, ...]:
    for finding in findings:
        if finding.severity is Severity.REFUSE:
            raise InputError(f"{where}: {finding}")
    return tuple(f"{where}: {finding}" for finding in findings)


def gps_residual(epsg: int, centres: Mapping[str, Float64[np.ndarray, "3"]], photos: Sequence[Photo]) -> float:
    """RMS of camera positions against their GPS positions, NaN without any [m]; heights less their common offset.

    The datum of the altitude that cameras write differs between makers, so a common offset says nothing.
    """
    from pyproj import Transformer

    to_map = Transformer.from_crs(4326, epsg, always_xy=True)
    apart = []
    for photo in photos:
        if photo.gps is not None and photo.name in centres:
            east, north = to_map.transform(photo.gps.longitude, photo.gps.latitude)
            height = np.nan if photo.gps.altitude is None else photo.gps.altitude
            apart.append(centres[photo.name] - (east, north, height))
    if not apart:
        return float("nan")
    error = np.array(apart)
    known = np.isfinite(error[:, 2])
    error[:, 2] -= np.median(error[known, 2]) if known.any() else 0.0
    return float(np.sqrt((np.where(np.isfinite(error), error, 0.0) ** 2).sum(axis=1).mean()))
