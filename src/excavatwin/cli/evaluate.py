"""``excavatwin evaluate``: a SITE, or a data set of them, against what is true."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from excavatwin.cli.mapping import Changes, Config

if TYPE_CHECKING:
    from excavatwin.evaluation.scores import Scores
    from excavatwin.studies.dataset_evaluation import Scoring


def evaluate_command(
    subject: Path,
    /,
    *,
    truth: Path | None = None,
    sites: Path | None = None,
    reference: Literal["truth", "lidar"] = "truth",
    align: Literal["auto", "declared", "cameras"] = "auto",
    policy: str | None = None,
    segmenter: Literal["mask2former", "yoloe"] = "mask2former",
    seed: int = 0,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"])] = None,
    json: Path | None = None,
    csv: Path | None = None,
    no_map: Annotated[bool, Parameter(name="--no-map", negative="")] = False,
    config: Config = None,
    changes: Changes = None,
) -> None:
    """Score a SITE folder, or every site of a data set, against the truth.

    Parameters
    ----------
    subject
        SITE folder that `map` or `fuse` wrote, or folder of a data set.
    truth
        For a SITE: truth.npz of a simulated site, or a GeoTIFF of terrain heights (elevation is scored, no classes).
    sites
        For a data set: folder of the SITE folders, one for each recording by its name; missing ones are mapped where
        the data set is simulated. By default NAME_sites in the current folder.
    reference
        What elevation is scored against: the exact truth, or elevation.tif, as a laser scanner would give it.
    align
        How map and truth come into one frame: declared (georeferences), cameras (photos of equal names: turn about
        the vertical and shift, never the scale), or auto (declared where both are, else cameras).
    policy
        For a data set with its own classes: which mapping to the task classes, diggable or strict.
    segmenter
        Whose row of the paper's semantic table stands beside ours.
    seed
        Of the bootstrap over sequences.
    output
        Folder for metrics.json and metrics.csv.
    json
        File for the metrics as JSON.
    csv
        File for the metrics as CSV.
    no_map
        Score only the sites that are there.
    config
        TOML file with stage parameters for sites that have to be mapped; flags win over it.
    """
    from excavatwin.cli.console import say, shown_progress
    from excavatwin.cli.metric_report import report
    from excavatwin.cli.plans import read_plan
    from excavatwin.cli.values import check_seed
    from excavatwin.errors import InputError
    from excavatwin.evaluation.scores import check_places, write_scores
    from excavatwin.studies.dataset_evaluation import Scoring

    if not subject.is_dir():
        what = "is a file" if subject.exists() else "does not exist"
        raise InputError(f"{subject} {what}; give a SITE folder, or the folder of a data set.")
    check_places(output, json, csv)
    if json is not None and csv is not None and json.absolute() == csv.absolute():
        raise InputError(f"--json and --csv are the same file, {json}; give two names.")
    if sites is not None and sites.exists() and not sites.is_dir():
        raise InputError(f"--sites {sites} is a file; give the folder of the SITE folders.")
    check_seed("--seed", seed)
    scoring = Scoring(align, reference, policy, segmenter, seed)
    if is_site(subject):
        if sites is not None or no_map:
            raise InputError(f"{subject} is a SITE; --sites and --no-map belong to data sets.")
        if config is not None or changes:
            raise InputError(f"{subject} is mapped already; give stage parameters to `map` or `fuse`, or a data set.")
        scores = _site_scores(subject, truth, scoring)
    else:
        if truth is not None:
            raise InputError(f"{subject} is no SITE (no map.nc); a data set brings its truth, so drop --truth.")
        plan = read_plan(config, changes)
        with shown_progress() as progress:
            from excavatwin.studies.dataset_evaluation import evaluate_folder

            scores = evaluate_folder(
                subject, sites or Path(f"{subject.resolve().name}_sites"), scoring,
                plan=plan, progress=progress, map_missing=not no_map,
            )  # fmt: skip
    written = write_scores(scores, output, json, csv)
    say(*report(scores), *(f"saved to {path}" for path in written))


def is_site(folder: Path) -> bool:
    """Whether a folder is what ``map`` or ``fuse`` wrote."""
    return (folder / "map.nc").is_file()


def _site_scores(site: Path, truth: Path | None, scoring: Scoring) -> Scores:
    from excavatwin.errors import InputError
    from excavatwin.studies.site_evaluation import evaluate_site_folder

    if truth is None:
        raise InputError(f"{site} is a SITE; say what is true with --truth truth.npz (or a GeoTIFF of heights).")
    return evaluate_site_folder(site, truth, scoring)
