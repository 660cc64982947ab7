"""Loading observations: every rule of the contract is checked, and the first thing that is wrong is named."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Float32

from excavatwin.contract.checks import (
    check_precision,
    checked_image,
    checked_intrinsics,
    checked_labels,
    checked_layer,
    checked_points,
    checked_pose,
    checked_scale,
    checked_up,
)
from excavatwin.contract.reprojection import REFUSED, REPORTED, Reprojection, reprojection
from excavatwin.errors import InputError, ObservationError
from excavatwin.exchange.archive import Archive, read_archive
from excavatwin.exchange.provenance import Provenance, parse_provenance
from excavatwin.scene.observations import Observations, View
from excavatwin.scene.taxonomy import K as CLASSES
from excavatwin.vocabularies import fitting, read_vocabulary, resolve


def load_observations(
    path: str | Path,
    force: bool = False,
    mapping: str | Path | None = None,
    remap: Mapping[str, str] = MappingProxyType({}),
) -> Observations:
    """Observations from an ``.npz`` file, or from a folder of one ``.npz`` per view with ``views.json``.

    Args:
        path: the file or folder.
        force: go on although points miss their own pixels by more than 2 % of the image width.
        mapping: shipped class mapping by name, or a TOML file, for labels or evidence in another vocabulary; stands
            above the one named in the file. Without ``vocabulary`` in the file, labels are ids of this mapping.
        remap: class -> task class where the user maps otherwise, see ``vocabularies.parse_remap``.

    Raises:
        ObservationError: the file breaks its contract; the message names the first thing that is wrong.
        InputError: the class mapping does not exist or says nothing about a class of the vocabulary.
    """
    path = Path(path)
    archive = read_archive(path)
    if not archive.views:
        raise ObservationError(f"{path} holds no view.")
    names = _names(archive)
    semantics = _Semantics.of(archive, mapping, remap)
    provenance = parse_provenance(archive.shared.get("provenance"), len(names))
    views = tuple(
        _view(record, f"view {i} ('{names[i]}')", names[i], semantics, provenance)
        for i, record in enumerate(archive.views)
    )
    doubts = dict.fromkeys((*provenance.doubts, *_unread(archive)))
    doubts.update(dict.fromkeys((*_absences(views), *_misses(views, force))))
    up, scale = archive.shared.get("up"), archive.shared.get("metres_per_unit")
    return Observations(
        views=views,
        up=None if up is None else checked_up(up),
        metres_per_unit=None if scale is None else checked_scale(scale),
        georeference=provenance.georeference,
        unplaced=provenance.unplaced,
        doubts=tuple(doubts),
        source={**provenance.source, **semantics.source},
    )


def _names(archive: Archive) -> list[str]:
    """Unique names of the views; ``view_000`` and so on when the file has none."""
    names: list[str] = []
    for i, record in enumerate(archive.views):
        stored = record.get("names")
        if stored is None:
            names.append(f"view_{i:03d}")
            continue
        if stored.dtype.kind not in "US" or stored.ndim:
            raise ObservationError(f"view {i}: its name is {stored!r}; expected names to be (S,) strings.")
        names.append(stored.item().decode() if stored.dtype.kind == "S" else str(stored))
    for i, name in enumerate(names):
        if name in names[:i]:
            raise ObservationError(f"views {names.index(name)} and {i} are both named '{name}'; names must differ.")
    return names


@dataclass(frozen=True)
class _Semantics:
    """How labels or evidence channels of the file become evidence for the task classes."""

    weights: Float32[np.ndarray, "V K"]
    """Weights of channel, or of label id, v for the task classes."""
    ids: frozenset[int]
    """Ids that label images may hold, besides 255."""
    meaning: str
    """What those ids are, for messages."""
    source: Mapping[str, str]
    """What belongs beside every figure that depends on the mapping; empty for task classes."""

    @staticmethod
    def of(archive: Archive, mapping: str | Path | None, remap: Mapping[str, str]) -> _Semantics:
        names = archive.shared.get("vocabulary")
        named = [str(name) for name in np.atleast_1d(np.asarray(names))] if names is not None else None
        chosen = mapping if mapping is not None else archive.shared.get("class_mapping")
        if chosen is None and named is not None and not read_vocabulary("task").covers(named):
            raise InputError(_unmapped(named))
        if chosen is None and named is None:
            if remap:
                raise InputError(
                    f"--map speaks of {', '.join(remap)}, but the file holds task classes already, no classes of a "
                    "segmenter; give --class-mapping too when its labels are ids of another vocabulary."
                )
            identity = np.vstack([np.zeros(CLASSES, np.float32), np.eye(CLASSES, dtype=np.float32)])
            return _Semantics(identity, frozenset(range(CLASSES + 1)), "task class ids 0..5", {})
        wanted = "task" if chosen is None else str(chosen)
        if named is None:
            vocabulary = read_vocabulary(wanted)
            if not vocabulary.names:
                raise InputError(
                    f"the mapping '{wanted}' knows classes by name only, but the file has labels without names; add "
                    "the key vocabulary, the names in the order of the labels."
                )
            named = [vocabulary.names.get(i, "") for i in range(max(vocabulary.names) + 1)]
            ids, meaning = frozenset(vocabulary.names), f"ids of the mapping '{vocabulary.mapping.name}'"
        else:
            ids, meaning = frozenset(range(len(named))), f"indices 0..{len(named) - 1} of the vocabulary"
        resolved = resolve([name for name in named if name], wanted, remap)
        weights = np.zeros((len(named), CLASSES), np.float32)
        weights[sorted(ids)] = resolved.weights
        source = {"class_mapping": resolved.mapping, "class_mapping_policy": resolved.policy}
        return _Semantics(weights, ids, meaning, source)

    def evidence(
        self, record: dict[str, np.ndarray], points: Float32[np.ndarray, "H W 3"], where: str
    ) -> Float32[np.ndarray, "H W K"]:
        """Evidence for the task classes from the record's evidence channels or label image."""
        if "evidence" in record:
            if not self.source:
                return checked_layer(record["evidence"], "evidence", points, where, CLASSES)
            return checked_layer(record["evidence"], "evidence", points, where, len(self.weights)) @ self.weights
        labels = checked_labels(record["labels"], set(self.ids), self.meaning, points.shape[:2], where)
        table = np.zeros((max(256, len(self.weights)), CLASSES), np.float32)
        table[: len(self.weights)] = self.weights
        if 255 not in self.ids:
            table[255] = 0
        evidence = table[labels]
        if "scores" in record:
            evidence *= checked_layer(record["scores"], "scores", points, where)[..., None]
        return evidence


