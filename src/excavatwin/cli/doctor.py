"""``excavatwin doctor``: what is installed, what each backbone needs, what a run will take."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter, validators

Positive = Annotated[int | None, Parameter(validator=validators.Number(gte=1))]


def doctor_command(
    *, photos: Positive = None, lattice: Annotated[int, Parameter(validator=validators.Number(gte=64))] = 640
) -> int:
    """What is installed, what each backbone needs, and the memory that photos need.

    Parameters
    ----------
    photos
        Estimate the memory for so many photos.
    lattice
        Long side of the lattice that the estimate is for [px].
    """
    import sys

    from excavatwin.cli.console import say
    from excavatwin.survey import memory
    from excavatwin.survey.journal import versions

    found = versions()
    missing = [name for name, version in found.items() if version == "missing"]
    free = memory.available()
    lines = [f"ExcavaTwin {found.pop('excavatwin')} on Python {found.pop('python')} ({sys.platform})"]
    lines += ["", f"  cores      {memory.cores()}"]
    lines += [f"  memory     {free / 1e9:.1f} GB available" if free else "  memory     unknown", ""]
    lines += [f"  {name:<24}{version}" for name, version in found.items()]
    lines += ["", *_backbones()]
    if photos is not None:
        need = memory.estimate(photos, lattice)
        verdict = "" if free is None else (": fits" if need < free else ": more than is available")
        lines += ["", f"{photos} photos on a lattice of {lattice} px need about {need / 1e9:.1f} GB{verdict}."]
        if free is not None and need >= free:
            fewer = max(
                int((free - memory.estimate(0, lattice)) / (memory.estimate(1, lattice) - memory.estimate(0, lattice))),
                0,
            )
            lines += [f"Map at most {fewer} photos at a time here, or use a smaller --photogrammetry.lattice."]
    if missing:
        lines += ["", f"missing: {', '.join(missing)}; run: pip install --upgrade excavatwin"]
    say(*lines)
    return 1 if missing else 0


def _backbones() -> list[str]:
    """Who is ready, and who could be."""
    from excavatwin.survey.backbone_states import states

    lines = []
    for kind in ("reconstructor", "segmenter"):
        rows = list(states(kind))
        ready = [row.card.name for row in rows if row.state == "ready"]
        lines.append(f"{kind}s ready: {', '.join(ready)} ({len(rows)} known; `excavatwin backbones` tells all)")
    return lines
