"""Observations files: how somebody else's models hand over what they saw, and how our own stages are cached."""

from __future__ import annotations

from excavatwin.exchange.reading import load_observations
from excavatwin.exchange.writing import save_observations

__all__ = ["load_observations", "save_observations"]
