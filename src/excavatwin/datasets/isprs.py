"""The ISPRS filter test (Sithole and Vosselman, 2004): airborne clouds whose bare earth was marked by hand.

Read from the official ``sampNN.txt`` (x, y, z, 0 = bare earth or 1 = object) and from ``sampNN.npz`` (xyz, ground).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from excavatwin.datasets.folders import files_in, roots_below
from excavatwin.datasets.readers import read_matrix
from excavatwin.errors import InputError
from excavatwin.scene.recording import Dataset, PointCloud, Recording, Scan, Stored

#: All samples of the test.
SAMPLES = ("11", "12", "21", "22", "23", "24", "31", "41", "42", "51", "52", "53", "54", "61", "71")
#: Published numbers of points and of bare-earth points, by which a swapped class column is found.
PUBLISHED = {
    "11": (38010, 21786), "12": (52119, 26691), "21": (12960, 10085), "24": (7492, 5434),
    "31": (28862, 15556), "51": (17845, 13950), "52": (22474, 20112), "61": (35060, 33854),
}  # fmt: skip

_SAMPLE = re.compile(r"samp(\d\d)", re.IGNORECASE)


def is_root(folder: Path) -> bool:
    """Whether a folder holds ``sampNN.txt`` or ``sampNN.npz``."""
    return any(_SAMPLE.fullmatch(file.stem) for file in files_in([folder], ".txt", ".npz"))


def find_roots(folders: Sequence[Path]) -> tuple[Path, ...]:
    """Roots below the folders."""
    return roots_below(folders, is_root)


def open_isprs(folders: Sequence[Path]) -> Dataset:
    """The samples in one or several folders; each recording is one cloud with its ground.

    Raises:
        InputError: no sample is there.
    """
    roots = find_roots(folders)
    files = {m[1]: file for file in files_in(roots, ".txt", ".npz") if (m := _SAMPLE.fullmatch(file.stem))}
    if not files:
        raise InputError(f"{folders[0]} holds no sample of the ISPRS filter test: no samp11.txt or samp11.npz.")
    missing = [f"samp{number}" for number in SAMPLES if number not in files]
    return Dataset(
        name="isprs",
        folders=roots,
        names=tuple(f"samp{number}" for number in sorted(files)),
        open=partial(_recording, files=files),
        counts={"clouds": len(files)},
        missing=(f"{len(missing)} of {len(SAMPLES)} samples ({', '.join(missing)})",) if missing else (),
        checks=("whether a point is bare earth is tested against the published counts as each cloud is read.",),
    )


def _recording(name: str, files: dict[str, Path]) -> Recording:
    file = files[name.removeprefix("samp")]
    return Recording(name, scans=(Scan(name, Stored(file, read_sample)),))


def read_sample(path: Path) -> PointCloud:
    """One sample; coordinates less their least ones, in whole metres, so that float32 holds them.

    Raises:
        InputError: the file is damaged, or its bare earth is not the published one.
    """
    if path.suffix == ".npz":
        try:
            with np.load(path, allow_pickle=False) as archive:
                xyz, ground = archive["xyz"].astype(np.float64), archive["ground"].astype(bool)
        except (OSError, ValueError, KeyError) as error:
            raise InputError(f"{path} is no sample: expected arrays xyz and ground ({error}).") from error
    else:
        rows = read_matrix(path, 4)
        xyz, kind = rows[:, :3], rows[:, 3]
        if not np.isin(kind, (0, 1)).all():
            raise InputError(f"{path}: the fourth column holds {kind[~np.isin(kind, (0, 1))][0]:g}; expected 0 or 1.")
        ground = kind == 0
    if len(xyz) != len(ground) or not len(xyz):
        raise InputError(f"{path} holds {len(xyz)} points and {len(ground)} classes.")
    match = _SAMPLE.fullmatch(path.stem)
    points, earth = PUBLISHED.get(match[1] if match else "", (0, 0))
    if len(xyz) == points and ground.sum() != earth:
        swapped = "; its classes are swapped" if ground.sum() == points - earth else ""
        raise InputError(f"{path} has {ground.sum()} bare-earth points, published are {earth}{swapped}.")
    origin = np.floor(xyz[:, :2].min(0)) if path.suffix == ".txt" else np.zeros(2)
    return PointCloud((xyz - [*origin, 0.0]).astype(np.float32), ground=ground)
