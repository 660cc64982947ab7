"""Class ids of RELLIS-3D: those that stand for others, and the 19 classes of its official image evaluation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from excavatwin.datasets.readers import read_ids, read_scan
from excavatwin.scene.recording import PointCloud
from excavatwin.vocabularies import read_vocabulary

VOCABULARY = "rellis-3d"
HIGHEST_ID = 34
#: Ids that label files may hold and the official evaluation counts as others: kinds of grass, and of water.
FOLDED = {29: 3, 30: 3, 32: 6}
#: Not scored by the official evaluation: void, and dirt.
UNSCORED = ("void", "dirt")


def official_table() -> UInt8[np.ndarray, "256"]:
    """Class 1..18 of the official image evaluation for every id; 0 where it does not score, 255 for unknown ids.

    Its printed mean is over 19 classes of which one, void, is always 0: report the mean over 18, too. Note that dirt is
    not scored at all.
    """
    table = np.full(256, 255, np.uint8)
    names = read_vocabulary(VOCABULARY).names
    scored = [i for i, name in names.items() if name not in UNSCORED]
    table[list(names)] = 0
    table[scored] = np.arange(1, len(scored) + 1)
    for i, other in FOLDED.items():
        table[i] = table[other]
    return table


def read_labels(path: Path) -> UInt8[np.ndarray, "H W"]:
    """A label image, ids that stand for others replaced."""
    return _fold(256)[read_ids(path)].astype(np.uint8)


def read_labelled_scan(path: Path, labels: Path | None = None) -> PointCloud:
    """A scan with its labels, ids that stand for others replaced."""
    cloud = read_scan(path, labels, highest=HIGHEST_ID)
    return cloud if cloud.label is None else replace(cloud, label=_fold(HIGHEST_ID + 1)[cloud.label].astype(np.uint16))


def _fold(count: int) -> np.ndarray:
    table = np.arange(count)
    for i, other in FOLDED.items():
        table[i] = other
    return table
