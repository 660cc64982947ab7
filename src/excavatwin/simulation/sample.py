"""The sample that ships with the project: photos as a drone would have brought them home, and the truth beside them."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from excavatwin.scene.progress import Progress, silent
from excavatwin.simulation.camera import orbit
from excavatwin.simulation.flights import FOCAL_RATIO
from excavatwin.simulation.recording.drone_photo import PLACE, SIGMA, write_photo
from excavatwin.simulation.render import render_view
from excavatwin.simulation.site import DigSite
from excavatwin.simulation.truth import save_truth, site_truth

START = datetime(2025, 5, 20, 10, 0, 0)


def render_sample(out: Path, seed: int = 7, views: int = 14, width: int = 1280, progress: Progress = silent) -> None:
    """Render the sample into ``out``: ``photos/DIG_*.jpg`` and ``truth.npz``.

    Args:
        out: folder, made when it is missing.
        seed: of the site, the flight and the noise.
        views: number of photos on the orbit.
        width: of the photos [px].
    """
    site = DigSite(seed=seed)
    cameras = orbit(views, width=width, focal_ratio=FOCAL_RATIO, seed=seed)
    names = [f"DIG_{number:04d}.jpg" for number in range(1, views + 1)]
    (out / "photos").mkdir(parents=True, exist_ok=True)
    for number, (name, camera) in enumerate(zip(names, cameras, strict=True)):
        image = render_view(site, camera).image
        error = np.random.default_rng((seed, number)).normal(size=3) * np.array([SIGMA[0], SIGMA[0], SIGMA[1]])
        write_photo(out / "photos" / name, image, camera, error, START + timedelta(seconds=5 * number))
        progress("render", number + 1, views)
    save_truth(site_truth(site, list(zip(names, cameras, strict=True)), georeference=PLACE), out / "truth.npz")
