"""``excavatwin ablate``: what each part of the method is worth, on simulated sites or on data of one's own."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from excavatwin.cli.mapping import Changes, Config, Reference

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any

    from excavatwin.mapper import Mapper
    from excavatwin.studies.kept_cases import Work

Output = Annotated[Path, Parameter(name=["--output", "-o"])]


def ablate_command(
    observations: Path | None = None,
    /,
    *,
    truth: Path | None = None,
    simulated: int | None = None,
    first_seed: int | None = None,
    backbone: Literal["yoloe", "mask2former", "both"] = "both",
    only: Annotated[list[str] | None, Parameter(name="--only", negative="")] = None,
    reference: Reference = None,
    force: Annotated[bool, Parameter(negative="")] = False,
    output: Output,
    config: Config = None,
    changes: Changes = None,
) -> None:
    """Fuse every case with every configuration, and score each; tables on the screen and in the folder.

    Parameters
    ----------
    observations
        File or folder of observations, as for `fuse`; without it, simulated sites.
    truth
        truth.npz of their site, with class images of their photos by the same names.
    simulated
        Number of simulated sites; 20 by default.
    first_seed
        Seed of the first of them; the others follow. 200 by default: sites on which nothing was tuned.
    backbone
        Emulated backbone of the simulated sites.
    only
        Name of a configuration, such as "plain 3D voting"; the full method is always there. Repeatable.
    reference
        For OBSERVATIONS: a known distance, "VIEW:x1,y1:x2,y2=METRES". Repeatable.
    force
        Go on although the points do not reproject onto their own pixels.
    output
        Folder for ablation.md, .tex, .json, .csv, and the finished cases, which a later run takes over.
    config
        TOML file with parameters of the full method; flags (--mapper...) win over it.
    """
    from excavatwin.cli.console import say, shown_progress
    from excavatwin.cli.values import check_folder
    from excavatwin.errors import InputError

    mapper = read_mapper(config, changes, "ablate")
    check_folder(output)
    if observations is None and (truth is not None or reference or force):
        raise InputError("--truth, --reference and --force belong to OBSERVATIONS, which are not given.")
    if observations is not None and (simulated is not None or first_seed is not None):
        raise InputError("OBSERVATIONS and --simulated exclude each other; run the command once for each.")
    if observations is not None and backbone != "both":
        raise InputError("--backbone belongs to simulated sites; OBSERVATIONS have the classes that are in them.")
    seeds = read_seeds(20 if simulated is None else simulated, first_seed)
    from excavatwin.studies.ablation import chosen
    from excavatwin.studies.ablation_tables import ablation_tables
    from excavatwin.studies.kept_cases import simulated_work, studied
    from excavatwin.studies.table import write_tables

    chosen(tuple(only or ()))
    if observations is not None:
        work, source = [own_work(observations, truth, reference, force, only)], f"{observations.name}, {truth}"
    else:
        backbones = ("yoloe", "mask2former") if backbone == "both" else (backbone,)
        work, source = simulated_work(seeds, backbones, tuple(only or ())), source_of(seeds)
    with shown_progress() as progress:
        results = studied(work, output, mapper, progress)
    tables = ablation_tables(results, source, "oces" if observations is None else "")
    written = write_tables(tables, output, "ablation")
    say(*(table.markdown() for table in tables), *(f"saved to {path}" for path in written))


def own_work(
    observations: Path, truth: Path | None, reference: list[str] | None, force: bool, only: list[str] | None
) -> Work:
    """The one case that files hold, read at once so that what is wrong with them is said at once.

    Raises:
        InputError: one of them is missing or cannot be read, or they do not belong together.
    """
    from excavatwin.cli.mapping import parse_references
    from excavatwin.errors import InputError
    from excavatwin.studies.case_files import case_from_files
    from excavatwin.studies.kept_cases import Work
    from excavatwin.survey import fingerprint

    if truth is None:
        raise InputError("what is true about OBSERVATIONS is not given: add --truth truth.npz.")
    references = parse_references(reference)
    case = case_from_files(observations, truth, references, force)
    files = sorted(observations.rglob("*")) if observations.is_dir() else [observations]
    hashes = fingerprint.of_files([*(file for file in files if file.is_file()), truth])
    facts = (sorted(hashes.values()), references, force)
    return Work(f"own_{observations.stem}", case.name, lambda: case, facts, tuple(only or ()))


def read_mapper(config: Path | None, changes: Mapping[str, Any] | None, command: str) -> Mapper:
    """The full method with the parameters that the user wants.

    Raises:
        InputError: the file cannot be read, or names or values do not fit.
    """
    from excavatwin.cli.plans import read_plan
    from excavatwin.errors import InputError

    unused = [name for name in changes or {} if name != "mapper"]
    plan = read_plan(config, changes)
    if unused:
        raise InputError(f"`{command}` has no stage {unused[0]}: its parameters begin with --mapper.")
    return plan.mapper


def read_seeds(simulated: int, first_seed: int | None) -> range:
    """Seeds of the simulated sites; the held-out ones unless another first one is given.

    Raises:
        InputError: there is none, or the first is no seed.
    """
    from excavatwin.cli.values import check_seed
    from excavatwin.errors import InputError

    first = 200 if first_seed is None else first_seed
    if simulated < 1:
        raise InputError(f"--simulated is {simulated}; expected a number of sites, such as 4.")
    check_seed("--first-seed", first)
    return range(first, first + simulated)


def source_of(seeds: range) -> str:
    """What the tables say about the sites, and whether parameters were chosen on them."""
    from excavatwin.studies.cases import TUNING_SEEDS

    where = f"simulated sites with seeds {seeds.start} to {seeds.stop - 1}" if len(seeds) > 1 else (
        f"simulated site with seed {seeds.start}"
    )  # fmt: skip
    tuned = set(seeds) & set(TUNING_SEEDS)
    return f"{where}, {'on which parameters were chosen' if tuned else 'on which nothing was tuned'}"
