"""Laws of long sequences: the answer does not depend on how they were cut, nor on the frame that a network chose."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emulated_network import Emulated, Flight, line
from excavatwin.backbones.sequence.network import Prediction
from excavatwin.errors import ObservationError, OutputError, ReconstructionError
from excavatwin.scene.frames import invert_rigid, umeyama
from excavatwin.scene.observations import Observations
from excavatwin.scene.progress import silent

COUNT = 14


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    return Flight(line(COUNT), tmp_path_factory.mktemp("flight"))


def scratch_in(folder: Path) -> Path:
    made = folder / f"{len(list(folder.iterdir()))}"
    made.mkdir()
    return made


def reconstructed(model: Emulated, folder: Path, photos: object = None) -> Observations:
    assert model.flight is not None
    return model(photos or model.flight.photos, silent, scratch_in(folder))


def samples(obs: Observations, flight: Flight) -> tuple[np.ndarray, np.ndarray]:
    """Some points, and the true ones."""
    which = {photo.name: i for i, photo in enumerate(flight.photos)}
    seen = np.concatenate([np.asarray(v.points[::5, ::5], float).reshape(-1, 3) for v in obs.views])
    return seen, np.concatenate([flight.points(which[v.name])[::5, ::5].reshape(-1, 3) for v in obs.views])


def error(obs: Observations, flight: Flight) -> np.ndarray:
    """Distance of points from the truth after the best similarity [m]."""
    seen, true = samples(obs, flight)
    s, R, t = umeyama(seen, true, np.ones(len(seen)))
    return np.linalg.norm(s * seen @ R.T + t - true, axis=1)


@settings(deadline=None, max_examples=4)
@given(seed=st.integers(1, 10_000))
def test_the_frames_of_the_chunks_do_not_matter(flight, tmp_path_factory, seed: int) -> None:
    folder = tmp_path_factory.mktemp("frames")
    first = reconstructed(Emulated(flight=flight, frames=0).with_chunks(6), folder)
    other = reconstructed(Emulated(flight=flight, frames=seed).with_chunks(6), folder)
    for a, b in zip(first.views, other.views, strict=True):
        np.testing.assert_allclose(a.points, b.points, atol=2e-5)
        np.testing.assert_allclose(a.T_R_cam, b.T_R_cam, atol=2e-5)


@settings(deadline=None, max_examples=6)
@given(size=st.integers(2, COUNT + 3), shared=st.integers(1, 6))
def test_the_size_of_the_chunks_does_not_matter(flight, tmp_path_factory, size: int, shared: int) -> None:
    folder = tmp_path_factory.mktemp("sizes")
    whole = reconstructed(Emulated(flight=flight).with_chunks(COUNT), folder)
    model = Emulated(flight=flight).with_chunks(size, shared)
    parts = reconstructed(model, folder)
    assert all(len(asked) <= size for asked in model.asked)
    assert [v.name for v in parts.views] == [photo.name for photo in flight.photos]
    for a, b in zip(whole.views, parts.views, strict=True):
        np.testing.assert_allclose(a.points, b.points, atol=5e-5)
        np.testing.assert_allclose(a.K_cam, b.K_cam)
    assert error(parts, flight).max() < 1e-4


def test_the_order_of_the_views_does_not_matter(flight, tmp_path) -> None:
    timeless = [replace(photo, time=None) for photo in flight.photos]
    forth = reconstructed(Emulated(flight=flight).with_chunks(5), tmp_path, timeless)
    back = reconstructed(Emulated(flight=flight).with_chunks(5), tmp_path, timeless[::-1])
    assert [v.name for v in forth.views] == [v.name for v in back.views][::-1]
    a, b = samples(forth, flight)[0], samples(replace(back, views=back.views[::-1]), flight)[0]
    s, R, t = umeyama(a, b, np.ones(len(a)))
    assert np.linalg.norm(s * a @ R.T + t - b, axis=1).max() < 1e-4


def test_photos_are_taken_in_the_order_of_their_clock(flight, tmp_path) -> None:
    obs = reconstructed(Emulated(flight=flight).with_chunks(5), tmp_path, flight.photos[::-1])
    assert [v.name for v in obs.views] == [photo.name for photo in flight.photos]


@settings(deadline=None, max_examples=4)
@given(seed=st.integers(1, 1000))
def test_seams_hold_with_30_percent_outliers(flight, tmp_path_factory, seed: int) -> None:
    """Of the shared pixels 30 % are wrong in either chunk, so half of the pairs are."""
    model = Emulated(flight=flight, outliers=0.3, frames=seed).with_chunks(6)
    obs = reconstructed(model, tmp_path_factory.mktemp("outliers"))
    centres = np.array([v.centre for v in obs.views])
    s, R, t = umeyama(centres, flight.poses[:, :3, 3], np.ones(COUNT))
    assert np.linalg.norm(s * centres @ R.T + t - flight.poses[:, :3, 3], axis=1).max() < 1e-4
    assert np.median(error_of_rays(obs, flight, s, R, t)) < 1e-4
    assert any("seams between chunks fit badly" in doubt for doubt in obs.doubts)


def error_of_rays(obs: Observations, flight: Flight, s: float, R: np.ndarray, t: np.ndarray) -> np.ndarray:
    seen, true = samples(obs, flight)
    return np.linalg.norm(s * seen @ R.T + t - true, axis=1)


def test_views_are_files_and_cost_no_memory(flight, tmp_path) -> None:
    obs = reconstructed(Emulated(flight=flight).with_chunks(6), tmp_path)
    for view in obs.views:
        assert isinstance(view.points, np.memmap)
        assert isinstance(view.confidence, np.memmap)
        assert view.points.dtype == view.confidence.dtype == np.float32
        assert not view.points.flags.writeable
        assert view.evidence.shape == (*view.shape, 5)
        assert view.evidence.strides == (0, 0, 0)
        assert not view.evidence.any()
        assert view.image is not None
    left = sorted(file.name for file in (tmp_path / "0").iterdir())
    assert left == ["confidence.npy", "images.npy", "points.npy"]
    for i, view in enumerate(obs.views):
        np.testing.assert_array_equal(view.image, flight.image(i))


def test_the_same_photos_give_the_same_bits(flight, tmp_path) -> None:
    model = Emulated(flight=flight, depth_error=0.01)
    first, again = (reconstructed(model.with_chunks(6), tmp_path) for _ in range(2))
    for a, b in zip(first.views, again.views, strict=True):
        np.testing.assert_array_equal(a.points, b.points)


def test_provenance_names_the_network_and_the_plan(flight, tmp_path) -> None:
    told: list[tuple[str, int, int]] = []
    model = Emulated(flight=flight).with_chunks(6)
    obs = model(flight.photos, lambda *step: told.append(step), tmp_path)
    assert obs.source["reconstructor"] == "emulated"
    assert obs.source["confidence"] == "emulated"
    assert obs.source["chunks"] == "4 of 6 photos, at least 3 shared"
    assert obs.source["lattice"] == "64 x 48 px (crop)"
    assert {stage for stage, _, _ in told} == {"reconstruction", "alignment"}
    assert told[-1] == ("alignment", COUNT, COUNT)
    assert obs.up is not None
    assert obs.metres_per_unit is None
    assert any("drift is not known" in doubt for doubt in obs.doubts)


def test_too_little_memory_makes_smaller_chunks_and_says_so(flight, tmp_path) -> None:
    obs = reconstructed(replace(Emulated(flight=flight).with_chunks(12), budget=5), tmp_path)
    assert len(obs.views) == COUNT
    assert error(obs, flight).max() < 1e-4
    said = [doubt for doubt in obs.doubts if "memory ran out" in doubt]
    assert len(said) == 2
    assert "12 images" in said[0]
    assert "going on with 3" in said[1]


def test_a_disk_that_is_too_small_is_refused_beforehand(flight, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda folder: type("Usage", (), {"free": 1000})())
    with pytest.raises(OutputError, match="free some space"):
        reconstructed(Emulated(flight=flight).with_chunks(6), tmp_path)


@pytest.mark.parametrize("count", [1, 2])
def test_few_photos_are_one_chunk(flight, tmp_path, count: int) -> None:
    model = Emulated(flight=flight).with_chunks(1)
    obs = reconstructed(model, tmp_path, flight.photos[:count])
    assert len(obs.views) == count


class Faulty(Emulated):
    """Answers with one mistake."""

    mistake = ""

    def answer(self, images: np.ndarray) -> Prediction:
        said = super().answer(images)
        if self.mistake == "inverted":
            return replace(said, T_world_cam=np.array([invert_rigid(T) for T in said.T_world_cam]))
        if self.mistake == "swapped":
            return replace(said, points=said.points.swapaxes(1, 2))
        if self.mistake == "negative":
            return replace(said, confidence=said.confidence - 5)
        if self.mistake == "torn" and 9 in self.asked[-1]:
            return replace(said, points=said.points * np.float32(np.random.default_rng(0).uniform(0.2, 3)), T_world_cam=
                           np.array([scaled(T, i) for i, T in enumerate(said.T_world_cam)]))  # fmt: skip
        if self.mistake == "one" and 4 in self.asked[-1]:
            T = np.array(said.T_world_cam)
            T[self.asked[-1].index(4), 0, 0] = np.nan
            return replace(said, T_world_cam=T)
        if self.mistake == "empty" and 4 in self.asked[-1]:
            points = said.points.copy()
            points[self.asked[-1].index(4)] = np.nan
            return replace(said, points=points)
        return said


def scaled(T: np.ndarray, i: int) -> np.ndarray:
    moved = T.copy()
    moved[:3, 3] *= 1 + i
    return moved


def faulty(flight: Flight, mistake: str) -> Faulty:
    made = Faulty(flight=flight).with_chunks(6)
    object.__setattr__(made, "mistake", mistake)
    return made


def test_an_inverted_pose_is_refused_and_named(flight, tmp_path) -> None:
    with pytest.raises(ReconstructionError, match="world-to-camera"):
        reconstructed(faulty(flight, "inverted"), tmp_path)


def test_swapped_rows_and_columns_are_refused_and_named(flight, tmp_path) -> None:
    with pytest.raises(ObservationError, match="rows and columns are swapped"):
        reconstructed(faulty(flight, "swapped"), tmp_path)


def test_negative_confidence_is_refused(flight, tmp_path) -> None:
    with pytest.raises(ObservationError, match="confidence is negative"):
        reconstructed(faulty(flight, "negative"), tmp_path)


def test_points_that_leave_their_rays_are_refused(flight, tmp_path) -> None:
    with pytest.raises(ReconstructionError, match="miss their own pixels"):
        reconstructed(faulty(flight, "torn"), tmp_path)


@pytest.mark.parametrize(("mistake", "reason"), [("one", "not finite"), ("empty", "no point")])
def test_a_single_bad_photo_is_left_out_with_its_reason(flight, tmp_path, mistake: str, reason: str) -> None:
    obs = reconstructed(faulty(flight, mistake), tmp_path)
    assert [one.name for one in obs.unplaced] == ["photo_0004.png"]
    assert reason in obs.unplaced[0].reason
    assert len(obs.views) == COUNT - 1
    assert error(obs, flight).max() < 1e-4


class Strange(Emulated):
    """Its second answer is about another place: rays are right, surfaces are not."""

    def answer(self, images: np.ndarray) -> Prediction:
        said = super().answer(images)
        if len(self.asked) < 2:
            return said
        eye = said.T_world_cam[:, None, None, :3, 3]
        rng = np.random.default_rng(1)
        stretch = rng.uniform(0.1, 5, said.points.shape[:3])[..., None]
        return replace(said, points=(eye + stretch * (said.points - eye)).astype(np.float32))


def test_chunks_that_do_not_fit_are_no_map(flight, tmp_path) -> None:
    with pytest.raises(ReconstructionError, match="chunks 1 and 2 agree on"):
        reconstructed(Strange(flight=flight).with_chunks(8), tmp_path)
