"""Photos by Mitsuba 3 (extra ``sim``): sun, sky, one bounce, real leaves, and the truth of the same triangles."""

from __future__ import annotations

from excavatwin.simulation.photoreal.photo import render, seen_from_above

__all__ = ["render", "seen_from_above"]
