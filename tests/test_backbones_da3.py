"""Depth Anything 3: the package's own code, with random weights, through the whole adapter on the CPU."""

from __future__ import annotations

import json
import sys
import warnings

import numpy as np
import pytest

from excavatwin.backbones.device import Device, out_of_memory
from excavatwin.backbones.lattices import IMAGENET
from excavatwin.backbones.reconstructors import depth_anything_3 as adapter
from excavatwin.backbones.reconstructors.depth_anything_3 import DepthAnything3
from excavatwin.contract.reprojection import reprojection
from excavatwin.errors import InputError

CPU = Device(name="cpu")
torch = pytest.importorskip("torch", reason="needs torch: make test-backbones")
pytest.importorskip("depth_anything_3", reason="needs depth-anything-3: make test-backbones")


def network_of(preset: str):
    """Real code, random weights, except that its cameras get fields of view and rotations such as cameras have."""
    torch.manual_seed(3)
    model = adapter._built(preset)
    with torch.no_grad():
        for layer, bias in ((model.cam_dec.fc_fov[0], (0.9, 1.1)), (model.cam_dec.fc_qvec, (0.0, 0.0, 0.0, 1.0))):
            layer.bias.copy_(torch.tensor(bias))
    return model.eval()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Weights of DA3-SMALL as the hub keeps them; the function that writes them keeps one name of shared tensors."""
    from safetensors.torch import save_model

    place = tmp_path_factory.mktemp("DA3-SMALL")
    api = torch.nn.Module()
    api.model = network_of("da3-small")
    save_model(api, str(place / "model.safetensors"))
    (place / "config.json").write_text(json.dumps({"model_name": "da3-small"}))
    return place


@pytest.fixture(scope="module")
def network(folder):
    """The adapter's."""
    return DepthAnything3(weights=str(folder), device=CPU).open()


def pictures(S: int, H: int, W: int):
    rng = np.random.default_rng(5)
    v, u = np.mgrid[:H, :W]
    shade = 127 + 80 * np.sin(u / 9 + np.arange(S)[:, None, None]) * np.cos(v / 7)
    return np.clip(shade[..., None] + rng.normal(0, 9, (S, H, W, 3)) + (30, 0, -30), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(("views", "shape"), [(4, (70, 98)), (1, (84, 70))])
def test_prediction_keeps_our_conventions(network, views, shape):
    prediction = network(pictures(views, *shape))
    assert prediction.points.shape == (views, *shape, 3)
    assert prediction.points.dtype == prediction.confidence.dtype == np.float32
    assert prediction.confidence.shape == (views, *shape)
    assert prediction.confidence.min() >= 1
    assert not prediction.metric
    for s in range(views):
        T, K = prediction.T_world_cam[s], prediction.K_cam[s]
        assert np.allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), atol=1e-9)
        assert K[:2, 2].tolist() == [shape[1] / 2, shape[0] / 2]
        found = reprojection(prediction.points[s], T, K)
        assert found is not None
        assert found.median < 1e-3, found
    if views > 1:
        distances = np.linalg.norm(np.diff(prediction.T_world_cam[:, :3, 3], axis=0), axis=-1)
        assert distances.min() > 1e-4, "cameras differ, so a pose of the wrong direction would show"


def test_poses_and_points_are_those_of_the_package(network):
    """Camera-from-world upstream; its unprojection counts pixel centres at whole numbers."""
    from depth_anything_3.utils.geometry import affine_inverse, as_homogeneous, unproject_depth

    images = pictures(3, 70, 98)
    prediction = network(images)
    with torch.inference_mode():
        out = network.model(adapter.pictures(images, torch.device("cpu"), *IMAGENET)[None])
    c2w = affine_inverse(as_homogeneous(out["extrinsics"]))
    assert np.allclose(prediction.T_world_cam, c2w[0].numpy(), atol=1e-5)
    assert not np.allclose(prediction.T_world_cam[1], as_homogeneous(out["extrinsics"])[0, 1].numpy(), atol=1e-2)
    at_whole_numbers = out["intrinsics"].clone()
    at_whole_numbers[..., :2, 2] -= 0.5
    theirs = unproject_depth(out["depth"][..., None], at_whole_numbers, c2w)
    assert np.allclose(prediction.points, theirs[0].numpy(), atol=1e-4)


def test_in_bfloat16(folder):
    network = DepthAnything3(weights=str(folder), device=Device(name="cpu", precision="bfloat16")).open()
    prediction = network(pictures(2, 70, 70))
    assert prediction.points.dtype == np.float32
    assert np.abs(np.linalg.det(prediction.T_world_cam[:, :3, :3]) - 1).max() < 1e-9
    found = reprojection(prediction.points[1], prediction.T_world_cam[1], prediction.K_cam[1])
    assert found is not None
    assert found.median < 1e-3


