"""Sequences and data sets on disk, in the layout of docs/oces-layout.md."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import asdict
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from excavatwin.errors import OutputError
from excavatwin.scene.progress import Progress, silent
from excavatwin.scene.staging import whole_file
from excavatwin.simulation.change import change_truth
from excavatwin.simulation.digging import digging_series
from excavatwin.simulation.layout import random_site
from excavatwin.simulation.recording.drone_photo import PLACE
from excavatwin.simulation.recording.epoch import MARK, record_epoch
from excavatwin.simulation.recording.shoot import Shoot
from excavatwin.simulation.site import CATEGORIES, DigSite

FORMAT, VERSION = "excavatwin-oces", 1
POLICY = "diggable"
"""The class policy of the labels: bare and dug soil are construction terrain, meadow and gravel are other terrain."""
START = datetime(2025, 6, 2, 9, 0, 0)
BETWEEN = timedelta(hours=1)
"""From epoch to epoch."""


def sequence_name(seed: int) -> str:
    """Name of the sequence that is recorded at ``random_site(seed)``."""
    return f"site_{seed:03d}"


def record_dataset(
    root: Path, shoots: Sequence[tuple[int, Shoot]], name: str = "OCES-like", progress: Progress = silent
) -> tuple[Path, ...]:
    """Record sequences into a data set, each at the site of its seed; other sequences of the data set stay.

    Args:
        root: folder of the data set, made when it is missing.
        shoots: seed of each site, and how it is recorded.

    Returns:
        Folders of the sequences.

    Raises:
        OutputError: ``root`` holds something else, or cannot be written.
        InputError: no digging series fits a site.
        MissingExtraError: the renderer is not installed.
    """
    listed = _listed(root)
    for _, shoot in shoots:
        shoot.take_photos().check()
    places = []
    for index, (seed, shoot) in enumerate(shoots):
        if len(shoots) > 1:
            progress("sequences", index, len(shoots))
        place = root / sequence_name(seed)
        record_sequence(place, random_site(seed), shoot, progress)
        listed = [*(known for known in listed if known != place.name), place.name]
        about = {
            "format": FORMAT, "version": VERSION, "name": name, "policy": POLICY,
            "categories": list(CATEGORIES), "sequences": sorted(listed),
        }  # fmt: skip
        _write(root / "dataset.json", about)
        places.append(place)
    if len(shoots) > 1:
        progress("sequences", len(shoots), len(shoots))
    return tuple(places)


def record_sequence(folder: Path, site: DigSite, shoot: Shoot, progress: Progress = silent) -> None:
    """Record one site, epoch by epoch; epochs that are finished already are kept.

    Args:
        folder: of the sequence; ``sequence.json`` appears in it when all epochs are complete.
    """
    states = digging_series(site, shoot.epochs) if shoot.epochs > 1 else (site,)
    names = [f"epoch_{number:02d}" for number in range(len(states))]
    times = [START + number * BETWEEN for number in range(len(states))]
    for number, (name, state, time) in enumerate(zip(names, states, times, strict=True)):
        record_epoch(folder / name, state, shoot, number, time, progress)
    if len(states) > 1:
        _write(folder / "change.json", _changes(names, states))
    else:
        (folder / "change.json").unlink(missing_ok=True)
    for stale in folder.glob("epoch_[0-9][0-9]"):  # of an earlier plan with more epochs
        if stale.name not in names and (stale / MARK).is_file():
            shutil.rmtree(stale)
    told = {
        "name": folder.name, "seed": site.seed, "renderer": shoot.renderer, "flight": shoot.flight,
        "conditions": asdict(shoot.conditions), "epsg": PLACE.epsg, "origin": list(PLACE.origin),
        "epochs": names, "times": [time.isoformat() for time in times],
    }  # fmt: skip
    _write(folder / "sequence.json", told)


def _changes(names: Sequence[str], states: Sequence[DigSite]) -> list[dict[str, Any]]:
    """What was moved from each epoch to the next, and from the first to the last."""
    pairs = [(k, k + 1) for k in range(len(names) - 1)]
    if len(names) > 2:
        pairs.append((0, len(names) - 1))
    moved = [(names[a], names[b], change_truth(states[a], states[b])) for a, b in pairs]
    return [
        {"from": a, "to": b, "cut_m3": change.cut, "fill_m3": change.fill, "net_m3": change.net}
        for a, b, change in moved
    ]


def _listed(root: Path) -> list[str]:
    """Sequences that the data set has.

    Raises:
        OutputError: the folder holds something that is no data set of ours.
    """
    about = root / "dataset.json"
    if about.is_file():
        try:
            told = json.loads(about.read_text("utf-8"))
            if told["format"] == FORMAT and told["version"] == VERSION:
                return [name for name in told["sequences"] if (root / name / "sequence.json").is_file()]
        except (ValueError, KeyError, TypeError):
            pass
        raise OutputError(f"{about} is no {FORMAT} of version {VERSION} and stays untouched; give a new folder.")
    strangers = [p.name for p in root.iterdir() if not _ours(p)] if root.is_dir() else []
    if strangers:
        raise OutputError(f"{root} already holds something else ({sorted(strangers)[0]}); give a new or empty folder.")
    if root.exists() and not root.is_dir():
        raise OutputError(f"{root} is a file, where a folder was to be written; give another name.")
    return []


def _ours(path: Path) -> bool:
    """Whether a first run that was stopped may have left this."""
    return path.name.startswith(".") or (path.is_dir() and path.name.startswith("site_"))


def _write(path: Path, content: Any) -> None:
    with whole_file(path) as file:
        file.write((json.dumps(content, indent=1) + "\n").encode())
