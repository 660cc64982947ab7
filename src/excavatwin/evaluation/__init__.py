"""Evaluation: a map against the truth of its site. One file per kind of figure; a metric is a name, a value, a unit."""

from __future__ import annotations

from excavatwin.evaluation.metric import Metric
from excavatwin.evaluation.site import evaluate_site
from excavatwin.evaluation.truth_file import load_truth

__all__ = ["Metric", "evaluate_site", "load_truth"]
