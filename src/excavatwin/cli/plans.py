"""From words to a plan: which backbones, and every parameter by its flag or its line in a TOML file."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from excavatwin.errors import InputError

if TYPE_CHECKING:
    from excavatwin.survey.plan import Plan

ReconstructorFlag = Annotated[str | None, Parameter(name="--reconstructor")]
SegmenterFlag = Annotated[list[str] | None, Parameter(name="--segmenter", negative="")]
MapFlag = Annotated[list[str] | None, Parameter(name="--map", negative="")]


@dataclass(frozen=True)
class Choice:
    """What the flags of a command choose, before parameters."""

    reconstructor: str | None = None
    """``name`` or ``name:value``."""
    segmenters: Sequence[str] | None = None
    remap: Sequence[str] | None = None
    """``"class=task_class"``, for every segmenter that has classes."""


def read_plan(config: Path | None, changes: Mapping[str, Any] | None, choice: Choice | None = None) -> Plan:
    """The default plan, changed by a TOML file, changed by flags.

    Raises:
        InputError: the file cannot be read, no such backbone, or names or values do not fit.
    """
    from excavatwin.cli.flags import merge
    from excavatwin.cli.settings import configure
    from excavatwin.survey.plan import Plan

    choice = choice or Choice()
    table = merge(_read(config), dict(changes or {}))
    names = table.pop("reconstructor", None), table.pop("segmenters", None)
    wanted = names[0] if choice.reconstructor is None else choice.reconstructor
    plan = _with_backbones(Plan(), wanted, choice.segmenters or names[1])
    tables = backbone_tables(plan)
    plain = {field.name for field in fields(Plan)} - {"reconstructor", "segmenters"}
    for name in table:
        if name not in plain and name not in tables:
            raise InputError(_no_table(name, (*plain, *tables)))
    changed = {name: configure(model, table.pop(name, {}), (name,)) for name, model in tables.items()}
    plan = _put_back(configure(plan, table), changed)
    return _remapped(plan, choice.remap) if choice.remap else plan


def backbone_tables(plan: Plan) -> dict[str, Any]:
    """Backbones by the names of their tables of parameters: ``depth_anything_3``, ``mask2former_2``."""
    first = plan.reconstructor.card.name.replace("-", "_")
    return {first: plan.reconstructor} | {name.replace("-", "_"): one for name, one in plan.segmenters.items()}


def to_toml(plan: Plan) -> str:
    """The plan as TOML with the meaning above each parameter; ``read_plan`` of it gives the plan again."""
    from excavatwin.cli.settings import to_toml as rooms_to_toml

    chosen = ", ".join(f'"{one.card.name}"' for one in plan.segmenters.values())
    head = [
        "# Who reconstructs and who segments; `excavatwin backbones` lists all.",
        f'reconstructor = "{plan.reconstructor.card.name}"',
        f"segmenters = [{chosen}]",
    ]
    rooms: dict[str, Any] = {"video": plan.video} | backbone_tables(plan)
    return "\n".join(head) + "\n\n" + rooms_to_toml(rooms | {"merging": plan.merging, "mapper": plan.mapper})


def _read(config: Path | None) -> dict[str, Any]:
    if config is None:
        return {}
    try:
        return tomllib.loads(config.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"--config {config} cannot be read ({error.strerror}).") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"--config {config} is not valid TOML: {error}.") from None


def _with_backbones(plan: Plan, reconstructor: Any, segmenters: Any) -> Plan:
    from excavatwin.backbones import catalogue

    if reconstructor is not None:
        plan = replace(plan, reconstructor=catalogue.make("reconstructor", str(reconstructor)))
    if not segmenters:
        return plan
    words = [segmenters] if isinstance(segmenters, str) else list(segmenters)
    named: dict[str, Any] = {}
    for word in words:
        for text in str(word).split(","):
            model = catalogue.make("segmenter", text.strip())
            again = sum(one.card.name == model.card.name for one in named.values())
            named[f"{model.card.name}-{again + 1}" if again else model.card.name] = model
    return replace(plan, segmenters=named)


def _put_back(plan: Plan, changed: Mapping[str, Any]) -> Plan:
    reconstructor = changed[plan.reconstructor.card.name.replace("-", "_")]
    return replace(
        plan,
        reconstructor=reconstructor,
        segmenters={name: changed[name.replace("-", "_")] for name in plan.segmenters},
    )


def _remapped(plan: Plan, remap: Sequence[str]) -> Plan:
    """Every segmenter that has classes of its own is told what the user maps otherwise."""
    from excavatwin.vocabularies import parse_remap

    wanted = parse_remap(list(remap))
    named: dict[str, Any] = dict(plan.segmenters)
    with_classes = [name for name, one in named.items() if "remap" in {field.name for field in fields(one)}]
    if not with_classes:
        raise InputError(f"--map was given, but {', '.join(named)} has no classes that could be mapped otherwise.")
    changed = {name: replace(named[name], remap=dict(named[name].remap) | wanted) for name in with_classes}
    return replace(plan, segmenters=named | changed)


def _no_table(name: str, known: Sequence[str]) -> str:
    from excavatwin.backbones import catalogue

    for kind, flag in (("reconstructor", "--reconstructor"), ("segmenter", "--segmenter")):
        for one in catalogue.entries(kind):  # type: ignore[arg-type]
            if one.name.replace("-", "_") == name:
                return f"parameters of {kind} {one.name} were given, but it is not used; add {flag} {one.name}."
    import difflib

    near = difflib.get_close_matches(name, known, 1, 0.6)
    hint = f"did you mean {near[0]}?" if near else f"here there are: {', '.join(sorted(known))}."
    return f"there is no parameter {name}; {hint}"
