"""The conformance suite for authors of backbones: is mine wired up right? Their tests are one call of it.

``check_reconstructor(backbone, photos, scratch)`` and ``check_segmenter(backbone, pictures)`` give a ``Report`` of
rows: passed, failed, or not checkable here for a reason. What it cannot see: whether files are written outside the
scratch folder, how long results take, how good they are (``excavatwin check-backbone`` compares with a rendered truth).
"""

from __future__ import annotations

from excavatwin.backbones.conformance.reconstructing import check_reconstructor
from excavatwin.backbones.conformance.report import Outcome, Report, Row
from excavatwin.backbones.conformance.segmenting import check_segmenter

__all__ = ["Outcome", "Report", "Row", "check_reconstructor", "check_segmenter"]
