"""Photos by Mitsuba 3 (extra ``sim``): sun, sky, one bounce, real leaves, and the truth of the same triangles."""

from __future__ import annotations

from excavatwin.simulation.photoreal.photo import render

__all__ = ["render"]
