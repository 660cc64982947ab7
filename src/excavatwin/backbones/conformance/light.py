"""What can be checked without running a backbone: its card, its parameters, its identity, what its import costs."""

from __future__ import annotations

import math
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from functools import lru_cache
from typing import Any

from excavatwin.backbones.cards import Card
from excavatwin.backbones.conformance.calls import first_line
from excavatwin.backbones.conformance.report import Row, failed, judged, passed, unchecked
from excavatwin.backbones.parameters import meanings_of
from excavatwin.errors import ExcavatwinError

HEAVY = ("torch", "transformers", "tensorflow", "jax", "onnxruntime", "ultralytics")
_NAME = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")


def light_rows(backbone: Any, kind: str) -> tuple[Row, ...]:
    """The rows that need neither libraries nor weights.

    Args:
        backbone: any object; what it lacks becomes a failed row.
        kind: ``reconstructor`` or ``segmenter``, what it should be.
    """
    return (
        judged("card", _card_mistakes(backbone, kind)),
        _frozen(backbone),
        _documented(type(backbone)),
        _identity(backbone),
        _import(type(backbone)),
    )


def name_of(backbone: Any) -> str:
    """Name on the card, or of the class when it has none."""
    card = getattr(backbone, "card", None)
    return card.name if isinstance(card, Card) else type(backbone).__name__


def _card_mistakes(backbone: Any, kind: str) -> Iterator[str]:
    card = getattr(backbone, "card", None)
    if not isinstance(card, Card):
        yield f"{type(backbone).__name__} has no card; give the class card: ClassVar[Card] = Card(...)"
        return
    if not _NAME.fullmatch(card.name):
        yield f"the name {card.name!r} cannot be typed easily; use small letters, digits and single hyphens"
    if card.kind != kind:
        yield f"the card says {card.kind}, but it is checked as a {kind}"
    if not card.summary.strip() or "\n" in card.summary:
        yield "the summary must be one line that says what it is, and from whom"
    if not card.licence.strip():
        yield "the licence of the code is not told; give its SPDX name"
    if card.modules and not card.install.strip():
        yield f"it needs {', '.join(card.modules)} but gives no line that installs them; fill card.install"
    known = {field.name for field in fields(backbone)} if is_dataclass(backbone) else set()
    for name in (card.argument, *(card.weight_fields if card.weights else ())):
        if name and name not in known:
            yield f"the card names a field {name}, which the class does not have"
    for one in card.weights:
        if not re.fullmatch(r"[^/\s]+/[^/\s]+", one.repo):
            yield f"weights {one.repo!r} are no name on the hub; expected owner/name"
        if not one.licence.strip():
            yield f"the licence of the weights {one.repo} is not told"
        if not (math.isnan(one.size) or one.size > 1e4):
            yield f"the weights {one.repo} are said to take {one.size:g} bytes; give bytes, or NaN when unknown"


def _frozen(backbone: Any) -> Row:
    cls = type(backbone)
    if not is_dataclass(cls):
        return failed("frozen dataclass", f"{cls.__name__} is no dataclass; decorate it with @dataclass(frozen=True).")
    if not cls.__dataclass_params__.frozen:  # type: ignore[attr-defined]
        sentence = f"{cls.__name__} can be changed after it is made; decorate it with @dataclass(frozen=True)."
        return failed("frozen dataclass", sentence)
    return passed("frozen dataclass")


def _documented(cls: type[Any]) -> Row:
    name = "parameters documented"
    if not is_dataclass(cls):
        return unchecked(name, "it is no dataclass.")
    documented: set[str] = set()
    for one in cls.__mro__:
        try:
            if is_dataclass(one):
                documented |= {field for field, text in meanings_of(one).items() if text}
        except (OSError, TypeError, SyntaxError):
            return unchecked(name, f"the source of {one.__name__} cannot be read.")
    bare = [field.name for field in fields(cls) if field.init and field.name not in documented]
    if bare:
        return failed(name, f"{', '.join(bare)}: no docstring below; `excavatwin config` prints meaning and unit.")
    return passed(name)


def _identity(backbone: Any) -> Row:
    name = "identity"
    try:
        told = [backbone.identity(), backbone.identity()]
        if is_dataclass(type(backbone)):
            told.append(replace(backbone).identity())
    except ExcavatwinError as error:
        return unchecked(name, str(error))
    except Exception as error:
        return failed(name, f"identity() raised {type(error).__name__}: {first_line(error)}.")
    if not isinstance(told[0], str) or not told[0].strip():
        return failed(name, f"identity() is {told[0]!r}; expected words such as versions and the revision of weights.")
    if len(set(told)) > 1:
        sentence = f"identity() changes from {told[0]!r} to {next(one for one in told if one != told[0])!r}"
        return failed(name, f"{sentence} though nothing else did; leave out times, addresses and random numbers.")
    return passed(name, told[0] if len(told[0]) <= 70 else f"{told[0][:67]}...")


def _import(cls: type[Any]) -> Row:
    name = "light import"
    if cls.__module__ == "__main__":
        return unchecked(name, "the class is defined in a script.")
    heavy, error = _imported(cls.__module__)
    if error:
        return unchecked(name, f"{cls.__module__} cannot be imported by itself ({error}).")
    if heavy:
        sentence = f"importing {cls.__module__} imports {', '.join(heavy)}; import them inside the calls."
        return failed(name, sentence)
    return passed(name)


@lru_cache
def _imported(module: str) -> tuple[tuple[str, ...], str]:
    """Heavy libraries that the import of a module brings, or why it cannot be imported; in a process of its own."""
    code = f"import sys, {module}; print('heavy:', *[name for name in {HEAVY!r} if name in sys.modules])"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=False)
    if done.returncode:
        return (), (done.stderr.strip().splitlines() or ["no message"])[-1]
    lines = [line for line in done.stdout.splitlines() if line.startswith("heavy:")]
    return tuple(lines[-1].split()[1:]), ""
