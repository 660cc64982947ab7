"""``excavatwin map`` and ``excavatwin fuse``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

if TYPE_CHECKING:
    from excavatwin.survey.plan import Plan

Site = Annotated[Path, Parameter(name=["--output", "-o"])]
Reference = Annotated[list[str] | None, Parameter(name="--reference", negative="")]
Config = Annotated[Path | None, Parameter(name="--config")]
Changes = Annotated[Mapping[str, Any] | None, Parameter(parse=False)]


def map_command(
    photos: Path,
    /,
    *,
    site: Site,
    reference: Reference = None,
    config: Config = None,
    fresh: Annotated[bool, Parameter(negative="")] = False,
    changes: Changes = None,
) -> None:
    """Map a folder of photos (JPEG, PNG, TIFF) or a video, and write the SITE folder.

    Parameters
    ----------
    photos
        Folder of photos, or a video file.
    site
        SITE folder for the results; an earlier SITE there is replaced.
    reference
        A known distance, "PHOTO:x1,y1:x2,y2=METRES": two pixels of a photo and the metres between them. Repeatable.
    config
        TOML file with stage parameters; flags win over it.
    fresh
        Forget the finished stages of earlier runs.
    """
    from excavatwin.cli.console import shown_progress
    from excavatwin.cli.summary import say_result
    from excavatwin.survey import map_photos

    plan = read_plan(config, changes)
    with shown_progress() as progress:
        result = map_photos(
            photos, site, plan=plan, references=parse_references(reference), progress=progress, fresh=fresh
        )
    say_result(result, site, f"excavatwin map {photos} -o {site}")


def fuse_command(
    observations: Path,
    /,
    *,
    site: Site,
    reference: Reference = None,
    config: Config = None,
    force: Annotated[bool, Parameter(negative="")] = False,
    class_mapping: str | None = None,
    changes: Changes = None,
) -> None:
    """Fuse observations that your own models made, and write the SITE folder.

    Parameters
    ----------
    observations
        File or folder of observations.
    site
        SITE folder for the results; an earlier SITE there is replaced.
    reference
        A known distance, "VIEW:x1,y1:x2,y2=METRES": two pixels of a view and the metres between them. Repeatable.
    config
        TOML file with stage parameters; flags win over it.
    force
        Go on although the points do not reproject onto their own pixels.
    class_mapping
        For labels in another vocabulary: task, ade20k-150, coco-panoptic, cityscapes, goose-64, rellis-3d (after
        them, ":strict" for that policy instead of "diggable"), or a TOML file of your own.
    """
    from excavatwin.cli.console import shown_progress
    from excavatwin.cli.summary import say_result
    from excavatwin.errors import InputError
    from excavatwin.survey import fuse_observations

    unused = [name for name in changes or {} if name != "mapper"]
    plan = read_plan(config, changes)
    if unused:
        raise InputError(f"`fuse` has no stage {unused[0]}: its parameters begin with --mapper.")
    with shown_progress() as progress:
        result = fuse_observations(
            observations,
            site,
            plan=plan,
            references=parse_references(reference),
            progress=progress,
            force=force,
            mapping=class_mapping,
        )
    say_result(result, site, f"excavatwin fuse {observations} -o {site}")


def parse_references(texts: list[str] | None) -> tuple[Any, ...]:
    """The ``--reference`` flags, parsed."""
    from excavatwin.cli.references import parse_reference

    return tuple(parse_reference(text) for text in texts or ())


def read_plan(config: Path | None, changes: Mapping[str, Any] | None) -> Plan:
    """The default plan, changed by a TOML file, changed by flags.

    Raises:
        InputError: the file cannot be read, or names or values do not fit.
    """
    import tomllib

    from excavatwin.cli.flags import merge
    from excavatwin.cli.settings import configure
    from excavatwin.errors import InputError
    from excavatwin.survey.plan import Plan

    table: dict[str, Any] = {}
    if config is not None:
        try:
            table = tomllib.loads(config.read_text(encoding="utf-8"))
        except OSError as error:
            raise InputError(f"--config {config} cannot be read ({error.strerror}).") from None
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise InputError(f"--config {config} is not valid TOML: {error}.") from None
    plan: Plan = configure(Plan(), merge(table, dict(changes or {})))
    return plan
