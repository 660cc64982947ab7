"""``excavatwin tables``: the paper's tables with our column beside the paper's."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from excavatwin.cli.ablate import Output, read_mapper, read_seeds, source_of
from excavatwin.cli.mapping import Changes, Config

if TYPE_CHECKING:
    from excavatwin.evaluation.metric import Metric


def tables_command(
    datasets: list[Path] | None = None,
    /,
    *,
    sites: Annotated[list[Path] | None, Parameter(name="--sites", negative="")] = None,
    segmenter: Literal["mask2former", "yoloe"] = "mask2former",
    policy: str | None = None,
    simulated: int | None = None,
    first_seed: int | None = None,
    output: Output,
    config: Config = None,
    changes: Changes = None,
) -> None:
    """The paper's tables (geometry, semantics, ablation), on the screen and as Markdown, LaTeX, JSON and CSV.

    Parameters
    ----------
    datasets
        Folders of data sets (RELLIS-3D, Objectron, GOOSE-Ex, OCES layout) whose columns are to be filled.
    sites
        For each of them, in order: folder of its SITE folders, one for each recording by its name.
    segmenter
        Backbone that those SITEs were mapped with.
    policy
        Mapping of their classes to the task classes, diggable or strict.
    simulated
        Number of simulated sites for OCES; 20 by default, 0 leaves them out.
    first_seed
        Seed of the first of them; the others follow. 200 by default: sites on which nothing was tuned.
    output
        Folder for tables.md, .tex, .json, .csv, and the finished cases, which a later run takes over.
    config
        TOML file with parameters of the full method; flags (--mapper...) win over it.
    """
    from excavatwin.cli.console import say, shown_progress
    from excavatwin.cli.values import check_folder
    from excavatwin.errors import InputError

    mapper = read_mapper(config, changes, "tables")
    check_folder(output)
    given, places = datasets or [], sites or []
    if len(given) != len(places):
        raise InputError(f"{len(given)} data sets and {len(places)} --sites are given; give one --sites for each.")
    if not given and simulated == 0:
        raise InputError("--simulated 0 without a data set leaves nothing to measure; give one of them.")
    seeds = range(0) if simulated == 0 else read_seeds(20 if simulated is None else simulated, first_seed)
    from excavatwin.studies.ablation import BACKBONE, FULL
    from excavatwin.studies.kept_cases import simulated_work, studied
    from excavatwin.studies.table import write_tables
    from excavatwin.studies.tables import Ours, ablations_in_order, paper_tables

    summaries = dict(summary(folder, place, segmenter, policy) for folder, place in zip(given, places, strict=True))
    work = [
        one
        for seed in seeds
        for backbone, only in (("yoloe", (BACKBONE, *ablations_in_order())), ("mask2former", (BACKBONE, FULL)))
        for one in simulated_work([seed], [backbone], only)
    ]
    with shown_progress() as progress:
        results = studied(work, output, mapper, progress) if work else []
    tables = paper_tables(Ours(results, source_of(seeds) if work else "", summaries, segmenter))
    written = write_tables(tables, output, "tables")
    say(*(table.markdown() for table in tables), *(f"saved to {path}" for path in written))


def summary(folder: Path, sites: Path, segmenter: str, policy: str | None) -> tuple[str, dict[str, Metric]]:
    """Name of a data set, and its metrics over all sequences by name.

    Raises:
        InputError: the folder holds no known data set, or the SITEs are not there or not of it.
    """
    from excavatwin.datasets import open_dataset
    from excavatwin.errors import InputError
    from excavatwin.studies.dataset_evaluation import evaluate_dataset
    from excavatwin.studies.paper_tables import TITLES
    from excavatwin.studies.site_evaluation import Scoring

    if not folder.is_dir():
        raise InputError(f"{folder} is no folder; give that of a data set (`excavatwin datasets` says which).")
    if not sites.is_dir():
        raise InputError(f"--sites {sites} is no folder; map the recordings of {folder} into it first.")
    dataset = open_dataset(folder)
    if dataset.name not in TITLES:
        raise InputError(f"the paper has no column for {dataset.name}; it has {', '.join(TITLES.values())}.")
    scores = evaluate_dataset(dataset, sites, Scoring(policy=policy, segmenter=segmenter), map_missing=False)
    return dataset.name, {metric.name: metric for metric in scores.summary}
