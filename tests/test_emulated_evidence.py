"""Evidence like YOLOE's and Mask2Former's: seeded, right when told to be, wrong in the ways that its fields say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import emulated_views
from emulated_views import CAMERAS, SITE, agreement, by_cell
from excavatwin.errors import InputError
from excavatwin.evaluation.semantics import confusion, intersection_over_union
from excavatwin.scene.taxonomy import K, TaskClass
from excavatwin.simulation import orbit, random_site, render_view
from excavatwin.simulation.emulators import Exact, Mask2FormerLike, VggtLike, YoloeLike, emulate
from excavatwin.simulation.emulators.fields import anchored, footprint, look_alike, patches

SEGMENTERS = (YoloeLike(), Mask2FormerLike())


@pytest.fixture(scope="module")
def views():
    return emulated_views.true_views()


@pytest.fixture(scope="module")
def horizon():
    return emulated_views.horizon()


@pytest.mark.parametrize("segmenter", SEGMENTERS)
def test_the_same_seed_gives_the_same_observations_and_another_seed_others(segmenter) -> None:
    first, again, other = (emulate(SITE, CAMERAS[:2], VggtLike(), segmenter, seed) for seed in (5, 5, 6))
    for a, b, c in zip(first.observations.views, again.observations.views, other.observations.views, strict=True):
        for name in ("points", "confidence", "evidence", "T_R_cam", "K_cam"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        assert not np.array_equal(a.points, c.points, equal_nan=True)
        assert not np.array_equal(a.evidence, c.evidence)
    np.testing.assert_array_equal(first.T_M_R, again.T_M_R)


@pytest.mark.parametrize("segmenter", SEGMENTERS)
def test_more_views_do_not_change_the_errors_of_the_first_ones(segmenter, views) -> None:
    few, many = segmenter(views[:2], CAMERAS[:2], 4), segmenter(views, CAMERAS, 4)
    np.testing.assert_array_equal(few[1], many[1])


def test_images_come_along_when_they_are_rendered() -> None:
    coloured = emulate(SITE, CAMERAS[:1], Exact(), YoloeLike(), 0)
    assert coloured.views[0].image.any()
    np.testing.assert_array_equal(coloured.observations.views[0].image, coloured.views[0].image)
    assert emulate(SITE, CAMERAS[:1], Exact(), YoloeLike(look=0), 0, samples=0).observations.views[0].image is None
    assert "VggtLike" not in coloured.observations.source["reconstructor"]
    assert "YoloeLike" in coloured.observations.source["segmenter"]


@pytest.mark.parametrize("segmenter", [*SEGMENTERS, YoloeLike.goose_ex(), Mask2FormerLike.goose_ex()])
def test_evidence_is_in_range_and_the_sky_has_none(segmenter, views, horizon) -> None:
    view, camera = horizon
    (looked,) = segmenter([view], [camera], 1)
    assert not looked[np.isnan(view.depth)].any()
    for seen in (looked, *segmenter(views, CAMERAS, 1)):
        assert seen.dtype == np.float32
        assert seen.shape[-1] == K
        assert seen.min() >= 0
        assert seen.max() <= 1
    if isinstance(segmenter, Mask2FormerLike):
        assert looked.sum(-1).max() < 1 + 1e-5
    else:
        reported = looked[looked > 0]
        assert reported.size == 0 or reported.min() >= segmenter.threshold


@pytest.mark.parametrize(("look", "least"), [(0.0, 0.25), (0.5, 0.12)])  # looks also err alike on all of the soil
def test_errors_that_stick_are_the_same_in_every_view_and_fresh_ones_are_not(look, least, views) -> None:
    soil = np.array([view.label == TaskClass.CONSTRUCTION_TERRAIN for view in views])
    found = {}
    for share in (0.0, 0.5, 1.0):
        evidence = np.array(replace(Mask2FormerLike(), sticky=share, border=0.3, look=look)(views, CAMERAS, 2))
        cells = by_cell(views, np.where(soil, evidence[..., 0], np.nan))
        found[share] = np.mean([agreement(cells[i], cells[j]) for i, j in ((0, 1), (0, 2), (1, 3))])
    assert abs(found[0.0]) < 0.25
    assert least < found[0.5] < 0.75
    assert found[1.0] > 0.9


def painted(view, left, right):
    """The view with its left half of one colour and its right half of another."""
    image = np.empty_like(view.image)
    half = image.shape[1] // 2
    image[:, :half], image[:, half:] = left, right
    return replace(view, image=image)


def test_what_looks_alike_is_wrong_alike_in_every_view_and_place(views) -> None:
    pale, dark = (180, 160, 120), (60, 70, 40)
    there = look_alike(painted(views[0], pale, dark), 3, 2)
    elsewhere = look_alike(painted(views[1], dark, pale), 3, 2)
    np.testing.assert_allclose(there[:, :100], np.broadcast_to(there[0, 0], there[:, :100].shape), atol=1e-3)
    np.testing.assert_allclose(there[50, 20], elsewhere[90, -20], atol=1e-3)
    assert np.abs(there[50, 20] - there[50, -20]).max() > 0.1
    assert not np.allclose(there[50, 20], look_alike(painted(views[0], pale, dark), 4, 2)[50, 20])
    nearly = look_alike(painted(views[0], (181, 161, 121), dark), 3, 2)
    assert 0 < np.abs(nearly[50, 20] - there[50, 20]).max() < 0.2


@pytest.mark.parametrize("look", [0.0, 1.0])
def test_errors_of_a_dense_segmenter_follow_colour_when_told_to(look, views) -> None:
    segmenter = Mask2FormerLike(look=look, sticky=1, border=0, small=0)
    one = painted(views[0], (150, 120, 90), (150, 120, 90))
    evidence = segmenter([one], CAMERAS[:1], 2)[0][one.label == TaskClass.OTHER_TERRAIN]
    varies = evidence[:: max(1, len(evidence) // 2000), 1].std()
    assert varies < 1e-3 if look else varies > 0.1


def test_errors_that_follow_looks_have_unit_spread_over_scenes_and_no_bias(views) -> None:
    """Errors of the other kind have the same, so ``look`` moves errors and does not add any."""
    drawn = np.array([look_alike(replace(views[0], image=views[0].image[::8, ::8]), seed, 1) for seed in range(150)])
    assert 0.85 < drawn.std() < 1.15
    assert abs(drawn.mean()) < 0.15


def test_as_many_pixels_are_wrong_whatever_errors_follow(views) -> None:
    true = np.array([view.label for view in views[:2]])
    wrong = {}
    for look in (0.0, 0.5, 1.0):
        segmenter = Mask2FormerLike(look=look)
        labels = [np.array(segmenter(views[:2], CAMERAS, seed)).argmax(-1) + 1 for seed in range(8)]
        wrong[look] = np.mean([(label != true).mean() for label in labels])
    assert abs(wrong[0.5] - wrong[0.0]) < 0.06
    assert abs(wrong[1.0] - wrong[0.0]) < 0.08


def test_blobs_of_a_detector_lie_where_colours_tell_when_told_to(views) -> None:
    """With one colour all over its soil, a field that follows colour has no place of its own: blobs fill the region."""
    quiet = dict.fromkeys(("growth", "missing", "ghosts", "border"), 0.0) | {"plants": -99.0, "machines": -99.0}
    plain = [painted(view, (150, 120, 90), (150, 120, 90)) for view in views]
    share = {}
    for look in (0.0, 1.0):
        found = YoloeLike(**quiet, things=-99.0, stuff=3.0, sticky=1, look=look)(plain, CAMERAS, 5)
        share[look] = np.mean([(evidence.max(-1) > 0).mean() for evidence in found])
    assert share[1.0] > 1.5 * share[0.0] > 0


@pytest.mark.parametrize("segmenter", SEGMENTERS)
def test_errors_that_follow_looks_need_colours(segmenter, views) -> None:
    black = [replace(view, image=np.zeros_like(view.image)) for view in views[:2]]
    with pytest.raises(InputError, match=r"View 0 is black.*look=0"):
        segmenter(black, CAMERAS, 1)
    assert replace(segmenter, look=0)(black, CAMERAS, 1)[0].max() >= 0


def test_what_a_detector_always_misses_or_mistakes_depends_on_the_thing_alone(views) -> None:
    detector = YoloeLike(
        things=2, machines=2, growth=0, sticky=1, mistaken=0.5, missing=0, stuff=0, ghosts=0, luck=3, border=0
    )
    called: dict[int, set[int]] = {}
    for view, evidence in zip(views, detector(views, CAMERAS, 5), strict=True):
        for key in np.unique(view.instance[view.instance > 0]):
            on = evidence[view.instance == key]
            if len(on) > 150:
                called.setdefault(int(key), set()).add(int(np.median(np.where(on.max(-1) > 0, on.argmax(-1) + 1, 0))))
    assert len(called) >= 5
    assert all(len(classes) == 1 for classes in called.values())
    assert len(set().union(*called.values())) >= 2


def test_a_perfect_detector_reports_the_things_and_nothing_else(views) -> None:
    detector = YoloeLike(
        things=9, machines=9, plants=-99, growth=0, luck=0, mistaken=0, missing=0, stuff=0, ghosts=0, border=0
    )
    for view, evidence in zip(views, detector(views, CAMERAS, 5), strict=True):
        found = np.where(evidence.max(-1) > 0, evidence.argmax(-1) + 1, 0)
        np.testing.assert_array_equal(found, np.where(view.instance > 0, view.label, 0))
        assert evidence.max() == np.float32(0.95)


def test_detections_and_their_flaws_grow_with_their_fields(views) -> None:
    def share(**fields) -> float:
        quiet = dict.fromkeys(("luck", "growth", "mistaken", "missing", "stuff", "ghosts", "border"), 0.0)
        quiet |= {"things": 2.0, "machines": 2.0, "plants": -99.0}
        evidence = np.array(YoloeLike(**(quiet | fields))(views, CAMERAS, 5))
        return float((evidence.max(-1) > 0).mean())

    plain = share()
    assert share(things=-9.0) < share(things=0.0, luck=1.0) < plain
    assert share(things=-9.0, machines=-9.0) == 0
    assert share(plants=9.0) > plain
    assert share(stuff=2.0) > plain
    assert share(ghosts=2.0) > plain
    assert share(missing=0.5) < share(missing=0.2) < plain


def test_a_perfect_dense_segmenter_is_right_and_skill_decides_how_often_another_is(views) -> None:
    true = np.array([view.label for view in views])

    def right(**fields) -> float:
        found = np.array(replace(Mask2FormerLike(), **fields)(views, CAMERAS, 5)).argmax(-1) + 1
        return float((found == true).mean())

    assert right(skill=9, spread=0, border=0, small=0, nothing=-9) > 0.995
    assert right(skill=0) < right(skill=1.5) < right(skill=4)
    assert right(spread=3.0) < right(spread=0.5)


def test_a_dense_segmenter_is_worse_far_away_and_its_scores_claim_too_much(views) -> None:
    true = np.array([view.label for view in views])
    size = np.array([footprint(view, camera) for view, camera in zip(views, CAMERAS, strict=True)])
    evidence = np.concatenate([np.array(Mask2FormerLike()(views, CAMERAS, seed))[None] for seed in range(6)])
    right, score = evidence.argmax(-1) + 1 == true, evidence.max(-1)
    soil = np.broadcast_to(true == TaskClass.CONSTRUCTION_TERRAIN, right.shape)
    near, far = soil & (size < np.quantile(size, 0.3)), soil & (size > np.quantile(size, 0.7))
    assert right[near].mean() > right[far].mean() + 0.03
    assert score[right].mean() > score[~right].mean() + 0.03
    assert score.mean() > right.mean() + 0.05


def test_small_things_are_lost_in_their_surroundings(views) -> None:
    kept = {}
    for small in (1.0, 1e5):
        evidence = np.array(replace(Mask2FormerLike(), spread=0, skill=5, small=small)(views, CAMERAS, 5))
        on = np.array([view.instance > 0 for view in views])
        kept[small] = float((evidence[on].argmax(-1) + 1 >= TaskClass.EXCAVATOR).mean())
    assert kept[1.0] > 0.7 > kept[1e5] + 0.4


def test_fields_have_unit_spread_and_forget_themselves_over_their_wavelength(views) -> None:
    drawn = patches((400, 500), 40.0, np.random.default_rng(0), 4)
    assert 0.85 < drawn.std() < 1.15
    assert abs(np.mean(drawn[:, :-80] * drawn[:, 80:])) < 0.15 < 0.7 < np.mean(drawn[:, :-4] * drawn[:, 4:])
    world = np.stack(np.meshgrid(np.arange(0, 60, 0.2), np.arange(0, 60, 0.2), [0.3]), -1).reshape(300, 300, 3)
    held = anchored(world.astype(np.float32), 4.0, 1, 3)
    assert 0.8 < held.std() < 1.2
    assert abs(np.mean(held[:, :-40] * held[:, 40:])) < 0.15


def test_calibration_holds_loosely_on_one_site() -> None:
    """benchmarks/emulator_calibration.py holds it within a point on the mean of eight sites."""
    site = replace(random_site(100), cell=0.1)
    cameras = orbit(4, width=518, aspect=392 / 518, seed=100)
    views = [render_view(site, camera, samples=1) for camera in cameras]
    true = np.array([view.label for view in views])
    inside = np.array([(np.abs(view.points[..., :2]) <= site.extent / 2).all(-1) for view in views])
    for segmenter, miou, coverage in (
        (YoloeLike(), (0.5, 18.0), (0.5, 7.0)),
        (Mask2FormerLike(), (24.0, 46.0), (85.0, 98.0)),
    ):
        evidence = np.array(segmenter(views, cameras, 100))
        label = np.where(evidence.max(-1) >= 0.2, evidence.argmax(-1) + 1, 0).astype(np.uint8)
        counts = confusion(label[inside], true[inside])
        assert miou[0] < 100 * np.nanmean(intersection_over_union(counts)) < miou[1]
        assert coverage[0] < 100 * counts[:, :K].sum() / counts.sum() < coverage[1]


@pytest.mark.parametrize(
    ("part", "wrong"), [(VggtLike, {"rotation": -1}), (VggtLike, {"confidence_correlation": 2}),
                        (YoloeLike, {"sticky": 1.5}), (YoloeLike, {"look": -0.1}),
                        (Mask2FormerLike, {"look": 1.1}), (Mask2FormerLike, {"world_patch": 0.0})],
)  # fmt: skip
def test_parameters_out_of_range_are_refused_by_name(part, wrong) -> None:
    with pytest.raises(InputError, match=f"{part.__name__}.{next(iter(wrong))}"):
        part(**wrong)
