"""A wrong convention can look plausible in a map, but it cannot reproject: each one is found by name."""

from __future__ import annotations

import numpy as np
import pytest

from excavatwin.errors import ObservationError
from excavatwin.exchange import load_observations
from site_example import example_observations
from test_exchange_roundtrip import plain

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
CAUSES = {
    "inverted": (lambda a: a.update(T_world_cam=np.linalg.inv(a["T_world_cam"])), "world-to-camera; .*invert it"),
    "opengl": (lambda a: a.update(T_world_cam=a["T_world_cam"] @ FLIP), "OpenGL's"),
    "inverted opengl": (
        lambda a: a.update(T_world_cam=np.linalg.inv(a["T_world_cam"] @ FLIP)),
        "world-to-camera with OpenGL axes",
    ),
    "transposed rotation": (
        lambda a: a["T_world_cam"].__setitem__(
            (slice(None), slice(0, 3), slice(0, 3)), a["T_world_cam"][:, :3, :3].transpose(0, 2, 1).copy()
        ),
        "rotation is transposed",
    ),
    "camera points": (
        lambda a: a.update(
            points=np.stack([(p - T[:3, 3]) @ T[:3, :3] for p, T in zip(a["points"], a["T_world_cam"], strict=True)])
        ),
        "points are in camera coordinates",
    ),
    "half-size K": (lambda a: a.update(K=a["K"] * [[0.5], [0.5], [1]]), "image 0.5 times as large"),
    "double-size K": (lambda a: a.update(K=a["K"] * [[2.0], [2], [1]]), "image 2 times as large"),
    "cropped K": (lambda a: a["K"].__setitem__((slice(None), 1, 2), 32.0), "K does not belong to this lattice"),
    "shuffled views": (lambda a: a.update(T_world_cam=a["T_world_cam"][::-1]), "no usual mistake"),
}


@pytest.fixture(scope="module")
def contract():
    return plain(example_observations())


def stored(contract, change, tmp_path, **more):
    arrays = {key: array.copy() for key, array in contract.items()}
    change(arrays)
    np.savez(tmp_path / "a.npz", **arrays, **more)
    return tmp_path / "a.npz"


@pytest.mark.parametrize("name", CAUSES)
def test_gross_mistakes_are_refused_by_name(name, contract, tmp_path):
    change, cause = CAUSES[name]
    path = stored(contract, change, tmp_path)
    with pytest.raises(ObservationError, match=rf"view 0 .*more than 2% of the image width; .*{cause}.*force"):
        load_observations(path)
    (doubt,) = load_observations(path, force=True).doubts
    assert "of 2 views miss their own pixels; worst is view" in doubt


def test_square_images_may_be_transposed(tmp_path):
    arrays = plain(example_observations(shape=(50, 50)))
    np.savez(tmp_path / "a.npz", **{**arrays, "points": arrays["points"].transpose(0, 2, 1, 3)} | _flipped(arrays))
    with pytest.raises(ObservationError, match="rows and columns are swapped"):
        load_observations(tmp_path / "a.npz")


def _flipped(arrays):
    return {key: arrays[key].swapaxes(1, 2) for key in ("confidence", "evidence")}


def test_a_small_miss_is_reported_with_its_size(contract, tmp_path):
    def change(arrays):
        arrays["K"][1, 0, 2] += 1.1

    loaded = load_observations(stored(contract, change, tmp_path, names=["a", "b"]))
    assert loaded.doubts[0].startswith("The points of 1 of 2 views miss their own pixels; worst is view 1 ('b'): its")
    assert "median of 1.1 px (width 60)" in loaded.doubts[0]


def test_half_a_pixel_is_noticed(contract, tmp_path):
    def change(arrays):
        arrays["K"][:, :2, 2] -= 0.5

    (doubt,) = load_observations(stored(contract, change, tmp_path)).doubts
    assert "median of 0.7 px" in doubt
    assert "add 0.5 to cx and cy" in doubt


def test_right_observations_raise_no_doubt(contract, tmp_path):
    assert load_observations(stored(contract, lambda a: None, tmp_path)).doubts == ()
