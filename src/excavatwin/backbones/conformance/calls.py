"""Calls of a backbone under watch: whatever it raises, the network it reaches for, the progress it tells."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from excavatwin.backbones import extras, weights
from excavatwin.backbones.cards import Card
from excavatwin.errors import ExcavatwinError
from excavatwin.scene.progress import Progress

T = TypeVar("T")


@dataclass
class Watch:
    """What was seen during all calls of one backbone."""

    progress: Progress
    """Told what the backbone tells."""
    network: list[str] = field(default_factory=list)
    """Addresses that it reached for."""
    steps: list[tuple[str, int, int]] = field(default_factory=list)
    """What it told about its progress."""

    def told(self, what: str) -> Progress:
        """A progress that is noted and passed on."""

        def note(stage: str, done: int, total: int) -> None:
            self.steps.append((stage, done, total))
            self.progress(f"check: {what}", done, total)

        return note

    def call(self, function: Callable[[], T]) -> Result[T]:
        """Call with the network shut."""
        try:
            with _offline(self.network):
                return Result(function())
        except Exception as error:  # whatever it raises is what we want to know
            return Result(None, error)


@dataclass(frozen=True)
class Result(Generic[T]):
    """What a call gave."""

    value: T | None
    error: Exception | None = None

    @property
    def strange(self) -> str:
        """An error that is none of ours, as a clause; else empty."""
        if self.error is None or isinstance(self.error, ExcavatwinError):
            return ""
        return f"raised {type(self.error).__name__}: {first_line(self.error)}"


def first_line(error: BaseException) -> str:
    """What an error says, shortened to its first line."""
    return next((line.strip() for line in str(error).splitlines() if line.strip()), "no message")[:300]


def absent(backbone: Any) -> str:
    """Why the backbone cannot run here, in one sentence; empty when it can."""
    card = getattr(backbone, "card", None)
    if not isinstance(card, Card):
        return "it has no card."
    modules = extras.missing(card)
    if modules:
        return f"{', '.join(modules)} {'are' if len(modules) > 1 else 'is'} not installed; run: {card.install}"
    for field_ in card.weight_fields if card.weights else ():
        wanted = str(getattr(backbone, field_, ""))
        try:
            found = weights.find(card, wanted)
        except ExcavatwinError as error:
            return str(error)
        if found is None:
            one = weights.described(weights.chosen(card, wanted))
            return f"the weights ({one}) are not on this machine; give --{card.name}.{field_} PATH"
    if card.argument and not card.weights and not getattr(backbone, card.argument, ""):
        return f"nothing was given to read; say {card.name}:{card.argument.upper()}"
    return ""


@contextmanager
def _offline(reached: list[str]) -> Iterator[None]:
    """Refuse connections and look-ups of names (not sockets between processes of this machine)."""
    before = {name: getattr(socket, name) for name in ("getaddrinfo", "create_connection")}
    own = {name: vars(socket.socket).get(name) for name in ("connect", "connect_ex")}
    plain = {name: getattr(socket.socket, name) for name in own}

    def refused(address: Any) -> OSError:
        reached.append(str(address))
        return OSError(f"the conformance suite shuts the network; {address} was wanted")

    def shut(name: str) -> Callable[..., Any]:
        def connect(self: socket.socket, address: Any) -> Any:
            if self.family == getattr(socket, "AF_UNIX", None):
                return plain[name](self, address)
            raise refused(address)

        return connect

    def nowhere(address: Any, *_: Any, **__: Any) -> Any:
        raise refused(address)

    for name in own:
        setattr(socket.socket, name, shut(name))
    for name in before:
        setattr(socket, name, nowhere)
    try:
        yield
    finally:
        for name, function in before.items():
            setattr(socket, name, function)
        for name, method in own.items():
            if method is None:
                delattr(socket.socket, name)
            else:
                setattr(socket.socket, name, method)
