"""``excavatwin simulate``: photos of made-up sites with exact truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Group, Parameter

if TYPE_CHECKING:
    from excavatwin.simulation.recording import Shoot

Air = Group("Conditions", sort_key=1)
MIXED = ("orbit", "lawnmower", "hover")


def simulate_command(
    *,
    out: Annotated[Path, Parameter(name=["--output", "-o"])],
    seed: int = 1,
    sequences: int = 1,
    epochs: int = 1,
    flight: Literal["orbit", "lawnmower", "hover", "mixed"] = "orbit",
    views: int = 16,
    width: int = 640,
    renderer: Literal["fast", "photoreal"] = "fast",
    samples: int | None = None,
    gps_error: float = 0.02,
    sun_elevation: Annotated[float | None, Parameter(group=Air)] = None,
    turbidity: Annotated[float, Parameter(group=Air)] = 3.0,
    dust: Annotated[float, Parameter(group=Air)] = 0.0,
    motion_blur: Annotated[float, Parameter(group=Air)] = 0.0,
    exposure_drift: Annotated[float, Parameter(group=Air)] = 0.0,
    grain: Annotated[float, Parameter(group=Air)] = 0.8,
) -> None:
    """Record made-up dig sites: photos, and the truth of every pixel and cell.

    Parameters
    ----------
    out
        Folder of the data set; sequences that it has already stay.
    seed
        Seed of the (first) site: everything on it is drawn from it.
    sequences
        Number of sites, with seeds that count up.
    epochs
        States of each site; from one to the next the pit deepens, the heap grows.
    flight
        Around the site, in lines across it, one place beside it, or each in turn.
    views
        Photos of an epoch.
    width
        Of the photos in pixels; 1024 is about 3.6 cm a pixel on an orbit.
    renderer
        Our own tracer, or Mitsuba with soft light and real leaves (extra sim).
    samples
        Rays per pixel; by default 2 x 2 (fast) or 16 (photoreal).
    gps_error
        Standard deviation of the photos' positions in metres; 0.02 is RTK.
    sun_elevation
        In degrees instead of the site's own; 12 is a low evening sun.
    turbidity
        Haze of the sky, 1 to 10 (photoreal).
    dust
        Optical depth of a cloud about the bucket; 1 hides two thirds behind it.
    motion_blur
        Mean smear in pixels.
    exposure_drift
        Spread of the exposure from photo to photo, in stops.
    grain
        Noise of the sensor, in grey levels of 255.
    """
    import time

    from excavatwin.cli.console import shown_progress
    from excavatwin.cli.values import check_seed
    from excavatwin.errors import InputError
    from excavatwin.simulation.conditions import Conditions
    from excavatwin.simulation.recording import Shoot, record_dataset

    if sequences < 1:
        raise InputError(f"--sequences is {sequences}; expected a number of sites, such as 3.")
    if not 0 <= gps_error <= 100:
        raise InputError(f"--gps-error is {gps_error}; expected metres, at least 0 and at most 100.")
    check_seed("--seed", seed)
    conditions = Conditions(sun_elevation, turbidity, dust, motion_blur, exposure_drift, grain)
    flights = MIXED if flight == "mixed" else (flight,)
    shoots = [
        (
            seed + k,
            Shoot(
                flights[k % len(flights)], views, width, epochs, renderer, samples, conditions,
                (gps_error, 1.5 * gps_error),
            ),
        )
        for k in range(sequences)
    ]  # fmt: skip
    begin = time.monotonic()
    with shown_progress() as progress:
        places = record_dataset(out, shoots, progress=progress)
    _say_result(out, places[0], shoots[0][1], sequences, time.monotonic() - begin)


def _say_result(out: Path, first: Path, shoot: Shoot, sequences: int, seconds: float) -> None:
    """What was made by which renderer, and what to type next."""
    from excavatwin.cli.console import say

    photos = sequences * shoot.epochs * shoot.views
    tracer = "our own tracer" if shoot.renderer == "fast" else "Mitsuba"
    say(
        f"{photos} photos of {sequences} site{'s' * (sequences > 1)}, {shoot.width} px wide, by the {shoot.renderer} "
        f"renderer ({tracer}), in {seconds:.0f} s: {out}",
        "  photos, truth of every pixel, laser scan, objects: docs/oces-layout.md tells the files",
    )
    if shoot.renderer == "fast":
        say('  soft light and real leaves: --renderer photoreal (pip install "excavatwin[sim]")')
    site, epoch = f"{first.name}_map", first / "epoch_00"
    say("", "Next:", f"  excavatwin map {epoch / 'images'} -o {site}")
    say(f"  excavatwin evaluate {site} --truth {epoch / 'truth.npz'}")
