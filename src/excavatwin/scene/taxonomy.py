"""The task taxonomy of Sec. "Task-Oriented Hierarchical Spatial Taxonomy": five classes, unknown, and reasons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from jaxtyping import Float32

from excavatwin.errors import InputError


class TaskClass(IntEnum):
    """Class ids, the same in every raster, label image, point and table."""

    UNKNOWN = 0
    CONSTRUCTION_TERRAIN = 1  #: manipulable soil
    OTHER_TERRAIN = 2  #: surrounding spatial reference
    REMOVABLE_COVER = 3  #: environmental interference such as vegetation
    EXCAVATOR = 4  #: machinery
    OBSTACLE = 5  #: objects relevant to operational safety


class Reason(IntEnum):
    """Why a place has no class."""

    CLASSIFIED = 0  #: it has one
    UNOBSERVED = 1  #: no photo shows it with trustworthy depth
    INSUFFICIENT = 2  #: too little semantic evidence
    CONFLICTING = 3  #: evidence for several admissible classes, none strong enough
    INADMISSIBLE = 4  #: the evidence is for classes that the geometry forbids here


class Support(IntEnum):
    """Geometric support of a voxel or a cell (Sec. "Geometric Spatial Processing")."""

    NONE = 0  #: unobserved, or a spatial outlier
    TERRAIN = 1  #: part of the continuous terrain region
    NON_TERRAIN = 2  #: stands off the terrain


#: Raster and label-image value of a place that no photo observes.
NOT_OBSERVED = 255
#: The K = 5 task classes without unknown, in the order of the evidence channels.
TASK_CLASSES = tuple(TaskClass)[1:]
K = len(TASK_CLASSES)
TERRAIN_CLASSES = (TaskClass.CONSTRUCTION_TERRAIN, TaskClass.OTHER_TERRAIN)
OBJECT_CLASSES = (TaskClass.EXCAVATOR, TaskClass.OBSTACLE)

#: The one palette (sRGB), used by every raster, picture and point cloud.
PALETTE: dict[int, tuple[int, int, int]] = {
    TaskClass.UNKNOWN: (128, 128, 128),
    TaskClass.CONSTRUCTION_TERRAIN: (196, 132, 60),
    TaskClass.OTHER_TERRAIN: (222, 207, 170),
    TaskClass.REMOVABLE_COVER: (72, 150, 72),
    TaskClass.EXCAVATOR: (245, 190, 0),
    TaskClass.OBSTACLE: (200, 40, 60),
    NOT_OBSERVED: (255, 255, 255),
}


def class_name(k: int) -> str:
    """Lower-case name of a class id, ``"construction_terrain"``; 255 is ``"not_observed"``."""
    return "not_observed" if k == NOT_OBSERVED else TaskClass(k).name.lower()


def parse_class(name: str) -> TaskClass:
    """The class of a name such as ``"construction_terrain"``.

    Raises:
        InputError: there is no such class.
    """
    try:
        return TaskClass[name.strip().upper()]
    except KeyError:
        names = ", ".join(class_name(k) for k in TaskClass)
        raise InputError(f"{name!r} is not a task class; use one of: {names}.") from None


@dataclass(frozen=True)
class ClassMapping:
    """From the classes of a segmenter's vocabulary to the task classes.

    Source classes of the same task class are merged into one evidence channel by summing their weighted scores.
    """

    name: str
    """Name of the policy; it stands beside every figure that depends on it."""
    weights: Mapping[str, Mapping[TaskClass, float]] = field(default_factory=dict)
    """Source class -> task class -> weight in [0, 1]. An empty inner mapping means "never votes" (sky, void)."""

    def matrix(self, vocabulary: Sequence[str]) -> Float32[np.ndarray, "V K"]:
        """Weights as a matrix: evidence (..., V) @ matrix gives the merged channels (..., K).

        Raises:
            InputError: a class of the vocabulary is not mapped; silence would drop its evidence.
        """
        missing = [name for name in vocabulary if name not in self.weights]
        if missing:
            raise InputError(
                f"class mapping {self.name!r} says nothing about: {', '.join(missing)}; "
                "map each to a task class, or to nothing if it must not vote."
            )
        M = np.zeros((len(vocabulary), K), np.float32)
        for row, name in enumerate(vocabulary):
            for task_class, weight in self.weights[name].items():
                if task_class == TaskClass.UNKNOWN:
                    continue  # evidence for "unknown" is absence of evidence
                M[row, task_class - 1] = weight
        return M
