"""Both keep every promise that backbones make: the conformance suite says so."""

from __future__ import annotations

import json

import numpy as np
from excavatwin_plugin.greenness import Greenness
from excavatwin_plugin.posed_depth import PosedDepth
from PIL import Image

from excavatwin.backbones.conformance import check_reconstructor, check_segmenter
from excavatwin.backbones.protocols import Picture
from excavatwin.capture import find_photos

SHAPE = (90, 120)


def card(seed: int) -> np.ndarray:
    """A meadow with brown patches."""
    rng = np.random.default_rng(seed)
    patches = np.kron(rng.random((9, 12)) > 0.5, np.ones((10, 10), bool))[..., None]
    return np.clip(np.where(patches, (90, 150, 60), (130, 100, 70)) + rng.normal(0, 5, (*SHAPE, 3)), 0, 255).astype(
        "u1"
    )


def test_greenness():
    report = check_segmenter(Greenness(), [Picture(card(seed), f"{seed}.png") for seed in range(3)])
    assert not report.failed, str(report)


def test_posed_depth(tmp_path):
    """Cameras 10 m above a plain, each a metre further on."""
    (tmp_path / "photos").mkdir()
    H, W = SHAPE
    world = np.kron(np.random.default_rng(0).integers(40, 220, (40, 60, 3)), np.ones((6, 6, 1))).astype(np.uint8)
    cameras = {}
    for number in range(4):
        name = f"{number}.png"
        Image.fromarray(world[60 : 60 + H, 60 + 12 * number : 60 + 12 * number + W]).save(tmp_path / "photos" / name)
        np.save(tmp_path / f"{number}.npy", np.full(SHAPE, 10.0))
        T = np.diag([1.0, -1.0, -1.0, 1.0])  # looks down
        T[:3, 3] = number * 1.0, 0, 10
        K = [[120.0, 0, W / 2], [0, 120.0, H / 2], [0, 0, 1]]
        cameras[name] = {"T_world_cam": T.tolist(), "K": K}
    (tmp_path / "poses.json").write_text(json.dumps(cameras))
    photos = find_photos(tmp_path / "photos")
    report = check_reconstructor(PosedDepth(source=str(tmp_path)), photos, tmp_path / "scratch")
    assert not report.failed, str(report)
