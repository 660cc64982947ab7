"""Real photos through the files that their own reconstruction leaves: nothing real must be lost on the way."""

from __future__ import annotations

import json

import numpy as np
import pytest

from excavatwin.backbones.photogrammetry import Photogrammetry
from excavatwin.backbones.reconstructors.cloud import Cloud
from excavatwin.capture import find_photos
from test_backbones_imports_cloud import write_cloud


@pytest.mark.slow
def test_real_photos_seen_through_the_cloud_of_their_own_map(tmp_path, shared_data):
    """Twelve real drone photos, placed and matched by our photogrammetry; its cloud and cameras, read back as files."""
    photos = find_photos(shared_data / "caliterra_site" / "images")[:12]
    obs = Photogrammetry(lattice=400)(photos)
    assert len(obs.views) >= 8
    shots_ = [view.points[np.isfinite(view.points[..., 0])] for view in obs.views]
    origin = np.zeros(3) if obs.georeference is None else np.array(obs.georeference.origin)
    write_cloud(tmp_path / "cloud.laz", np.concatenate(shots_).astype(float) + origin)
    cameras = []
    for view in obs.views:
        T = view.T_R_cam.copy()
        T[:3, 3] += origin
        lattice = view.lattice
        one = {"name": view.name, "placed": True, "width": lattice.width, "height": lattice.height}
        one |= {"K": lattice.K_photo.tolist(), "distortion": list(lattice.distortion), "T_map_cam": T.tolist()}
        cameras.append(one)
    table = {"conventions": "T_map_cam", "unit": "m", "cameras": cameras}
    (tmp_path / "cameras.json").write_text(json.dumps(table))
    back = Cloud(source=str(tmp_path), lattice=400)(photos)
    shift = np.array(back.source["origin"].split(), float) - origin
    for view in back.views:
        own = obs.view(view.name)
        assert view.shape == own.shape
        both = np.isfinite(view.points[..., 0]) & np.isfinite(own.points[..., 0])
        assert both.sum() > 0.9 * np.isfinite(own.points[..., 0]).sum()
        distance = np.linalg.norm(own.points - own.centre, axis=-1)[both]
        error = np.linalg.norm(view.points + shift - own.points, axis=-1)[both] / distance
        assert np.median(error) < 0.005
        assert np.abs(view.image[both].astype(float) - own.image[both]).mean() < 3
