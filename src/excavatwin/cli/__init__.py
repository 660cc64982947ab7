"""The command line of ExcavaTwin."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: words after ``excavatwin``; by default those of the process.

    Returns:
        0 done · 1 a defect of ExcavaTwin · 2 something the user can mend, said in one sentence · 130 interrupted.
    """
    # TBB's tear-down can hang at exit; numba's own layer has none.
    os.environ.setdefault("NUMBA_THREADING_LAYER", "workqueue")
    words = list(sys.argv[1:] if argv is None else argv)
    debug = "--debug" in words
    words = [word for word in words if word != "--debug"]
    try:
        return _run(words)
    except BrokenPipeError:  # the reader of a pipe (`| head`) has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (Exception, KeyboardInterrupt) as error:
        if debug:
            raise
        return _explain(error)


def _run(words: list[str]) -> int:
    from excavatwin.cli.app import app
    from excavatwin.cli.flags import split_stage_flags
    from excavatwin.errors import InputError

    words, changes = split_stage_flags(words)
    command, bound, ignored = app.parse_args(words)
    if "changes" in ignored:
        bound.arguments["changes"] = changes
    elif changes:
        known = "map, fuse, config, check-backbone, demo, evaluate, ablate or tables"
        raise InputError(f"stage parameters belong to {known}.")
    result = command(*bound.args, **bound.kwargs)
    return result if isinstance(result, int) else 0


def _hides_interrupt(error: BaseException) -> bool:
    """Whether Ctrl-C came while compiled code ran: CPython then raises a SystemError with the interrupt behind it."""
    behind: BaseException | None = error
    while isinstance(behind, SystemError):
        behind = behind.__cause__ or behind.__context__
    return isinstance(behind, KeyboardInterrupt)


def _explain(error: BaseException) -> int:
    """One sentence on stderr, and the exit code."""
    from cyclopts import CycloptsError

    from excavatwin.cli.console import complain
    from excavatwin.errors import ExcavatwinError

    if isinstance(error, KeyboardInterrupt) or _hides_interrupt(error):
        complain("interrupted; finished stages are kept, and the same command resumes after them.")
        return 130
    if isinstance(error, CycloptsError):
        complain(f"{error} (see `excavatwin --help`)")
        return 2
    if isinstance(error, ExcavatwinError):
        complain(str(error))
        return 2
    if isinstance(error, MemoryError):
        complain("memory ran out; `excavatwin doctor --photos N` tells how much N photos need, fewer need less.")
        return 2
    complain(
        f"unexpected {type(error).__name__}: {error}; this is a defect: run again with --debug "
        "and report what it prints."
    )
    return 1
