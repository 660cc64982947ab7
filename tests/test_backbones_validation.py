"""The validator accuses nobody who is innocent: truth, emulated networks with their errors, real photos."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from conftest import ROOT
from excavatwin.backbones.appearance import Appearance
from excavatwin.backbones.photogrammetry import Photogrammetry
from excavatwin.backbones.protocols import Picture
from excavatwin.capture import find_photos, read_photo
from excavatwin.contract.findings import Severity
from excavatwin.contract.validation import validate
from excavatwin.scene.observations import Observations
from excavatwin.simulation import lawnmower, orbit, random_site, render_view
from excavatwin.simulation.emulators import Mask2FormerLike, VggtLike, YoloeLike, emulate_views
from sound_views import SITE, changed, one_hot, sound

SETS = {
    "brighton_beach": slice(0, 10),
    "caliterra_site": slice(20, 32),
    "ioniq5_object": slice(0, 10),
    "lewis_oblique": slice(0, 10),
    "sandpile_oppaiyama": slice(0, 10),
}


def accused(findings) -> list[str]:
    """Refusals, and whatever claims to know a mistake; plain doubts are allowed."""
    return [str(one) for one in findings if one.severity is Severity.REFUSE or one.cause]


@lru_cache
def photographed(seed: int, flight):
    site = SITE if seed == 7 else replace(random_site(seed), cell=0.1, margin=4.0)
    cameras = flight(6, width=364, aspect=0.75, seed=seed)
    return tuple(render_view(site, camera, samples=1) for camera in cameras), cameras


def witness_of(observations: Observations) -> dict[str, np.ndarray]:
    return {view.name: Appearance()(Picture(view.image)).evidence for view in observations.views}


@pytest.mark.parametrize("segmenter", [Mask2FormerLike(), YoloeLike()], ids=["mask2former", "yoloe"])
@pytest.mark.parametrize(("seed", "flight"), [(3, orbit), (7, lawnmower)])
def test_emulated_networks_are_not_accused(segmenter, flight, seed: int) -> None:
    views, cameras = photographed(seed, flight)
    emulated = emulate_views(views, cameras, VggtLike(), segmenter, seed).observations
    assert accused(validate(emulated, witness=witness_of(emulated))) == []


@pytest.mark.parametrize("mode", ["crop", "pad", "stretch"])
def test_truth_from_above_is_not_accused(mode: str) -> None:
    good = sound(mode, "lawnmower")
    assert accused(validate(good.observations, good.photos, good.witness)) == []


def test_labels_as_evidence_are_a_doubt_and_no_mistake() -> None:
    good = sound()
    (found,) = validate(changed(good.observations, one_hot), good.photos, good.witness)
    assert "arg-max only" in str(found)
    assert found.severity is Severity.REPORT
    assert not found.cause


def test_evidence_of_reconstructors_is_not_asked_for() -> None:
    good = sound()
    empty = changed(good.observations, lambda view: replace(view, evidence=0 * view.evidence))
    assert validate(empty, good.photos, good.witness) == ()


def test_shrunk_photos_do_as_well() -> None:
    import cv2

    good = sound()
    half = {name: cv2.resize(photo, (455, 343), interpolation=cv2.INTER_AREA) for name, photo in good.photos.items()}
    assert accused(validate(good.observations, half)) == []


def test_few_photos_are_read() -> None:
    """Photos of a survey flight are large: a mapping may read them when asked, and few are asked for."""
    good = sound("pad")
    read = []

    class Lazy(Mapping):
        def __getitem__(self, name: str) -> np.ndarray:
            read.append(name)
            return good.photos[name.split()[1]]

        def __iter__(self):
            return iter(view.name for view in views)

        def __len__(self) -> int:
            return len(views)

    views = tuple(replace(view, name=f"{n} {view.name}") for n in range(5) for view in good.observations.views)
    assert accused(validate(replace(good.observations, views=views), Lazy())) == []
    assert 3 <= len(set(read)) <= 6  # shape checks of the tests read one more often


def test_weak_geometry_is_a_doubt_and_no_mistake() -> None:
    """What random weights deliver: no convention explains it, so none is named."""
    rng = np.random.default_rng(0)

    def scrambled(view):
        points = view.T_R_cam[:3, 3] + (view.points - view.T_R_cam[:3, 3]) * np.exp(rng.normal(0, 0.5))
        return replace(view, points=points.astype(np.float32))

    found = validate(changed(sound().observations, scrambled))
    assert accused(found) == []
    assert "disagree about the surface" in str(found[0])


def test_no_view_is_refused() -> None:
    (found,) = validate(Observations(()))
    assert found.severity is Severity.REFUSE


def test_two_seconds_for_twelve_views() -> None:
    """In processor time, for a busy machine, while annotated shapes are checked; two thirds of the pixels, so 1.4 s."""
    good = sound("pad")

    def copies(found: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {f"{n} {name}": array for n in range(3) for name, array in found.items()}

    views = tuple(replace(view, name=f"{n} {view.name}") for n in range(3) for view in good.observations.views)
    start = time.process_time()
    validate(replace(good.observations, views=views), copies(good.photos), copies(good.witness))
    assert time.process_time() - start < 1.4


def real(photos) -> None:
    observations = Photogrammetry(lattice=518)(photos)
    segmented = changed(
        observations, lambda view: replace(view, evidence=Appearance()(Picture(view.image, view.name)).evidence)
    )
    pixels = {photo.name: read_photo(photo) for photo in photos}
    assert accused(validate(segmented, pixels, witness_of(segmented))) == []


@pytest.mark.slow
def test_the_sample_is_not_accused() -> None:
    real(find_photos(ROOT / "sample" / "photos"))


@pytest.mark.slow
@pytest.mark.parametrize("name", SETS)
def test_real_photos_are_not_accused(name: str, shared_data) -> None:
    real(find_photos(shared_data / name / "images")[SETS[name]])
