"""What the reconstruction networks' adapters share and needs no torch: cameras, points, files, memory."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from excavatwin.backbones.catalogue import entry
from excavatwin.backbones.reconstructors.depth_anything_3 import DepthAnything3
from excavatwin.backbones.reconstructors.loading import build, checkpoint, settings
from excavatwin.backbones.reconstructors.unprojection import (
    camera_to_world,
    centred,
    fitted_intrinsics,
    rigid,
    world_points,
)
from excavatwin.errors import InputError
from excavatwin.scene.frames import invert_rigid, project
from excavatwin.simulation import look_at

NETWORKS = ("vggt", "depth-anything-3", "map-anything", "pi3", "mast3r", "dust3r")
NESTED = "depth-anything/DA3NESTED-GIANT-LARGE-1.1"
K = np.array([[[90.0, 0, 33.5], [0, 95.0, 20.5], [0, 0, 1]], [[70.0, 0, 30.0], [0, 70.0, 24.0], [0, 0, 1]]])
T = np.stack([look_at(np.array([3.0, -7.0, 5.0]), np.zeros(3)), look_at(np.array([-4.0, 6.0, 8.0]), np.ones(3), 0.3)])


def test_points_fall_on_their_own_pixels():
    rng = np.random.default_rng(1)
    depth = rng.uniform(2, 9, (2, 40, 60)).astype(np.float32)
    points = world_points(depth, K, T)
    for s in range(2):
        uv, z = project(K[s], T[s], points[s])
        v, u = np.mgrid[:40, :60] + 0.5
        assert np.abs(uv - np.stack([u, v], axis=-1)).max() < 1e-3
        assert np.abs(z - depth[s]).max() < 1e-4


def test_what_is_no_positive_depth_is_no_point():
    depth = np.full((1, 4, 5), 2.0, np.float32)
    depth[0, 0, :4] = (0, -1, np.nan, np.inf)
    points = world_points(depth, K[:1], T[:1])
    assert np.isnan(points[0, 0, :4]).all()
    assert np.isfinite(points[0, 0, 4]).all()


@pytest.mark.parametrize("rows", [3, 4])
def test_camera_from_world_is_inverted(rows):
    from_world = np.stack([invert_rigid(pose) for pose in T])[:, :rows].astype(np.float32)
    assert np.allclose(camera_to_world(from_world), T, atol=1e-5)


def test_rotations_are_made_orthonormal_but_mirrors_are_left_to_the_validator():
    noisy = T.copy()
    noisy[:, :3, :3] += np.random.default_rng(2).normal(0, 1e-4, (2, 3, 3))
    R = rigid(noisy)[:, :3, :3]
    assert np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max() < 1e-12
    assert np.abs(R - T[:, :3, :3]).max() < 1e-3
    mirrored = T @ np.diag([1.0, 1.0, -1.0, 1.0])
    assert np.array_equal(rigid(mirrored), mirrored)
    scaled = T.copy()
    scaled[:, :3, :3] *= 2
    assert np.array_equal(rigid(scaled), scaled)


def test_half_a_pixel_is_added_once():
    assert (centred(K)[:, :2, 2] - K[:, :2, 2] == 0.5).all()
    assert np.array_equal(centred(K)[:, :, :2], K[:, :, :2])


def test_intrinsics_are_found_from_points_in_the_camera():
    rng = np.random.default_rng(3)
    points = world_points(rng.uniform(2, 9, (2, 40, 60)).astype(np.float32), K, np.tile(np.eye(4), (2, 1, 1)))
    flying = rng.random((2, 40, 60)) < 0.06
    points[flying] += rng.normal(0, 1, (flying.sum(), 3)).astype(np.float32)
    points[:, :5] = np.nan
    assert np.allclose(fitted_intrinsics(points), K, atol=0.2)
    exact = np.where(flying[..., None], np.float32(np.nan), points)
    assert np.allclose(fitted_intrinsics(exact), K, atol=1e-3)
    assert np.isnan(fitted_intrinsics(np.full((1, 4, 5, 3), np.nan, np.float32))[0, 0, 0])


def test_the_file_with_the_tensors_is_found(tmp_path):
    card = DepthAnything3.card
    with pytest.raises(InputError, match=r"holds no \*\.safetensors"):
        checkpoint(tmp_path, card)
    (tmp_path / "a.pt").touch()
    assert checkpoint(tmp_path, card).name == "a.pt"
    (tmp_path / "b.pt").touch()
    with pytest.raises(InputError, match=r"holds several \(a\.pt, b\.pt\)"):
        checkpoint(tmp_path, card)
    (tmp_path / "model.safetensors").touch()
    assert checkpoint(tmp_path, card).name == "model.safetensors"
    assert checkpoint(tmp_path / "b.pt", card).name == "b.pt"


def test_settings_are_read_beside_the_tensors(tmp_path):
    (tmp_path / "model.safetensors").touch()
    assert settings(tmp_path / "model.safetensors") == {}
    (tmp_path / "config.json").write_text('{"size": 3}')
    assert settings(tmp_path / "model.safetensors") == settings(tmp_path) == {"size": 3}
    with pytest.raises(InputError, match="does not take the settings"):
        build(lambda width: width, settings(tmp_path), DepthAnything3.card)
    (tmp_path / "config.json").write_text("<html>")
    with pytest.raises(InputError, match="is no JSON"):
        settings(tmp_path)


@pytest.mark.parametrize(
    ("images", "height", "published"), [(30, 378, 18.7), (120, 378, 28.3), (30, 154, 11.5), (120, 154, 15.9)]
)
def test_memory_of_depth_anything_is_what_was_published(monkeypatch, tmp_path, images, height, published):
    """README of da3_streaming: peak memory of NESTED at 504 px width [GB]."""
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path))
    estimate = DepthAnything3(weights=NESTED).memory(images, height, 504) / 1e9
    assert abs(estimate / published - 1) < 0.12


def test_smaller_models_take_less_memory(monkeypatch, tmp_path):
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path))
    small, base, nested = (
        DepthAnything3(weights=name).memory(30, 378, 504) for name in ("DA3-SMALL", "DA3-BASE", NESTED)
    )
    assert small < base < 0.5 * nested
    assert DepthAnything3().memory(30, 378, 504) == base


@pytest.mark.parametrize("name", NETWORKS)
def test_memory_grows_with_images_and_pixels(monkeypatch, tmp_path, name):
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path))
    network = entry("reconstructor", name).load()()
    assert network.lattice % network.patch == 0
    assert 1e8 < network.memory(2, 280, 420) < network.memory(9, 280, 420) < network.memory(9, 420, 420)
    assert network.memory(30, 420, 518) < network.memory(100, 420, 518) < 60e9


def test_importing_the_adapters_imports_no_network_library():
    homes = ", ".join(entry("reconstructor", name).home.partition(":")[0] for name in NETWORKS)
    code = f"import sys, {homes}; assert not {{'torch', 'safetensors', 'depth_anything_3'}} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
