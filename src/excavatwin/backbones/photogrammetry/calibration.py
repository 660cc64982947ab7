"""What the photos can tell about the lens, and a final adjustment that refines no more than that.

The ground under nadir photos looks the same through any focal length if it is only stretched in height: a focal length
that is refined there moves the ground by metres at an unchanged residual. So the adjustment is asked, not trusted: all
focal lengths are scaled by ``PROBE`` and everything else is adjusted again. Where the squared residual hardly rises
(measured: 0.2 to 1.4 % on nadir sets, 50 to 60 % on oblique ones), the focal length stays as the file gave it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pycolmap

PROBE = 0.05
"""Relative change of the focal length that is tried in both directions."""
LEAST_RISE = 0.10
"""Rise of the squared residual under the probe from which a focal length counts as observed."""
LEAST_GAIN = 0.03
"""Drop of the squared residual that justifies another distortion coefficient."""
USUAL_FOCAL = 0.75
"""Focal length over the photo's longer side when nothing is known: 27 mm in 35 mm terms, usual for drones."""


@dataclass(frozen=True)
class Calibration:
    """How the lens model was found."""

    focal_refined: bool
    coefficients: int
    """Radial distortion coefficients that were refined (0, 1 or 2)."""
    rise: float
    """Relative rise of the squared residual when the focal length is changed by ``PROBE``."""
    change: float
    """Largest relative change of a focal length against its prior."""

    def sentence(self, known: bool) -> str:
        """What was held, what was refined, and why."""
        seen = f"a change of {PROBE:.0%} raises the squared residual by {self.rise:.1%}"
        focal = (
            f"focal length refined by {self.change:+.1%} ({seen})"
            if self.focal_refined
            else f"focal length held at {'its prior' if known else 'a usual value'}, the views cannot tell it ({seen})"
        )
        lens = ("no distortion needed", "k1 refined", "k1 and k2 refined")[self.coefficients]
        return f"{focal}; {lens}"


def adjust(model: pycolmap.Reconstruction, focal: bool, distortion: bool) -> float:
    """Bundle adjustment in place, in one thread so that it repeats to the last bit.

    Returns:
        The sum of squared reprojection errors that remains [px² of the shrunk photos].
    """
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_focal_length = focal
    options.refine_extra_params = distortion
    options.print_summary = False
    options.ceres.solver_options.num_threads = 1
    options.ceres.solver_options.max_num_iterations = 50
    everything = pycolmap.BundleAdjustmentConfig()
    for image_id in sorted(model.reg_image_ids()):
        everything.add_image(image_id)
    everything.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    summary: Any = pycolmap.create_default_bundle_adjuster(options, everything, model).solve()
    return 2 * float(summary.ceres_summary.final_cost)


def set_lenses(
    model: pycolmap.Reconstruction, focal: dict[int, float] | float = 1.0, coefficients: int | None = None
) -> pycolmap.Reconstruction:
    """A copy with other focal lengths (per camera, or a factor) and so many radial terms (new ones are 0)."""
    copy = pycolmap.Reconstruction(model)
    for camera_id, camera in copy.cameras.items():
        f, cx, cy, *radial = camera.params
        f = focal[camera_id] if isinstance(focal, dict) else f * focal
        n = len(radial) if coefficients is None else coefficients
        radial = [*radial, 0.0, 0.0][:n] or [0.0]
        camera.model = pycolmap.CameraModelId.SIMPLE_RADIAL if len(radial) == 1 else pycolmap.CameraModelId.RADIAL
        camera.params = [f, cx, cy, *radial]
    return copy


def calibrate(model: pycolmap.Reconstruction, prior: dict[int, float]) -> tuple[pycolmap.Reconstruction, Calibration]:
    """The model adjusted with as much of the lens free as the photos observe.

    Args:
        model: structure from motion with one camera per lens, SIMPLE_RADIAL [px of the shrunk photos].
        prior: focal length of each camera that the file or a usual value gives [px of the shrunk photos].
    """
    free = set_lenses(model)
    least = adjust(free, focal=True, distortion=True)
    probes = [adjust(set_lenses(free, factor), False, True) for factor in (1 - PROBE, 1 + PROBE)]
    rise = float(np.mean(probes)) / max(least, 1e-12) - 1
    plausible = all(
        0.3 < camera.focal_length / max(camera.width, camera.height) < 5 for camera in free.cameras.values()
    )
    refined = rise > LEAST_RISE and plausible
    if refined:
        best, fit, coefficients = free, least, 1
        longer = set_lenses(free, coefficients=2)
        longer_fit = adjust(longer, focal=True, distortion=True)
        if longer_fit < (1 - LEAST_GAIN) * fit:
            best, fit, coefficients = longer, longer_fit, 2
    else:
        best, coefficients = set_lenses(model, prior), 1
        fit = adjust(best, focal=False, distortion=True)
    simpler = set_lenses(best, coefficients=0)
    if coefficients == 1 and adjust(simpler, refined, False) < (1 + LEAST_GAIN) * fit:
        best, coefficients = simpler, 0
    changes = [camera.focal_length / prior[camera_id] - 1 for camera_id, camera in best.cameras.items()]
    return best, Calibration(refined, coefficients, rise, max(changes, key=abs, default=0.0))
