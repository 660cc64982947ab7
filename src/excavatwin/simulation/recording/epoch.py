"""One epoch on disk: photos, their truth, the site's truth, and a laser scan."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from excavatwin import __version__
from excavatwin.scene.progress import Progress, silent
from excavatwin.scene.staging import whole_folder
from excavatwin.simulation.camera import Camera
from excavatwin.simulation.flights import FLIGHTS
from excavatwin.simulation.recording.drone_photo import PLACE, write_photo
from excavatwin.simulation.recording.formats import depth_tiff, elevation_tiff, laz, png
from excavatwin.simulation.recording.laser_scan import Scanner, elevation
from excavatwin.simulation.recording.shoot import Shoot
from excavatwin.simulation.render import RenderedView
from excavatwin.simulation.site import DigSite, contents
from excavatwin.simulation.truth import save_truth

MARK = "cameras.json"
"""File that every epoch holds."""
PARTS = ("images", "labels", "instances", "depth")
BETWEEN = 5.0
"""From photo to photo [s]."""


def record_epoch(
    folder: Path, site: DigSite, shoot: Shoot, number: int, start: datetime, progress: Progress = silent
) -> bool:
    """Write one epoch, unless a finished one of the same plan is there.

    Args:
        folder: ``epoch_NN``; it appears when it is complete.
        number: of the epoch.
        start: time of the first photo.

    Returns:
        Whether anything was done.

    Raises:
        OutputError: the folder holds something else, or cannot be written.
        MissingExtraError: the renderer is not installed.
    """
    plan = plan_of(site, shoot, number)
    stage = f"epoch {number:02d}"
    if written_plan(folder) == plan:
        progress(stage, shoot.views, shoot.views)
        return False
    progress(stage, 0, shoot.views)
    for leftover in folder.parent.glob(f".{folder.name}.*.part"):  # of a run that was killed
        shutil.rmtree(leftover, ignore_errors=True)
    cameras = FLIGHTS[shoot.flight](shoot.views, shoot.width, (site.seed * 101 + number) % 2**32)
    renderer = shoot.take_photos()
    with whole_folder(folder, MARK, stale=lambda name: name in PARTS or "." in name) as staged:
        for part in PARTS:
            (staged / part).mkdir()
        frames = []
        for index, camera in enumerate(cameras):
            name, seconds = f"{index:06d}.jpg", BETWEEN * index
            view = renderer(site, camera)
            error = np.random.default_rng((site.seed, number, index)).normal(size=3)
            error *= np.array([shoot.position_error[0], shoot.position_error[0], shoot.position_error[1]])
            time = start + timedelta(seconds=seconds)
            write_photo(staged / "images" / name, view.image, camera, error, time, shoot.position_error, "simulation")
            _write_truth(staged, name, view)
            frames.append(_frame(name, camera, seconds))
            progress(stage, index + 1, len(cameras))
        named = [(str(frame["name"]), camera) for frame, camera in zip(frames, cameras, strict=True)]
        save_truth(renderer.truth(site, named, PLACE), staged / "truth.npz")
        _write_scan(staged, site, number)
        _write_json(staged / "objects.json", objects_of(site))
        _write_json(staged / MARK, {"frames": frames, "plan": plan})
    return True


def plan_of(site: DigSite, shoot: Shoot, number: int) -> Mapping[str, Any]:
    """What an epoch depends on; a finished epoch of the same plan is not made again."""
    told = {**shoot.asdict(), "seed": site.seed, "epoch": number, "excavatwin": __version__}
    plan: Mapping[str, Any] = json.loads(json.dumps(told))
    return plan


def written_plan(folder: Path) -> Any:
    """The plan of a finished epoch; None where there is none."""
    try:
        return json.loads((folder / MARK).read_text("utf-8")).get("plan")
    except (OSError, ValueError, AttributeError):
        return None


def objects_of(site: DigSite) -> list[dict[str, Any]]:
    """The objects with their exact boxes, lengths in metres in frame M, yaw in degrees."""
    return [
        {
            "object_id": thing.object_id,
            "name": place.name,
            "category": place.category,
            "task_class": int(thing.task_class),
            "size": list(thing.size),
            "centre": list(thing.centre),
            "yaw": thing.yaw,
            "z_base": thing.z_base,
            "z_top": thing.z_top,
        }
        for thing, place in zip(contents(site).objects, site.placements, strict=True)
    ]


def _frame(name: str, camera: Camera, seconds: float) -> dict[str, Any]:
    return {
        "name": name,
        "width": camera.width,
        "height": camera.height,
        "K": camera.K_cam.tolist(),
        "T_map_cam": camera.T_M_cam.tolist(),
        "time_s": seconds,
    }


def _write_truth(folder: Path, name: str, view: RenderedView) -> None:
    stem = Path(name).stem
    (folder / "labels" / f"{stem}.png").write_bytes(png(view.label))
    (folder / "instances" / f"{stem}.png").write_bytes(png(view.instance))
    (folder / "depth" / f"{stem}.tif").write_bytes(depth_tiff(view.depth))


def _write_scan(folder: Path, site: DigSite, number: int) -> None:
    scan = Scanner()(site, seed=site.seed * 101 + number)
    grid, height = elevation(scan, site.extent)
    (folder / "elevation.tif").write_bytes(elevation_tiff(grid, height, PLACE))
    (folder / "lidar.laz").write_bytes(laz(scan, PLACE))


def _write_json(path: Path, content: Any) -> None:
    path.write_text(json.dumps(content, indent=1) + "\n", "utf-8")
