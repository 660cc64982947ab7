"""Data sets: one file for each, from its official layout to the nouns of ``scene.recording``.

``open_dataset`` recognises what lies in a folder. Ground truth is optional fields of frames and recordings; arrays stay
on disk until they are called. Calibrations are tested when a data set is opened; known bad files are left out, by name.
"""

from __future__ import annotations

from excavatwin.datasets.catalogue import SOURCES, Source
from excavatwin.datasets.examination import Examination, examine
from excavatwin.datasets.goose_classes import CHALLENGE, challenge_table
from excavatwin.datasets.recognition import ENVIRONMENT, dataset_folder, open_dataset, recognise
from excavatwin.datasets.rellis_classes import official_table
from excavatwin.datasets.rellis_elevation import ElevationProtocol, elevation_windows
from excavatwin.datasets.task_labels import task_labels, task_table

__all__ = [
    "CHALLENGE",
    "ENVIRONMENT",
    "SOURCES",
    "ElevationProtocol",
    "Examination",
    "Source",
    "challenge_table",
    "dataset_folder",
    "elevation_windows",
    "examine",
    "official_table",
    "open_dataset",
    "recognise",
    "task_labels",
    "task_table",
]
