"""What is saved comes back, to the last bit; what others may write comes in."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from excavatwin.errors import InputError, ObservationError, OutputError
from excavatwin.exchange import load_observations, save_observations
from excavatwin.scene.observations import Observations, View
from site_example import example_observations, misses


@pytest.fixture(scope="module")
def observations():
    return example_observations()


def assert_equal(a: Observations, b: Observations) -> None:
    assert len(a.views) == len(b.views)
    for v, w in zip(a.views, b.views, strict=True):
        assert v.name == w.name
        for key in ("points", "confidence", "evidence", "T_R_cam", "K_cam", "image"):
            np.testing.assert_array_equal(getattr(v, key), getattr(w, key), strict=getattr(v, key) is not None)
        assert (v.lattice is None) == (w.lattice is None)
        if v.lattice and w.lattice:
            assert (v.lattice.width, v.lattice.height, v.lattice.distortion) == (
                w.lattice.width,
                w.lattice.height,
                w.lattice.distortion,
            )
            np.testing.assert_array_equal(v.lattice.affine, w.lattice.affine)
            np.testing.assert_array_equal(v.lattice.K_photo, w.lattice.K_photo)
    np.testing.assert_equal(a.up, b.up)
    assert (a.metres_per_unit, a.georeference, a.unplaced, a.doubts, a.source) == (
        b.metres_per_unit,
        b.georeference,
        b.unplaced,
        b.doubts,
        b.source,
    )


def ragged(observations: Observations) -> Observations:
    """The same with the second view cropped and without its image."""
    view = observations.views[1]
    cropped = replace(
        view, points=view.points[:-8], confidence=view.confidence[:-8], evidence=view.evidence[:-8], image=None
    )
    return replace(observations, views=(observations.views[0], cropped))


def plain(observations: Observations) -> dict[str, np.ndarray]:
    """The contract's keys only, as somebody else's script would stack them."""
    views = observations.views
    return {
        "points": np.stack([v.points for v in views]),
        "confidence": np.stack([v.confidence for v in views]),
        "evidence": np.stack([v.evidence for v in views]),
        "T_world_cam": np.stack([v.T_R_cam for v in views]),
        "K": np.stack([v.K_cam for v in views]),
    }


def test_the_example_itself_reprojects(observations):
    assert max(misses(view) for view in observations.views) < 0.05


@pytest.mark.parametrize("name", ["observations.npz", "observations"])
def test_round_trip(observations, tmp_path, name):
    save_observations(observations, tmp_path / name)
    loaded = load_observations(tmp_path / name)
    assert_equal(loaded, observations)
    save_observations(loaded, tmp_path / name)  # replaces its own
    assert_equal(load_observations(tmp_path / name), observations)


def test_ragged_views_are_a_folder(observations, tmp_path):
    different = ragged(observations)
    with pytest.raises(InputError, match=r"2 different sizes and do not fit one \.npz; give a folder"):
        save_observations(different, tmp_path / "a.npz")
    assert list(tmp_path.iterdir()) == []
    save_observations(different, tmp_path / "a")
    assert_equal(load_observations(tmp_path / "a"), different)
    assert json.loads((tmp_path / "a" / "views.json").read_text())["views"][1]["name"] == "IMG_0001.JPG"


def test_equal_observations_give_equal_bytes(observations, tmp_path):
    save_observations(observations, tmp_path / "a.npz")
    save_observations(observations, tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_a_single_file_is_readable_by_numpy_alone(observations, tmp_path):
    save_observations(observations, tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as archive:
        assert archive["points"].shape == (2, 40, 60, 3)
        assert archive["points"].dtype == np.float32
        assert list(archive["names"]) == ["IMG_0000.JPG", "IMG_0001.JPG"]


def test_a_folder_of_something_else_is_not_overwritten(observations, tmp_path):
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "a.jpg").write_text("mine")
    with pytest.raises(OutputError, match="already holds something else"):
        save_observations(observations, tmp_path / "photos")
    assert (tmp_path / "photos" / "a.jpg").read_text() == "mine"


def test_the_minimum_of_the_contract(observations, tmp_path):
    np.savez_compressed(tmp_path / "a.npz", **plain(observations))
    loaded = load_observations(tmp_path / "a.npz")
    assert [view.name for view in loaded.views] == ["view_000", "view_001"]
    assert (loaded.up, loaded.metres_per_unit, loaded.doubts) == (None, None, ())
    np.testing.assert_array_equal(loaded.views[1].evidence, observations.views[1].evidence)


def test_other_dtypes_and_optional_keys(observations, tmp_path):
    arrays = plain(observations)
    arrays["points"] = arrays["points"].astype(np.float64)
    arrays["confidence"] = arrays["confidence"].astype(np.float16)
    arrays["T_world_cam"] = arrays["T_world_cam"].astype(np.float32)
    np.savez(tmp_path / "a.npz", **arrays, names=np.array([b"a", b"b"]), up=[0, 0, 2.0], metres_per_unit=2.5)
    loaded = load_observations(tmp_path / "a.npz")
    assert loaded.views[0].points.dtype == loaded.views[0].confidence.dtype == np.float32
    assert loaded.views[0].T_R_cam.dtype == np.float64
    assert [view.name for view in loaded.views] == ["a", "b"]
    np.testing.assert_array_equal(loaded.up, [0, 0, 1])
    assert loaded.metres_per_unit == 2.5


def test_a_point_with_one_nan_is_no_point(observations, tmp_path):
    arrays = plain(observations)
    row, col = np.argwhere(~np.isnan(arrays["points"][0, ..., 0]))[0]
    arrays["points"][0, row, col, 2] = np.nan
    np.savez(tmp_path / "a.npz", **arrays)
    assert np.isnan(load_observations(tmp_path / "a.npz").views[0].points[row, col]).all()


def test_what_lies_under_no_point_may_be_anything(observations, tmp_path):
    arrays = plain(observations)
    arrays["confidence"][np.isnan(arrays["points"][..., 0])] = np.nan
    np.savez(tmp_path / "a.npz", **arrays)
    view: View = load_observations(tmp_path / "a.npz").views[0]
    assert (view.confidence[np.isnan(view.points[..., 0])] == 0).all()


def test_a_view_without_points_is_named_and_all_of_them_refused(observations, tmp_path):
    arrays = plain(observations)
    arrays["points"][1] = np.nan
    np.savez(tmp_path / "a.npz", **arrays)
    assert load_observations(tmp_path / "a.npz").doubts == ("1 of 2 views hold no point at all: view_001.",)
    arrays["points"][0] = np.nan
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(ObservationError, match="NaN everywhere, in all 2 views"):
        load_observations(tmp_path / "a.npz")


@settings(deadline=None, max_examples=40)
@given(
    shapes=st.lists(st.tuples(st.integers(2, 7), st.integers(2, 7)), min_size=1, max_size=3),
    seed=st.integers(0, 2**31),
    size=st.floats(1e-3, 1e3),
    ragged=st.booleans(),
)
def test_every_consistent_pinhole_camera_comes_back_without_a_doubt(tmp_path_factory, shapes, seed, size, ragged):
    """Law: whatever the size of the world, the pose and the gaps, save then load is the identity and finds nothing."""
    rng = np.random.default_rng(seed)
    views = []
    for i, (H, W) in enumerate(shapes if ragged else [shapes[0]] * len(shapes)):
        K = np.array([[W * rng.uniform(0.5, 2), 0, W / 2], [0, W * rng.uniform(0.5, 2), H / 2], [0, 0, 1]])
        T = np.eye(4)
        T[:3, :3] = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
        T[:3, 3] = size * rng.normal(size=3)
        col, row = np.meshgrid(np.arange(W) + 0.5, np.arange(H) + 0.5)
        rays = np.stack([(col - W / 2) / K[0, 0], (row - H / 2) / K[1, 1], np.ones((H, W))], -1)
        points = (rays * size * rng.uniform(1, 5, (H, W, 1))) @ T[:3, :3].T + T[:3, 3]
        points[rng.random((H, W)) < 0.3] = np.nan
        points[0, 0] = T[:3, 3] + size * T[:3, :3] @ rays[0, 0]  # at least one
        confidence, evidence = rng.random((H, W), np.float32), rng.random((H, W, 5), np.float32)
        views.append(View(f"{i}.jpg", points.astype(np.float32), confidence, evidence, T, K))
    observations = Observations(tuple(views))
    path = tmp_path_factory.mktemp("law") / ("folder" if ragged else "file.npz")
    save_observations(observations, path)
    assert_equal(load_observations(path), observations)
