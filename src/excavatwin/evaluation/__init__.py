"""Evaluation: a map against the truth of its site. One file per kind of figure; a metric is a name, a value, a unit."""

from __future__ import annotations

from excavatwin.evaluation.alignment import Alignment, align
from excavatwin.evaluation.bootstrap import Interval, bootstrap, mean_interval, over_sequences, paired_difference
from excavatwin.evaluation.metric import Metric
from excavatwin.evaluation.reference import load_elevation
from excavatwin.evaluation.semantics import semantic_scores
from excavatwin.evaluation.site import evaluate_site
from excavatwin.evaluation.truth_file import load_truth

__all__ = [
    "Alignment",
    "Interval",
    "Metric",
    "align",
    "bootstrap",
    "evaluate_site",
    "load_elevation",
    "load_truth",
    "mean_interval",
    "over_sequences",
    "paired_difference",
    "semantic_scores",
]
