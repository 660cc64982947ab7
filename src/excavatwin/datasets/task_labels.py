"""Ground truth in the vocabulary of a data set becomes task classes, under a named policy."""

from __future__ import annotations

import numpy as np
from jaxtyping import UInt8

from excavatwin.errors import InputError
from excavatwin.scene.recording import Frame, Recording, Stored
from excavatwin.scene.taxonomy import NOT_OBSERVED
from excavatwin.vocabularies import canonical, read_vocabulary


def task_table(recording: Recording, policy: str | None = None) -> UInt8[np.ndarray, "256"]:
    """Task class 1..5 of every id of a recording's labels; 255 = not scored.

    Not scored are ids that never vote (sky, void, water), those that mean nothing on this platform, and those whose
    policy names two classes equally: a ground truth that says "either" is none.

    Args:
        policy: of the class mapping; by default its own first one ("diggable"; "identity" for task labels).

    Raises:
        InputError: the recording has no vocabulary, or this has no such policy.
    """
    if recording.vocabulary is None:
        raise InputError(f"recording {recording.name} has no class labels, so there is nothing to map to task classes.")
    vocabulary = read_vocabulary(recording.vocabulary, policy)
    ids = list(vocabulary.names)
    M = vocabulary.matrix([vocabulary.names[i] for i in ids])
    silent = np.isin([canonical(vocabulary.names[i]) for i in ids], [canonical(name) for name in recording.voiceless])
    best, runner_up = np.sort(M, axis=1)[:, -1], np.sort(M, axis=1)[:, -2]
    table = np.full(256, NOT_OBSERVED, np.uint8)
    table[ids] = np.where((best > runner_up) & ~silent, M.argmax(1) + 1, NOT_OBSERVED)
    return table


def task_labels(recording: Recording, frame: Frame, policy: str | None = None) -> UInt8[np.ndarray, "H W"]:
    """Ground truth of one photo as task classes 1..5; 255 = not scored.

    Raises:
        InputError: the frame has no labels, or as ``task_table``.
    """
    if frame.label is None:
        raise InputError(f"frame {recording.name}/{frame.name} has no class labels.")
    return task_table(recording, policy)[_known(recording, frame.label)]


def _known(recording: Recording, stored: Stored[UInt8[np.ndarray, "H W"]]) -> UInt8[np.ndarray, "H W"]:
    """Label ids, all of which the vocabulary has (255 besides)."""
    ids = stored()
    known = np.array([*read_vocabulary(str(recording.vocabulary)).names, 255])
    strange = np.setdiff1d(ids, known)
    if len(strange):
        raise InputError(f"{stored.path} holds id {strange[0]}, which {recording.vocabulary} does not have.")
    return ids
