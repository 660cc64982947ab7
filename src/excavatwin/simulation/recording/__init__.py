"""Recordings of simulated sites in the OCES-like layout (docs/oces-layout.md): photos, and the truth of everything."""

from __future__ import annotations

from excavatwin.simulation.recording.laser_scan import Scan, Scanner, elevation
from excavatwin.simulation.recording.sequence import record_dataset, record_sequence, sequence_name
from excavatwin.simulation.recording.shoot import Shoot

__all__ = ["Scan", "Scanner", "Shoot", "elevation", "record_dataset", "record_sequence", "sequence_name"]