def _unmapped(named: Sequence[str]) -> str:
    fit = fitting(named)
    if fit:
        advice = (
            f"the shipped mapping '{fit[0]}' covers it: if you agree with it, give --class-mapping {fit[0]} "
            f"(in Python mapping='{fit[0]}')"
        )
    else:
        foreign = ", ".join(map(repr, read_vocabulary("task").foreign(named)))
        advice = f"no shipped mapping covers it (foreign classes: {foreign}): write a TOML file of your own"
    return f"the file has a vocabulary of {len(named)} classes but no class mapping to task classes; {advice}."


def _view(record: dict[str, Any], where: str, name: str, semantics: _Semantics, provenance: Provenance) -> View:
    points = checked_points(record["points"], where)
    shape = points.shape[:2]
    confidence = checked_layer(record["confidence"], "confidence", points, where)
    evidence = semantics.evidence(record, points, where)
    T_R_cam = checked_pose(record["T_world_cam"], where)
    check_precision(points, T_R_cam[:3, 3], where)
    return View(
        name=name,
        points=points,
        confidence=confidence,
        evidence=evidence,
        T_R_cam=T_R_cam,
        K_cam=checked_intrinsics(record["K"], shape, where),
        image=checked_image(record["images"], shape, where) if "images" in record else None,
        lattice=provenance.lattices.get(name),
    )


def _unread(archive: Archive) -> list[str]:
    """What the file holds in vain."""
    both = any({"evidence", "labels"} <= record.keys() for record in archive.views)
    doubts = ["The observations hold evidence and labels; the labels were not used."] if both else []
    if archive.unread:
        doubts.append(f"The observations hold keys that were not read: {_listed(archive.unread)} (misspelt?).")
    return doubts


def _absences(views: Sequence[View]) -> list[str]:
    """Views without a single point."""
    empty = [view.name for view in views if np.isnan(view.points[..., 0]).all()]
    if len(empty) == len(views):
        raise ObservationError(
            f"points is NaN everywhere, in all {len(views)} views; there is nothing to map: check what the "
            "reconstruction model wrote."
        )
    if not empty:
        return []
    return [f"{len(empty)} of {len(views)} views hold no point at all: {_listed(empty)}."]


def _misses(views: Sequence[View], force: bool) -> list[str]:
    """Views whose points miss their own pixels: refused when gross, else one doubt with the worst of them."""
    found: list[tuple[int, View, Reprojection]] = []
    for i, view in enumerate(views):
        result = reprojection(view.points, view.T_R_cam, view.K_cam)
        if result is None or (result.median <= REPORTED and not result.cause):
            continue
        if result.median > REFUSED * view.shape[1] and not force:
            raise ObservationError(
                f"view {i} ('{view.name}'): {_size(result, view)}, more than {REFUSED:.0%} of the image width"
                f"{_likely(result)}; mend it, or go on all the same with --force (in Python force=True)."
            )
        found.append((i, view, result))
    if not found:
        return []
    i, view, worst = max(found, key=lambda item: item[2].median)
    return [
        f"The points of {len(found)} of {len(views)} views miss their own pixels; worst is view {i} ('{view.name}'): "
        f"{_size(worst, view)}{_likely(worst)}."
    ]


def _size(result: Reprojection, view: View) -> str:
    if not np.isfinite(result.median):
        return "most of its points lie behind the camera"
    return f"its points miss their own pixels by a median of {result.median:.1f} px (width {view.shape[1]})"


def _likely(result: Reprojection) -> str:
    return f"; most likely {result.cause}" if result.cause else "; no usual mistake of convention explains it"


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
