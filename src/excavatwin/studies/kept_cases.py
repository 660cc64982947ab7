"""Work of a study, one case after the other: finished ones are kept, so that a stopped run goes on where it was."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import excavatwin
from excavatwin.evaluation.dimensions import MeasuredObject
from excavatwin.mapper import Mapper
from excavatwin.scene.progress import Progress, silent
from excavatwin.scene.staging import whole_file
from excavatwin.studies.ablation import CaseResult, chosen, study_case
from excavatwin.studies.cases import SEGMENTERS, VIEWS, Case, simulated_case
from excavatwin.survey import fingerprint

FOLDER = "cases"
"""Of the finished cases, inside the output folder."""
ROOMS = ("geometry", "semantics", "mapping", "scene", "kernels", "simulation", "evaluation")
MODULES = ("mapper", "accumulation", "topology", *(f"studies.{name}" for name in (
    "ablation", "baselines", "cases", "case_files", "pixels", "references", "terrain")))  # fmt: skip
"""Code that a figure depends on, beside the rooms: a changed algorithm must not answer with old figures."""


@dataclass(frozen=True)
class Work:
    """One case to be studied."""

    name: str
    """Of its file."""
    backbone: str
    make: Callable[[], Case]
    """Called only when the case is not kept already."""
    facts: tuple[Any, ...] = ()
    """What the case depends on."""
    only: tuple[str, ...] = ()
    """Configurations; empty means all."""


def simulated_work(seeds: Sequence[int], backbones: Sequence[str], only: Sequence[str] = ()) -> list[Work]:
    """Random sites with emulated backbones; a site's backbones follow each other, since they share its photos."""

    def one(seed: int, backbone: str) -> Work:
        facts = (seed, backbone, VIEWS, SEGMENTERS[backbone]())
        return Work(f"site_{seed}_{backbone}", backbone, lambda: simulated_case(seed, backbone), facts, tuple(only))

    return [one(seed, backbone) for seed in seeds for backbone in backbones]


def studied(
    work: Sequence[Work], folder: Path, mapper: Mapper | None = None, progress: Progress = silent
) -> list[CaseResult]:
    """The results of every case, in order; those that are in the folder already are read, not computed again.

    Args:
        folder: of the output; a file a case is kept in its ``cases``.
        mapper: the full method.

    Raises:
        InputError: no such configuration, or a case cannot be mapped.
        OutputError: the folder cannot be written.
    """
    mapper, results = mapper or Mapper(), []
    code = code_digest()
    for done, one in enumerate(work):
        progress(f"cases: {one.name}", done, len(work))
        path = folder / FOLDER / f"{one.name}.json"
        key = fingerprint.key(excavatwin.__version__, code, mapper, one.facts)
        kept, wanted = read_kept(path, key), chosen(one.only)
        if kept is None or not set(wanted) <= set(kept.rows):
            also = () if kept is None else tuple(kept.rows)
            names = () if not one.only else tuple(dict.fromkeys((*wanted, *also)))
            kept = study_case(one.make(), one.backbone, mapper, names, _inner(progress, done, len(work)))
            write_kept(path, key, kept)
        results.append(replace(kept, rows={name: kept.rows[name] for name in wanted}))
    progress("cases: done", len(work), len(work))
    return results


def _inner(progress: Progress, at: int, cases: int) -> Progress:
    """Progress inside a case, told as progress of the whole."""

    def tell(stage: str, done: int, total: int) -> None:
        progress(f"cases: {stage.replace(': ', ', ')}", at, cases)

    return tell


def code_digest() -> str:
    """Digest of the code that the figures depend on."""
    digest = hashlib.blake2b(digest_size=10)
    digest.update(fingerprint.of_code(*(f"excavatwin.{room}" for room in ROOMS)).encode())
    for name in MODULES:
        spec = importlib.util.find_spec(f"excavatwin.{name}")
        if spec is not None and spec.origin is not None:
            digest.update(Path(spec.origin).read_bytes())
    return digest.hexdigest()


def write_kept(path: Path, key: str, result: CaseResult) -> None:
    """Keep a result.

    Raises:
        OutputError: it cannot be written.
    """
    rows = {name: {k: v if math.isfinite(v) else None for k, v in row.items()} for name, row in result.rows.items()}
    table = {"excavatwin": excavatwin.__version__, "key": key, **asdict(result), "rows": rows}
    with whole_file(path) as file:
        file.write((json.dumps(table, indent=1, allow_nan=False, ensure_ascii=False) + "\n").encode())


def read_kept(path: Path, key: str) -> CaseResult | None:
    """A kept result; None where there is none, or one of other code, parameters or input."""
    try:
        table = json.loads(path.read_text("utf-8"))
        if table["key"] != key:
            return None
        rows = {
            name: {k: float("nan") if v is None else float(v) for k, v in row.items()}
            for name, row in table["rows"].items()
        }
        objects = tuple(
            MeasuredObject(**{**one, "measured": tuple(one["measured"]), "true": tuple(one["true"])})
            for one in table["objects"]
        )
        return CaseResult(table["case"], table["backbone"], rows, objects, tuple(table["doubts"]))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None  # not there, or of another form: computed anew
