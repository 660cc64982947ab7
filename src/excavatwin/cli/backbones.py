"""``excavatwin backbones``: who can reconstruct and segment here, on which terms, and what to type next."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from excavatwin.backbones.cards import Tried

if TYPE_CHECKING:
    from excavatwin.survey.backbone_states import BackboneState


def backbones_command(name: str | None = None, /, *, json: Annotated[bool, Parameter(negative="")] = False) -> None:
    """Reconstructors and segmenters: installed, weights, licence, metric, memory, what to type next.

    Parameters
    ----------
    name
        Everything about this one: all its weights, its terms, how far it was tried.
    json
        The same for programs.
    """
    from excavatwin.cli.console import say
    from excavatwin.survey import backbone_states as rooms

    if name is not None:
        row = rooms.state_of(rooms.find_entry(name))
        say(*(_as_json([row]) if json else _details(row)))
        return
    rows = {kind: list(rooms.states(kind)) for kind in ("reconstructor", "segmenter")}
    if json:
        say(*_as_json([row for kind in rows.values() for row in kind]))
        return
    say(*_table("Reconstructors", rows["reconstructor"]), "", *_table("Segmenters", rows["segmenter"]), "", *_legend())


def _table(title: str, rows: list[BackboneState]) -> list[str]:
    lines = [f"{title:<19}{'state':<17}{'weights':<10}{'metric':<8}{'memory':<12}terms"]
    for row in rows:
        card = row.card
        weights = _gigabytes(card.weights[0].size) if card.weights else "none"
        memory = "-" if row.memory is None else "-".join(f"{n / 1e9:.0f}" for n in row.memory) + " GB"
        notes = [" !"] if row.restricted else []
        notes += [f" ({card.tried})"] if card.tried == Tried.STAND_IN else []
        notes += [f" (from package {row.package})"] if row.package != "excavatwin" else []
        columns = f"{card.name:<17}{row.state:<17}{weights:<10}{row.metric or '-':<8}{memory:<12}"
        lines += [f"  {columns}{row.terms}{''.join(notes)}", f"      {row.next}"]
    return lines


def _legend() -> list[str]:
    return [
        "memory: estimated peak for 10 and for 50 photos at once; long sequences are cut into chunks that fit.",
        '!: code or weights restrict commercial use.  metric "no": scale comes from GPS or from --reference.',
        "More about one: excavatwin backbones NAME · is it wired up right: excavatwin check-backbone NAME",
    ]


def _details(row: BackboneState) -> list[str]:
    from excavatwin.survey.backbone_states import sets
    from excavatwin.survey.readiness import restrictions

    card = row.card
    lines = [f"{card.name}: {card.summary}", ""]
    facts = [
        ("kind", card.kind),
        ("state", row.state + (f": {', '.join(row.missing)}" if row.missing else "")),
        ("tried", str(card.tried)),
        ("code", card.licence),
        ("metric", row.metric or "-"),
        ("source", card.source or "-"),
        ("package", row.package),
    ]
    if row.memory is not None:
        facts.append(("memory", f"about {row.memory[0] / 1e9:.1f} GB for 10 photos, {row.memory[1] / 1e9:.1f} for 50"))
    lines += [f"  {name:<9}{value}" for name, value in facts]
    if card.weights:
        lines += ["", "  weights (the first is the default):"]
    for one, here in sets(card):
        more = [
            _gigabytes(one.size),
            one.licence,
            *(["metric"] if one.metric else []),
            *(["gated"] if one.gated else []),
        ]
        lines.append(f"    {'on this machine' if here else 'not here':<17}{one.repo}  ({', '.join(more)})")
    terms = restrictions(card)
    lines += ["", *(f"  ! {sentence}" for sentence in terms)] if terms else []
    return [*lines, "", "next:", f"  {row.next}", f"  excavatwin config --{card.kind} {card.name}   # its parameters"]


def _as_json(rows: list[BackboneState]) -> list[str]:
    import json
    from dataclasses import asdict

    plain: list[dict[str, Any]] = []
    for row in rows:
        facts = asdict(row) | {"state": row.state, "terms": row.terms, "metric": row.metric, "next": row.next}
        for one in facts["card"]["weights"]:
            one["size"] = None if one["size"] != one["size"] else one["size"]
        plain.append(facts)
    return [json.dumps(plain, indent=2)]


def _gigabytes(size: float) -> str:
    return "size ?" if size != size else f"{size / 1e9:.1f} GB"
