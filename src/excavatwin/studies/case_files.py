"""Cases from files: anybody's observations with the truth of the site they show."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float64, UInt8

from excavatwin.errors import InputError
from excavatwin.evaluation.truth_file import load_truth
from excavatwin.exchange import load_observations
from excavatwin.geometry.scale import Reference
from excavatwin.scene.frames import umeyama
from excavatwin.scene.observations import Observations, View
from excavatwin.scene.taxonomy import NOT_OBSERVED, K
from excavatwin.scene.truth import Truth, ViewTruth
from excavatwin.studies.cases import Case

SPREAD = 0.02
"""Least second extent of the camera centres, of their first, at which they fix a similarity: not all in one line."""


def case_from_files(observations: Path, truth: Path, references: Sequence[Reference] = (), force: bool = False) -> Case:
    """Observations and the truth of their photos, which are matched by name.

    Args:
        references: known lengths; their object is not told apart, so do not take one that is to be scored.
        force: go on although the points do not reproject onto their own pixels.

    Raises:
        InputError: a file cannot be read, or the truth has no class image of any of the views.
        ObservationError: the observations file breaks its contract.
    """
    observed, known = load_observations(observations, force), load_truth(truth)
    by_name = {view.name: view for view in known.views}
    labels = tuple(labels_on_lattice(view, by_name.get(view.name)) for view in observed.views)
    if not any((label != NOT_OBSERVED).any() for label in labels):
        ours, theirs = observed.views[0].name, known.views[0].name if known.views else "none"
        raise InputError(
            f"{truth} has no class image of any view of {observations}: the views have names like {ours!r}, "
            f"the truth's like {theirs!r}; they must be equal."
        )
    return Case(observations.stem, observed, labels, known, similarity_by_cameras(observed, known), tuple(references))


def labels_on_lattice(view: View, true: ViewTruth | None) -> UInt8[np.ndarray, "H W"]:
    """True classes at the pixels of a view; 255 where the truth has none."""
    H, W = view.shape
    if true is None:
        return np.full((H, W), NOT_OBSERVED, np.uint8)
    v, u = np.mgrid[:H, :W] + 0.5
    photo = in_photo(view, np.stack([u.ravel(), v.ravel()], axis=-1)) * (
        [1, 1] if view.lattice else [true.width / W, true.height / H]
    )
    h, w = true.label.shape
    col, row = np.floor(photo * [w / true.width, h / true.height]).astype(int).T
    inside = (col >= 0) & (col < w) & (row >= 0) & (row < h)
    found = true.label[np.clip(row, 0, h - 1), np.clip(col, 0, w - 1)]
    scored = inside & (found >= 1) & (found <= K)
    return np.where(scored, found, NOT_OBSERVED).reshape(H, W).astype(np.uint8)


def in_photo(view: View, uv: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
    """Where lattice coordinates lie in the photo, distorted as its lens does (OpenCV's model) [px]."""
    if view.lattice is None:
        return uv
    lattice = view.lattice
    flat = (uv - lattice.affine[:, 2]) @ np.linalg.inv(lattice.affine[:, :2]).T
    f, c = np.array([lattice.K_photo[0, 0], lattice.K_photo[1, 1]]), lattice.K_photo[:2, 2]
    x = (flat - c) / f
    k1, k2, p1, p2 = lattice.distortion
    r2, xy = (x**2).sum(axis=-1, keepdims=True), x[:, :1] * x[:, 1:]
    bent = np.concatenate(
        [2 * p1 * xy + p2 * (r2 + 2 * x[:, :1] ** 2), p1 * (r2 + 2 * x[:, 1:] ** 2) + 2 * p2 * xy], axis=-1
    )
    return (x * (1 + k1 * r2 + k2 * r2**2) + bent) * f + c


def similarity_by_cameras(observed: Observations, truth: Truth) -> Float64[np.ndarray, "4 4"] | None:
    """T_M_R from camera centres and their true places; None where they are too few or all in one line."""
    true = {view.name: view.T_M_cam[:3, 3] for view in truth.views if np.isfinite(view.T_M_cam).all()}
    pairs = [(view.centre, true[view.name]) for view in observed.views if view.name in true]
    if len(pairs) < 3:
        return None
    ours, theirs = (np.array(side, float) for side in zip(*pairs, strict=True))
    extent = np.linalg.svd(theirs - theirs.mean(axis=0), compute_uv=False)
    if extent[1] < SPREAD * max(extent[0], 1e-12):
        return None
    s, R, t = umeyama(ours, theirs, np.ones(len(ours)))
    T_M_R = np.eye(4)
    T_M_R[:3, :3], T_M_R[:3, 3] = s * R, t
    return T_M_R
