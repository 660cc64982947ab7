"""Classes of GOOSE: the official list of 64, the 9 categories of the challenges, and the CSV files that carry them."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from excavatwin.errors import InputError
from excavatwin.vocabularies import canonical, read_vocabulary

VOCABULARY = "goose-64"
CLASSES = 64
#: The 9 categories of the challenges, by id, with the classes of each (goose-dataset.de: challenge_label_mapping.csv).
CHALLENGE: dict[str, str] = {
    "other": "undefined ego_vehicle outlier",
    "artificial_structures": "building wall bridge tunnel",
    "artificial_ground": "cobble bikeway pedestrian_crossing road_marking sidewalk curb asphalt",
    "natural_ground": "snow leaves gravel soil low_grass water",
    "obstacle": (
        "traffic_cone obstacle street_light road_block traffic_light boom_barrier rail_track debris animal rock fence "
        "guard_rail pole traffic_sign misc_sign barrier_tape wire container barrel pipe"
    ),
    "vehicle": (
        "car bicycle bus motorcycle truck on_rails caravan trailer kick_scooter heavy_machinery military_vehicle"
    ),
    "vegetation": ("forest bush moss tree_crown tree_trunk crops high_grass scenery_vegetation hedge tree_root"),
    "human": "person rider",
    "sky": "sky",
}
#: The official file misspells its column; both spellings are read.
CATEGORY_COLUMNS = ("challege_category_id", "challenge_category_id")


def challenge_table(path: Path | None = None) -> UInt8[np.ndarray, "256"]:
    """Category 0..8 of every class id; 255 for ids that no class has.

    Args:
        path: an official ``challenge_label_mapping.csv`` to use instead of our copy of its facts.

    Raises:
        InputError: the file lacks a column or a class.
    """
    table = np.full(256, 255, np.uint8)
    if path is None:
        number = {name: i for i, name in read_vocabulary(VOCABULARY).names.items()}
        for category, names in enumerate(CHALLENGE.values()):
            table[[number[name] for name in names.split()]] = category
        return table
    rows = _rows(path)
    column = next((name for name in CATEGORY_COLUMNS if rows and name in rows[0]), None)
    if column is None:
        raise InputError(f"{path} has no column challenge_category_id; expected challenge_label_mapping.csv.")
    for i, row in _numbered(path, rows).items():
        try:
            category = int(row[column])
        except ValueError:
            category = -1
        if not 0 <= category < len(CHALLENGE):
            raise InputError(f"{path}: class {i} has category {row[column]!r}; expected 0..{len(CHALLENGE) - 1}.")
        table[i] = category
    absent = np.flatnonzero(table[:CLASSES] == 255)
    if len(absent):
        raise InputError(f"{path} lacks class {absent[0]}; expected all {CLASSES}.")
    return table


def check_class_list(path: Path) -> None:
    """Refuse a ``goose_label_mapping.csv`` whose ids mean other classes than ours.

    Raises:
        InputError: a class has another id, or a column is missing.
    """
    ours = read_vocabulary(VOCABULARY).names
    for i, row in _numbered(path, _rows(path)).items():
        name = row.get("class_name", "")
        if canonical(ours.get(i, "")) != canonical(name):
            raise InputError(
                f"{path} says that id {i} is {name!r}; in GOOSE it is {ours.get(i)!r}: labels of another release."
            )


def _rows(path: Path) -> list[dict[str, str]]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            return list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path} cannot be read as CSV ({error}).") from error


def _numbered(path: Path, rows: list[dict[str, str]]) -> dict[int, dict[str, str]]:
    found = {}
    for row in rows:
        key = row.get("label_key")
        if key is None or not key.strip().isdigit() or int(key) >= CLASSES:
            raise InputError(f"{path} has label_key {key!r}; expected a column of ids 0..{CLASSES - 1}.")
        found[int(key)] = row
    return found
