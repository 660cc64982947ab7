"""``excavatwin layers`` and ``excavatwin config``."""

from __future__ import annotations

from excavatwin.cli.mapping import Changes, Config


def layers_command() -> None:
    """The layers of a map and the classes, with their ids."""
    import textwrap

    from excavatwin.cli.console import say
    from excavatwin.scene.elevation_map import LAYERS
    from excavatwin.scene.taxonomy import NOT_OBSERVED, PALETTE, Reason, Support, TaskClass, class_name

    lines = ["Layers of map.nc, rows from north to south:"]
    for layer in LAYERS:
        head = f"  {layer.name:<14}{layer.dtype:<9}{layer.unit:<3}fill {layer.fill!s:<5}"
        lines += textwrap.wrap(layer.meaning, 118, initial_indent=head, subsequent_indent=" " * len(head))
    lines += ["", "Classes (label):"]
    for value in (*TaskClass, NOT_OBSERVED):
        red, green, blue = PALETTE[value]
        lines.append(f"  {int(value):>3}  {class_name(value):<22}#{red:02x}{green:02x}{blue:02x}")
    for title, values in (("Reasons (reason)", Reason), ("Support (support)", Support)):
        lines += ["", f"{title}:", *(f"  {int(value):>3}  {value.name.lower()}" for value in values)]
    say(*lines)


def config_command(*, config: Config = None, changes: Changes = None) -> None:
    """Every parameter of every stage with its meaning, as TOML that --config takes back.

    Parameters
    ----------
    config
        TOML file with stage parameters to start from.
    """
    from excavatwin.cli.console import say
    from excavatwin.cli.mapping import read_plan
    from excavatwin.cli.settings import to_toml

    say(to_toml(read_plan(config, changes)).rstrip())
