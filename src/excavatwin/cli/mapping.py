"""``excavatwin map`` and ``excavatwin fuse``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from excavatwin.cli.plans import Choice, MapFlag, ReconstructorFlag, SegmenterFlag, read_plan

Site = Annotated[Path, Parameter(name=["--output", "-o"])]
Reference = Annotated[list[str] | None, Parameter(name="--reference", negative="")]
Config = Annotated[Path | None, Parameter(name="--config")]
Changes = Annotated[Mapping[str, Any] | None, Parameter(parse=False)]


def map_command(
    photos: Path,
    /,
    *,
    site: Site,
    reconstructor: ReconstructorFlag = None,
    segmenter: SegmenterFlag = None,
    remap: MapFlag = None,
    reference: Reference = None,
    config: Config = None,
    download: Annotated[bool, Parameter(negative="")] = False,
    fresh: Annotated[bool, Parameter(negative="")] = False,
    force: Annotated[bool, Parameter(negative="")] = False,
    changes: Changes = None,
) -> None:
    """Map a folder of photos (JPEG, PNG, TIFF) or a video, and write the SITE folder.

    Parameters
    ----------
    photos
        Folder of photos, or a video file.
    site
        SITE folder for the results; an earlier SITE there is replaced.
    reconstructor
        Who finds geometry: NAME, or NAME:VALUE with weights or the folder of a finished reconstruction;
        `excavatwin backbones` lists all. Default: photogrammetry.
    segmenter
        Who tells what pixels are: NAME, or NAME:VALUE. Repeatable: their evidence is merged. Default: appearance.
    remap
        "CLASS=TASK_CLASS": count a class of the segmenter as another task class, or as nothing. Repeatable.
    reference
        A known distance, "PHOTO:x1,y1:x2,y2=METRES": two pixels of a photo and the metres between them. Repeatable.
    config
        TOML file with stage parameters; flags win over it.
    download
        Fetch missing weights from the hub; without it nothing is downloaded unless you say yes when asked.
    fresh
        Forget the finished stages of earlier runs.
    force
        Go on although what the backbones delivered breaks a convention.
    """
    from excavatwin.cli.console import consent, shown_progress
    from excavatwin.cli.summary import say_result
    from excavatwin.survey import map_photos

    plan = read_plan(config, changes, Choice(reconstructor, segmenter, remap))
    with shown_progress() as progress:
        result = map_photos(
            photos,
            site,
            plan=plan,
            references=parse_references(reference),
            progress=progress,
            fresh=fresh,
            consent=consent(download),
            force=force,
        )
    words = [f"--reconstructor {reconstructor}"] if reconstructor else []
    words += [f"--segmenter {one}" for one in segmenter or ()] + [f'--map "{one}"' for one in remap or ()]
    say_result(result, site, " ".join(["excavatwin map", str(photos), "-o", str(site), *words]))


def fuse_command(
    observations: Path,
    /,
    *,
    site: Site,
    reference: Reference = None,
    config: Config = None,
    force: Annotated[bool, Parameter(negative="")] = False,
    class_mapping: str | None = None,
    remap: MapFlag = None,
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
        For labels in another vocabulary: the name of a shipped mapping (a wrong one lists them all; after
        it, ":strict" for that policy instead of "diggable"), or a TOML file of your own.
    remap
        "CLASS=TASK_CLASS": count a class as another task class, or as nothing. Repeatable.
    """
    from excavatwin.cli.console import shown_progress
    from excavatwin.cli.summary import say_result
    from excavatwin.errors import InputError
    from excavatwin.survey import fuse_observations
    from excavatwin.vocabularies import parse_remap

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
            remap=parse_remap(remap or ()),
        )
    say_result(result, site, f"excavatwin fuse {observations} -o {site}")


def parse_references(texts: list[str] | None) -> tuple[Any, ...]:
    """The ``--reference`` flags, parsed."""
    from excavatwin.cli.references import parse_reference

    return tuple(parse_reference(text) for text in texts or ())