def test_the_network_is_given_rgb_with_imagenet_normalisation(network):
    seen = []
    hook = network.model.register_forward_pre_hook(lambda module, given: seen.append(given[0]))
    images = np.zeros((2, 70, 70, 3), np.uint8)
    images[..., 0], images[..., 1] = 255, 51
    network(images)
    hook.remove()
    assert seen[0].shape == (1, 2, 3, 70, 70)
    expected = [(1 - 0.485) / 0.229, (0.2 - 0.456) / 0.224, -0.406 / 0.225]
    assert np.allclose(seen[0][0, 0, :, 9, 9].numpy(), expected, atol=1e-5)


def test_cameras_from_rays_repeat(folder):
    network = DepthAnything3(weights=str(folder), device=CPU, rays=True).open()
    state = torch.random.get_rng_state()
    first, second = network(pictures(2, 56, 70)), network(pictures(2, 56, 70))
    assert torch.equal(state, torch.random.get_rng_state()), "the caller's random numbers are untouched"
    for name in ("points", "confidence", "T_world_cam", "K_cam"):
        assert np.array_equal(getattr(first, name), getattr(second, name), equal_nan=True)
    assert not np.allclose(first.K_cam[:, :2, 2], (35, 28)), "its principal points are estimated"


def test_nested_networks_are_metric_and_their_sky_is_no_surface():
    """The real nested network around two small ones."""
    from depth_anything_3.model.da3 import DepthAnything3Net, NestedDepthAnything3Net

    trunk = {
        "__object__": {"path": "depth_anything_3.model.dinov2.dinov2", "name": "DinoV2", "args": "as_params"},
        "name": "vits", "out_layers": [2, 5, 8, 11], "cat_token": False,
    }  # fmt: skip
    head = {
        "__object__": {"path": "depth_anything_3.model.dpt", "name": "DPT", "args": "as_params"},
        "dim_in": 384, "output_dim": 1, "features": 16, "out_channels": [8, 8, 16, 16],
    }  # fmt: skip
    anyview = network_of("da3-small")
    metric = DepthAnything3Net(trunk, head).eval()
    nested = NestedDepthAnything3Net.__new__(NestedDepthAnything3Net)
    torch.nn.Module.__init__(nested)
    nested.da3, nested.da3_metric = anyview, metric
    images = pictures(2, 56, 70)
    network = adapter.Loaded(nested, CPU)
    with torch.no_grad():  # a threshold through the middle of what its sky head says
        last = metric.head.scratch.sky_output_conv2[-1]
        last.bias.fill_(5.0)
        sky = metric(adapter.pictures(images, torch.device("cpu"), *IMAGENET)[None])["sky"]
        last.bias.fill_(5.0 + 0.3 - float(sky.median()))
        expected = metric(adapter.pictures(images, torch.device("cpu"), *IMAGENET)[None])["sky"][0].numpy() >= 0.3
    assert 0.2 < expected.mean() < 0.8
    prediction = network(images)
    assert prediction.metric
    hidden = np.isnan(prediction.points[..., 0])
    assert (hidden == expected).mean() > 0.999
    assert (prediction.confidence[hidden] == 0).all()
    assert prediction.confidence[~hidden].min() >= 1
    assert not metric._forward_hooks, "the hook is removed"
    again = network(images)
    assert np.array_equal(prediction.points, again.points, equal_nan=True)


def test_running_out_of_memory_is_passed_on(network):
    def exhausted(module, given):
        raise torch.OutOfMemoryError("CUDA out of memory.")

    hook = network.model.register_forward_pre_hook(exhausted)
    try:
        with pytest.raises(RuntimeError) as error:
            network(pictures(2, 70, 70))
        assert out_of_memory(error.value)
    finally:
        hook.remove()


def test_monocular_weights_are_refused(tmp_path):
    (tmp_path / "config.json").write_text(json.dumps({"model_name": "da3metric-large"}))
    (tmp_path / "model.safetensors").write_bytes(b"")
    with pytest.raises(InputError, match="sees one image at a time and places no camera"):
        DepthAnything3(weights=str(tmp_path), device=CPU).open()


def test_weights_of_another_model_are_refused(folder, tmp_path):
    from safetensors.torch import load_file, save_file

    state = load_file(folder / "model.safetensors")
    (tmp_path / "config.json").write_text(json.dumps({"model_name": "da3-small"}))
    save_file({key: value for key, value in state.items() if "fc_qvec" not in key}, tmp_path / "model.safetensors")
    with pytest.raises(InputError, match=r"lacks 2 of the network's tensors, such as cam_dec\.fc_qvec"):
        DepthAnything3(weights=str(tmp_path), device=CPU).open()
    state["model.cam_dec.fc_t.bias"] = torch.zeros(7)
    save_file(state, tmp_path / "model.safetensors")
    with pytest.raises(InputError, match=r"belongs to another model .*cam_dec\.fc_t\.bias"):
        DepthAnything3(weights=str(tmp_path), device=CPU).open()


def test_only_what_is_needed_is_imported_and_nothing_is_said(folder, capfd):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        DepthAnything3(weights=str(folder), device=CPU).open()(pictures(3, 56, 56))
    assert "depth_anything_3.api" not in sys.modules
    assert not capfd.readouterr().out
