"""``excavatwin demo``: the sample that ships with the project, against its truth."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from excavatwin.cli.mapping import Changes, Config

if TYPE_CHECKING:
    from collections.abc import Sequence

    from excavatwin.evaluation import Metric


def demo_command(
    *,
    site: Annotated[Path, Parameter(name=["--output", "-o"])] = Path("demo_output"),
    sample: Path | None = None,
    config: Config = None,
    fresh: Annotated[bool, Parameter(negative="")] = False,
    changes: Changes = None,
) -> None:
    """Map the photos that ship with the project and compare with the known truth.

    Parameters
    ----------
    site
        SITE folder for the results.
    sample
        Folder with photos/ and truth.npz; by default the project's own.
    config
        TOML file with stage parameters; flags win over it.
    fresh
        Forget the finished stages of earlier runs.
    """
    from excavatwin.cli.console import say, shown_progress
    from excavatwin.cli.plans import read_plan
    from excavatwin.cli.summary import say_result
    from excavatwin.evaluation import evaluate_site, load_truth
    from excavatwin.survey import map_photos

    plan = read_plan(config, changes)
    sample = sample or find_sample()
    truth = load_truth(sample / "truth.npz")
    with shown_progress() as progress:
        result = map_photos(sample / "photos", site, plan=plan, progress=progress, fresh=fresh)
        progress("compare", 0, 1)
        metrics = evaluate_site(result, truth)
    say("Against the exact truth of this rendered site:", *metric_table(metrics), "")
    say_result(result, site, f"excavatwin map {sample / 'photos'} -o {site}")


def metric_table(metrics: Sequence[Metric]) -> list[str]:
    """One line a metric: name, value with unit, meaning; the figures of one object or of all classes share a line."""
    from excavatwin.cli.console import wrapped

    lines: list[str] = []
    shared: dict[str, list[str]] = {}
    for metric in metrics:
        if metric.name.startswith("elevation_fitted") and metric.name != "elevation_fitted_mae":
            continue  # the same figures once more without shift and tilt: one tells enough here
        if re.search(r"_(selective|aurc|risk_at_95|ece)$", metric.name):
            continue  # for those who study confidence: `excavatwin evaluate` has them
        one_of_many = re.fullmatch(r"(map_iou|photo_iou|object_\d+_\w+?)_(\w+?)(_error)?", metric.name)
        if one_of_many is None:
            lines.append(f"  {metric.name:<36}{_value(metric):>10}  {metric.meaning}".rstrip())
        else:
            family, name, error = one_of_many.groups()
            text = f"{metric.meaning} ({metric.value:+.1f} %)" if error else f"{name} {_value(metric)}"
            shared.setdefault(family, []).append(text)
    for family, texts in shared.items():
        lines += wrapped(f"  {family:<36}", ", ".join(texts), 118)
    return lines


def _value(metric: Metric) -> str:
    unit = "" if metric.unit == "1" else f" {metric.unit}"
    return f"{metric.value:.3g}{unit}" if math.isfinite(metric.value) else "-"


def find_sample() -> Path:
    """The sample of the project: in the current folder, or in the clone that this package is run from.

    Raises:
        InputError: it is in neither (an installed package does not carry it).
    """
    from excavatwin.errors import InputError

    for root in (Path.cwd(), Path(__file__).parents[3]):
        if (root / "sample" / "truth.npz").is_file():
            return root / "sample"
    raise InputError(
        "the sample photos are not here; run `make demo` in a clone of the project, or give --sample FOLDER."
    )
