"""One SITE folder against what is true: how it is scored, and the scores of ``excavatwin evaluate SITE``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from excavatwin.errors import InputError
from excavatwin.evaluation.alignment import Alignment, align
from excavatwin.evaluation.elevation import elevation_metrics
from excavatwin.evaluation.metric import Metric
from excavatwin.evaluation.reference import in_frame_of, load_elevation
from excavatwin.evaluation.scores import Row, Scores
from excavatwin.evaluation.semantics import TASK_POLICY, map_curve
from excavatwin.evaluation.site import read_site, score
from excavatwin.evaluation.truth_file import load_truth
from excavatwin.scene.truth import Truth

RASTERS = (".tif", ".tiff")


@dataclass(frozen=True)
class Scoring:
    """How sites are scored."""

    way: str = "auto"
    """How map and truth come into one frame, see ``evaluation.align``."""
    reference: str = "truth"
    """``truth``: exact heights; ``lidar``: those of ``elevation.tif``."""
    policy: str | None = None
    """Class mapping of data sets with their own classes; by default their first."""
    segmenter: str = "mask2former"
    """Whose row of the paper's semantic table stands beside ours."""
    seed: int = 0
    """Of the bootstrap."""

    def settings(self, policy: str) -> dict[str, str]:
        """What a reader must know, for the head of the table."""
        return {"policy": policy, "alignment": self.way, "elevation against": self.reference, "seed": str(self.seed)}


def evaluate_site_folder(site: Path, truth: Path, scoring: Scoring) -> Scores:
    """Every figure of a SITE against a truth file.

    Args:
        truth: ``truth.npz`` (with ``elevation.tif`` beside it for ``reference="lidar"``), or a GeoTIFF of terrain
            heights, against which only the elevation is scored.

    Raises:
        InputError: one of them cannot be read, or they cannot be brought into one frame.
    """
    try:
        m, views = read_site(site)
    except OSError as error:
        raise InputError(f"{site} is damaged ({error}); map it again.") from error
    settings = scoring.settings(TASK_POLICY) | {"truth": str(truth)}
    if truth.suffix.lower() in RASTERS:
        heights = load_elevation(truth)
        metrics = elevation_metrics(m, heights, align(m, views, heights, scoring.way))
        return Scores(str(site), settings, (Row(site.name, "", metrics),))
    known = load_truth(truth)
    alignment = align(m, views, known, scoring.way)
    elevation = lidar_beside(truth, known) if scoring.reference == "lidar" else None
    metrics = score(m, views, known, alignment, elevation)
    curve = map_curve(m, known, alignment).thinned()
    return Scores(str(site), settings, (Row(site.name, "", metrics, curve=curve),), notes=doubts(metrics, alignment))


def lidar_beside(truth_file: Path, truth: Truth) -> Truth:
    """``elevation.tif`` beside a truth file, in the truth's frame.

    Raises:
        InputError: there is none.
    """
    path = truth_file.with_name("elevation.tif")
    if not path.is_file():
        raise InputError(f"{truth_file.parent} holds no elevation.tif; --reference lidar needs one beside the truth.")
    return in_frame_of(load_elevation(path), truth)


def doubts(metrics: tuple[Metric, ...], alignment: Alignment) -> tuple[str, ...]:
    """What makes the figures of a site less than they seem."""
    values = {metric.name: metric.value for metric in metrics}
    told = []
    bias, fitted = abs(values.get("elevation_bias", 0.0)), values.get("elevation_fitted_mae", float("inf"))
    if alignment.way == "declared" and bias > 3 * fitted:
        told.append(
            f"the map lies {bias:.2f} m off as a whole: GPS decides that, and elevation_fitted_* leaves it out."
        )
    return tuple(told)
