"""``excavatwin datasets``: what to download, where it goes, and whether what is there can be used."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

if TYPE_CHECKING:
    from excavatwin.datasets import Examination, Source
    from excavatwin.scene.recording import Dataset

#: Entries of a list that are shown before "and N more".
SHOWN = 6
WIDTH = 118


def datasets_command(*folders: Path, everything: Annotated[bool, Parameter(name="--all", negative="")] = False) -> None:
    """What to download of each data set and where it goes; or, with FOLDERS, what lies there and whether it is whole.

    Parameters
    ----------
    folders
        Folder of a data set, or of its parts; a name such as rellis-3d stands for its folder below EXCAVATWIN_DATASETS.
    everything
        Read every file, not a sample of them.
    """
    from excavatwin.cli.console import say, shown_progress
    from excavatwin.datasets import SOURCES, examine, open_dataset
    from excavatwin.errors import InputError

    if not folders:
        if everything:
            raise InputError("--all reads the files of a data set; give its folder.")
        say(*_catalogue(SOURCES))
        return
    with shown_progress() as progress:
        progress("open", 0, 1)
        dataset = open_dataset(list(folders))
        found = examine(dataset, everything, progress)
    say(*_report(dataset, found))
    if found.problems:
        count = len(found.problems)
        raise InputError(
            f"{count} of {found.files} files that were read cannot be used; the first: {found.problems[0]}"
        )


def _catalogue(sources: tuple[Source, ...]) -> list[str]:
    from excavatwin.cli.console import wrapped
    from excavatwin.datasets import ENVIRONMENT, dataset_folder

    lines = [f"Data sets, each in a folder of its name below ${ENVIRONMENT}, or anywhere by path:"]
    for source in sources:
        place = dataset_folder(source.name)
        state = "" if place is None else f" (there is {'such a' if place.is_dir() else 'no such'} folder)"
        lines += ["", f"{source.name:<11} {source.title}: {source.serves}"]
        rows = {
            "from": source.place,
            "licence": source.licence,
            "take": "; ".join(source.take),
            "lies": source.layout,
            "goes to": f"${ENVIRONMENT}/{source.name}{state}",
        }
        for head, text in rows.items():
            lines += wrapped(f"  {head:<9} ", text, WIDTH)
    return [*lines, "", "excavatwin datasets FOLDER   tests what is there"]


def _report(dataset: Dataset, found: Examination) -> list[str]:
    from excavatwin.cli.console import wrapped

    lines = [f"{dataset.name} in {_listed([str(folder) for folder in dataset.folders], 3)}"]
    rows: list[tuple[str, str]] = [
        ("recordings", f"{len(dataset)}: {_listed(dataset.names)}"),
        ("holds", ", ".join(f"{what} {count}" for what, count in dataset.counts.items())),
    ]
    if any(dataset.splits.values()):
        rows.append(("splits", ", ".join(f"{split} {count}" for split, count in dataset.splits.items())))
    if dataset.vocabulary:
        rows.append(("classes", f"{dataset.vocabulary}{_policies(dataset.vocabulary)}"))
    rows += [("categories", ", ".join(dataset.categories))] if dataset.categories else []
    rows += [("tested", check) for check in dataset.checks]
    rows += [("left out", f"{item.what}: {item.reason}") for item in dataset.excluded]
    rows += [("missing", what) for what in dataset.missing] or [("missing", "nothing")]
    rows += [("doubt", doubt) for doubt in found.doubts]
    rows.append(("read", f"files {found.files} of recordings {found.recordings}, unusable {len(found.problems)}"))
    rows += [("unusable", problem) for problem in found.problems[:SHOWN]]
    for head, text in rows:
        lines += wrapped(f"  {head:<10} ", text, WIDTH)
    return lines


def _policies(vocabulary: str) -> str:
    from excavatwin.vocabularies import policies_of

    names = policies_of(vocabulary)
    return f" (policies: {', '.join(names)})" if len(names) > 1 else ""


def _listed(names: list[str] | tuple[str, ...], most: int = SHOWN) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
