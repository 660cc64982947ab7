"""``excavatwin layers`` and ``excavatwin config``."""

from __future__ import annotations

from excavatwin.cli.mapping import Changes, Config
from excavatwin.cli.plans import ReconstructorFlag, SegmenterFlag


def layers_command() -> None:
    """The layers of a map and the classes, with their ids."""
    import re

    from excavatwin.cli.console import say, wrapped
    from excavatwin.export import describe_layers
    from excavatwin.scene.taxonomy import NOT_OBSERVED, PALETTE, TaskClass, class_name

    lines = ["Layers of map.nc, rows from north to south:"]
    for row in describe_layers():
        head = f"  {row.name:<14}{row.dtype:<8}{row.unit or '-':<3}fill {row.fill:<4} "
        lines += wrapped(head, row.meaning, 118)
        ids = re.sub(r"(\d) ", "\\1\u00a0", row.values)  # an id and its name stay on one line
        lines += wrapped(" " * len(head), ids, 118) if ids else []
    lines += ["", "Classes and their colours:"]
    for value in (*TaskClass, NOT_OBSERVED):
        red, green, blue = PALETTE[value]
        lines.append(f"  {int(value):>3}  {class_name(value):<22}#{red:02x}{green:02x}{blue:02x}")
    say(*lines)


def config_command(
    *,
    reconstructor: ReconstructorFlag = None,
    segmenter: SegmenterFlag = None,
    config: Config = None,
    changes: Changes = None,
) -> None:
    """Every parameter of every stage with its meaning, as TOML that --config takes back.

    Parameters
    ----------
    reconstructor
        Show the parameters of this reconstructor; `excavatwin backbones` lists all.
    segmenter
        Show the parameters of this segmenter; repeat it for an ensemble.
    config
        TOML file with stage parameters to start from.
    """
    from excavatwin.cli.console import say
    from excavatwin.cli.plans import Choice, read_plan, to_toml

    say(to_toml(read_plan(config, changes, Choice(reconstructor, segmenter))).rstrip())
