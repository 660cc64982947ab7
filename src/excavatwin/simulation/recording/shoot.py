"""What is recorded at a site: which flight, how often, with which renderer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from excavatwin.errors import InputError, require
from excavatwin.simulation.conditions import Conditions
from excavatwin.simulation.flights import FLIGHTS
from excavatwin.simulation.recording.drone_photo import SIGMA
from excavatwin.simulation.renderers import RENDERERS, Renderer

EPOCHS = 100
"""An epoch's number has two digits."""


@dataclass(frozen=True)
class Shoot:
    """One recording: every epoch of a sequence is flown anew."""

    flight: str = "orbit"
    """``"orbit"``, ``"lawnmower"`` or ``"hover"``."""
    views: int = 16
    """Photos of an epoch."""
    width: int = 640
    """Of the photos, which are 4:3 [px]."""
    epochs: int = 1
    """States of the site, between which the digging goes on."""
    renderer: str = "fast"
    """``"fast"`` (our own tracer) or ``"photoreal"`` (Mitsuba)."""
    samples: int | None = None
    """Of the renderer; None is the renderer's own default."""
    conditions: Conditions = field(default_factory=Conditions)
    position_error: tuple[float, float] = SIGMA
    """Standard deviation of the positions in the photos' EXIF, horizontal and vertical [m]."""

    def __post_init__(self) -> None:
        for name, known in (("flight", FLIGHTS), ("renderer", RENDERERS)):
            if getattr(self, name) not in known:
                raise InputError(f"the {name} is {getattr(self, name)!r}; it can be {' or '.join(map(repr, known))}.")
        require(self, "views", 2, 9999)
        require(self, "width", 32, 8192)
        require(self, "epochs", 1, EPOCHS)

    def take_photos(self) -> Renderer:
        """The renderer with its conditions."""
        kind = RENDERERS[self.renderer]
        if self.samples is None:
            return kind(conditions=self.conditions)
        return kind(self.samples, self.conditions)

    def asdict(self) -> Mapping[str, Any]:
        """As JSON takes it."""
        return {**asdict(self), "position_error": list(self.position_error)}
