"""``excavatwin ground-filters``: our terrain stage against CSF, PMF and SMRF on plain clouds."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def ground_filters_command(
    *,
    isprs: Path | None = None,
    simulated: int = 0,
    first_seed: int = 100,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
) -> None:
    """Compare ground filters; tables on the screen and in the folder.

    Parameters
    ----------
    isprs
        Folder with samples of the ISPRS filter test (samp11.txt or samp11.npz, ...).
    simulated
        Number of simulated dig sites.
    first_seed
        Seed of the first of them; the others follow.
    output
        Folder for ground_filters.md, .tex, .json and .csv.
    """
    # CSF's threads wait by spinning, a hundred times slower on a busy machine; read when its library is loaded.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    from excavatwin.cli.console import say, shown_progress
    from excavatwin.cli.values import check_folder, check_seed
    from excavatwin.errors import InputError

    if isprs is not None and not isprs.is_dir():
        raise InputError(f"{isprs} is no folder; give the one that holds the ISPRS samples.")
    if simulated < 0:
        raise InputError(f"--simulated is {simulated}; expected a number of sites, such as 4.")
    check_seed("--first-seed", first_seed)
    check_folder(output)
    from excavatwin.studies.ground_filters import compare_filters

    with shown_progress() as progress:
        tables, written = compare_filters(isprs, range(first_seed, first_seed + simulated), output, progress)
    say(*(table.markdown() for table in tables), *(f"saved to {path}" for path in written))
