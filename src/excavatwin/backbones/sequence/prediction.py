"""One prediction, checked before it is believed: shapes, poses, intrinsics, and points that meet their own pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, UInt8

from excavatwin.backbones.sequence.network import Network, Prediction
from excavatwin.contract.checks import checked_intrinsics, checked_layer, checked_points, checked_pose
from excavatwin.contract.reprojection import REFUSED, reprojection
from excavatwin.errors import ExcavatwinError, ObservationError, ReconstructionError


@dataclass(frozen=True)
class Checked:
    """A prediction that keeps the contract."""

    prediction: Prediction
    faults: dict[int, str]
    """Row -> why that photo cannot be used; its points are NaN."""
    misses: tuple[float, ...]
    """Median distance of each usable photo's points from their own pixels [px]."""


def predict(
    network: Network,
    images: UInt8[np.ndarray, "S H W 3"],
    inside: Sequence[Bool[np.ndarray, "H W"]],
    names: Sequence[str],
    model: str,
) -> Checked:
    """Ask the network about some photos and check what it says.

    Args:
        network: loaded; the arrays that it gives are overwritten.
        images: photos on the lattice.
        inside: of each photo, the pixels that are not padding.
        names: of the photos.
        model: name of the backbone, for messages.

    Raises:
        ObservationError: what it says breaks the contract for at least half of the photos (a single bad photo is a
            fault).
        ReconstructionError: its points miss their own pixels by more than 2 % of the width in at least half of them.
    """
    said = network(images)
    points, confidence = _arrays(said, images.shape, model)
    T, K = np.array(said.T_world_cam, float), np.array(said.K_cam, float)
    errors: dict[int, ExcavatwinError] = {}
    misses = []
    for i, name in enumerate(names):
        where = f"{model}, {name}"
        try:
            points[i][~inside[i]] = np.nan
            points[i] = checked_points(points[i], where)
            confidence[i] = checked_layer(confidence[i], "confidence", points[i], where)
            T[i], K[i] = checked_pose(T[i], where), checked_intrinsics(K[i], images.shape[1:3], where)
            misses.append(_miss(points[i], T[i], K[i], where))
        except ExcavatwinError as error:
            errors[i] = error
    if 2 * len(errors) >= len(names):
        raise next(iter(errors.values()))
    for i in errors:
        points[i], confidence[i], T[i] = np.nan, 0, np.eye(4)
    checked = replace(said, points=points, confidence=confidence, T_world_cam=T, K_cam=K)
    return Checked(checked, _faults(points, errors), tuple(miss for miss in misses if np.isfinite(miss)))


def _faults(points: np.ndarray, errors: dict[int, ExcavatwinError]) -> dict[int, str]:
    """Why photos cannot be used."""
    nothing = {i: "the network gave it no point" for i in range(len(points)) if np.isnan(points[i, ..., 0]).all()}
    return nothing | {i: f"what the network says of it is unusable: {error}" for i, error in errors.items()}


def _miss(points: np.ndarray, T: np.ndarray, K: np.ndarray, where: str) -> float:
    """Median miss [px]; NaN for a photo without points."""
    found = reprojection(points, T, K)
    if found is None:
        return float("nan")
    if found.median > REFUSED * points.shape[1]:
        because = f": {found.cause}" if found.cause else "; its pose, intrinsics and points do not belong together"
        raise ReconstructionError(
            f"{where}: the points miss their own pixels by {found.median:.0f} px (expected less than "
            f"{REFUSED * points.shape[1]:.0f}){because}."
        )
    return found.median


def _arrays(said: Prediction, shape: tuple[int, ...], model: str) -> tuple[np.ndarray, np.ndarray]:
    """Points and confidence as writable float32 arrays of the right shape."""
    S, H, W = shape[:3]
    expected = {"points": (S, H, W, 3), "confidence": (S, H, W), "T_world_cam": (S, 4, 4), "K_cam": (S, 3, 3)}
    for name, wanted in expected.items():
        found = np.shape(getattr(said, name))
        if found != wanted:
            swapped = " (rows and columns are swapped)" if H != W and found[1:3] == (W, H) else ""
            raise ObservationError(
                f"{model}: {name} has shape {found} for {S} images of {H} x {W} px; expected {wanted}{swapped}."
            )
    return np.require(said.points, np.float32, ["C", "W"]), np.require(said.confidence, np.float32, ["C", "W"])
