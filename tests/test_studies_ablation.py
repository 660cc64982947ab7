"""The ablation on a tiny case: references, oracles, what is scored, what is kept; the commands as a user runs them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from excavatwin.cli.ablate import read_seeds, source_of
from excavatwin.errors import InputError
from excavatwin.geometry.scale import Reference, Scale
from excavatwin.mapper import Mapper
from excavatwin.scene.elevation_map import MapObject
from excavatwin.scene.observations import Lattice
from excavatwin.scene.taxonomy import NOT_OBSERVED, TaskClass
from excavatwin.simulation import RenderedView
from excavatwin.studies.ablation import BACKBONE, FULL, ORACLES, ablations, names, study_case, with_references
from excavatwin.studies.case_files import case_from_files, in_photo, labels_on_lattice, similarity_by_cameras
from excavatwin.studies.cases import HELD_OUT_SEEDS, TUNING_SEEDS, Case, simulated_case
from excavatwin.studies.kept_cases import Work, studied
from excavatwin.studies.pixels import PixelLabels, backbone_labels, scores
from excavatwin.studies.references import MARGIN, ends, reference_object
from excavatwin.studies.terrain import heading_and_position, score
from test_cli import cli, sentence
from test_cli_evaluate import dataset  # noqa: F401 - a fixture
from tiny_case import tiny_case, write_tiny_case


@pytest.fixture(scope="module")
def tiny() -> Case:
    return tiny_case()


@pytest.fixture(scope="module")
def result(tiny: Case):
    return study_case(tiny, "tiny")


# --- the ablation ---------------------------------------------------------------------------------------------------


def test_every_configuration_is_measured(result) -> None:
    assert tuple(result.rows) == names()
    for name, figures in result.rows.items():
        assert 0 <= figures["miou"] <= figures["miou_selective"] <= 100, name
        assert 0 < figures["coverage"] <= 100


def test_the_full_method_beats_backbone_and_voting(result) -> None:
    full = result.rows[FULL]
    assert full["miou"] > result.rows[BACKBONE]["miou"] + 28
    assert full["miou"] > result.rows["plain 3D voting"]["miou"] + 8
    assert full["coverage"] > 95
    assert full["risk_at_95"] < full["risk_forced"]


def test_an_ablation_replaces_parts_and_nothing_else() -> None:
    m = Mapper()
    parts = {
        "w/o local geometry": {"local_geometry", "outliers"}, "w/o terrain continuity": {"terrain"},
        "w/o object support": {"objects"}, "w/o spatial consistency": {"consistency"},
        "w/o view reliability": {"reliability"}, FULL: set(),
    }  # fmt: skip
    for name, variant in ablations(m).items():
        assert {field for field in vars(m) if getattr(m, field) != getattr(variant, field)} == parts[name]


def test_shared_memory_changes_nothing(tiny: Case, result) -> None:
    alone = study_case(tiny, "tiny", only=("w/o view reliability",))
    assert set(alone.rows) == {FULL, "w/o view reliability"}
    for name, figures in alone.rows.items():
        assert figures == pytest.approx(result.rows[name], nan_ok=True)


def test_true_classes_are_not_worse_than_erring_ones(result) -> None:
    assert result.rows[ORACLES[0]]["accuracy"] >= result.rows[FULL]["accuracy"] - 0.5


def test_without_true_points_that_oracle_has_no_figures(tiny: Case) -> None:
    found = study_case(replace(tiny, exact=None), "tiny", only=(ORACLES[1],))
    assert found.rows[ORACLES[1]] == {}


def test_an_unknown_configuration_is_refused(tiny: Case) -> None:
    with pytest.raises(InputError, match="w/o view reliability"):
        study_case(tiny, "tiny", only=("w/o reliability",))


def test_the_reference_object_is_not_among_the_measured_ones(tiny: Case, result) -> None:
    assert "machine" in {one.category for one in result.objects}
    found = study_case(replace(tiny, reference_object=1), "tiny", only=(FULL,))
    assert "machine" not in {one.category for one in found.objects}


def test_terrain_errors_of_the_tiny_site_are_centimetres(result) -> None:
    full = result.rows[FULL]
    assert full["elevation_mae"] < 0.05
    assert full["oracle_elevation_mae"] < 0.03
    assert full["elevation_ratio"] == pytest.approx(full["elevation_mae"] / full["oracle_elevation_mae"])
    assert abs(full["elevation_scale_error"]) < 1e-6


def test_a_known_shift_and_tilt_are_what_the_fit_takes_out(tiny: Case) -> None:
    x, y = (a.ravel() for a in np.meshgrid(np.arange(-8, 8, 0.4), np.arange(-8, 8, 0.4)))
    from excavatwin.evaluation.frame import true_height

    z = true_height(tiny.truth, x, y)
    found = score(np.stack([x, y, z + 0.3 + 0.01 * x], axis=-1), tiny.truth, 0.0)
    assert found.mae == pytest.approx(0.3, abs=0.02)
    assert found.fitted_mae < 1e-9


def test_heading_and_position_are_found_without_tilt_or_scale() -> None:
    rng = np.random.default_rng(1)
    p, a = rng.normal(size=(6, 3)), 0.7
    R = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    T = heading_and_position(p, p @ R.T + [4, 5, 6])
    np.testing.assert_allclose(T[:3, :3], R, atol=1e-12)
    np.testing.assert_allclose(T[:3, 3], [4, 5, 6], atol=1e-12)


# --- figures of pixels ----------------------------------------------------------------------------------------------


def test_silent_pixels_of_a_backbone_have_no_class(tiny: Case) -> None:
    found = backbone_labels(tiny)
    silent = [
        ~v.evidence.any(axis=-1)[t != NOT_OBSERVED] for v, t in zip(tiny.observations.views, tiny.labels, strict=True)
    ]
    np.testing.assert_array_equal(found.predicted == 0, np.concatenate(silent))


def test_scores_of_hand_counted_pixels() -> None:
    predicted, true = np.array([1, 1, 2, 0], np.uint8), np.array([1, 2, 2, 2], np.uint8)
    found = scores(PixelLabels(predicted, np.array([0.9, 0.2, 0.8, 0], np.float32), true))
    assert found["miou"] == pytest.approx(100 * (1 / 2 + 1 / 3) / 2)
    assert found["miou_selective"] == pytest.approx(100 * (1 / 2 + 1 / 2) / 2)
    assert found["coverage"] == 75
    assert found["accuracy"] == 50


# --- the reference object -------------------------------------------------------------------------------------------


def a_view(boxes: dict[int, tuple[int, int, int, int]], tilt: float = 0.0) -> RenderedView:
    """A level plane of 1 cm per pixel with objects: id -> row0, row1, col0, col1."""
    row, col = np.mgrid[:60, :80]
    instance = np.zeros((60, 80), np.int32)
    for number, (r0, r1, c0, c1) in boxes.items():
        instance[r0:r1, c0:c1] = number
    points = np.stack([0.01 * col, -0.01 * row, tilt * col], axis=-1).astype(np.float32)
    blank = np.zeros((60, 80), np.uint8)
    return RenderedView(np.zeros((60, 80, 3), np.uint8), np.ones((60, 80), np.float32), points, blank, instance)


def an_object(number: int, k: TaskClass = TaskClass.OBSTACLE) -> MapObject:
    return MapObject(number, k, (0, 0, 0), (1, 1, 1), 0.0, 0.0, 1.0, 1.0, np.zeros((4, 2)))


OBJECTS = (an_object(1), an_object(2, TaskClass.EXCAVATOR), an_object(3), an_object(4))
BOXES = {1: (5, 25, 5, 45), 2: (30, 58, 2, 78), 3: (5, 20, 50, 70), 4: (26, 29, 5, 9)}


def test_the_longest_well_seen_object_gives_the_scale_and_no_excavator() -> None:
    number, references = reference_object([a_view(BOXES)] * 4, list("abcd"), OBJECTS)
    assert number == 1
    assert len(references) == 3
    width, height = 40 - 1 - 2 * MARGIN, 20 - 1 - 2 * MARGIN
    for reference in references:
        assert reference.metres == pytest.approx(0.01 * np.hypot(width, height))
        (x0, y0), (x1, y1) = reference.a, reference.b
        assert min(x0, x1) == 5 + MARGIN + 0.5
        assert max(y0, y1) == 25 - MARGIN - 0.5
        assert np.hypot(x0 - x1, y0 - y1) * 0.01 == pytest.approx(reference.metres)


def test_what_is_true_of_other_objects_does_not_touch_the_references() -> None:
    before = reference_object([a_view(BOXES)] * 3, list("abc"), OBJECTS)
    view = a_view(BOXES)
    elsewhere = np.where((view.instance == 1)[..., None], view.points, view.points * 3 + 1)
    assert reference_object([replace(view, points=elsewhere)] * 3, list("abc"), OBJECTS[:2]) == before


def test_without_an_object_that_is_seen_well_there_is_no_reference() -> None:
    assert reference_object([a_view({4: BOXES[4]})] * 3, list("abc"), OBJECTS) == (0, ())
    assert reference_object([a_view({2: BOXES[2]})] * 3, list("abc"), OBJECTS) == (0, ())


def test_the_ends_are_as_far_apart_as_any_two_points() -> None:
    rng = np.random.default_rng(5)
    for _ in range(10):
        xyz = rng.normal(size=(200, 3)) * rng.uniform(0.2, 3, 3)
        i, j = ends(xyz)
        widest = np.linalg.norm(xyz[:, None] - xyz[None], axis=-1).max()
        assert np.linalg.norm(xyz[i] - xyz[j]) >= 0.99 * widest


def test_the_mappers_own_references_win(tiny: Case) -> None:
    own, told = Reference("00.jpg", (1, 1), (9, 9), 2.0), Reference("00.jpg", (1, 1), (9, 9), 3.0)
    case = replace(tiny, references=(told,))
    assert with_references(Mapper(), case).scale.references == (told,)
    assert with_references(Mapper(scale=Scale((own,))), case).scale.references == (own,)


# --- cases from files -----------------------------------------------------------------------------------------------


def test_files_give_the_same_case(tiny: Case, tmp_path: Path) -> None:
    case = case_from_files(*write_tiny_case(tmp_path))
    for ours, theirs in zip(case.labels, tiny.labels, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    np.testing.assert_allclose(case.T_M_R, np.eye(4), atol=1e-9)


def test_labels_follow_the_lattice_into_the_photo(tiny: Case) -> None:
    view, true = tiny.observations.views[0], tiny.truth.views[0]
    H, W = view.shape
    K = np.array([[60.0, 0, W], [0, 60.0, H], [0, 0, 1]])
    bent = Lattice(2 * W, 2 * H, np.array([[0.5, 0, 0], [0, 0.5, 0]]), K, (0.05, -0.01, 0.002, 0.001))
    uv = np.array([[3.5, 4.5], [40.0, 30.0], [70.0, 50.0]])
    np.testing.assert_allclose(bent.from_photo(in_photo(replace(view, lattice=bent), uv)), uv, atol=1e-6)
    plain = replace(view, lattice=replace(bent, distortion=(0, 0, 0, 0)))
    twice = replace(true, width=2 * W, height=2 * H)
    np.testing.assert_array_equal(labels_on_lattice(plain, twice), labels_on_lattice(view, true))
    assert (labels_on_lattice(view, None) == NOT_OBSERVED).all()


def test_cameras_in_one_line_fix_no_similarity(tiny: Case) -> None:
    line = tuple(
        replace(v, T_M_cam=np.block([[np.eye(3), np.array([[s], [2.0 * s], [9.0]])], [np.zeros((1, 3)), 1]]))
        for s, v in enumerate(tiny.truth.views)
    )
    assert similarity_by_cameras(tiny.observations, replace(tiny.truth, views=line)) is None
    assert similarity_by_cameras(tiny.observations, replace(tiny.truth, views=tiny.truth.views[:2])) is None


# --- finished cases -------------------------------------------------------------------------------------------------


def test_a_stopped_run_goes_on_where_it_was(tiny: Case, tmp_path: Path) -> None:
    made = []

    def make() -> Case:
        made.append(1)
        return tiny

    work = Work("tiny", "tiny", make, (1,), (BACKBONE, FULL))
    first = studied([work], tmp_path)
    again = studied([work], tmp_path)
    assert len(made) == 1
    assert again[0].objects == first[0].objects
    for name, figures in first[0].rows.items():
        assert again[0].rows[name] == pytest.approx(figures, nan_ok=True)
    assert set(studied([replace(work, only=(BACKBONE,))], tmp_path)[0].rows) == {BACKBONE, FULL}
    assert len(made) == 1
    for changed in (replace(work, facts=(2,)), replace(work, only=("plain 3D voting",))):
        studied([changed], tmp_path)
    assert len(made) == 3
    (tmp_path / "cases" / "tiny.json").write_text("{")
    studied([work], tmp_path)
    studied([work], tmp_path, Mapper(decision=replace(Mapper().decision, tau=0.3)))
    assert len(made) == 5


# --- the commands ---------------------------------------------------------------------------------------------------


def test_ablate_on_files_as_a_user_runs_it(tmp_path: Path) -> None:
    observations, truth = write_tiny_case(tmp_path)
    out = tmp_path / "out"
    words = ("ablate", observations, "--truth", truth, "--only", "plain 3D voting", "-o", out)
    done = cli(*words)
    assert done.returncode == 0, done.stderr
    assert "| plain 3D voting |" in done.stdout
    assert sorted(p.name for p in out.glob("ablation*")) == [
        "ablation.json", "ablation.md", "ablation.tex", "ablation_1.csv", "ablation_2.csv", "ablation_3.csv",
    ]  # fmt: skip
    rows = json.loads((out / "ablation.json").read_text("utf-8"))[0]["rows"]
    assert [row["configuration"] for row in rows] == ["full method", "plain 3D voting"]
    assert cli(*words, "--mapper.decision.tau", "0.99").returncode == 0
    stricter = json.loads((out / "ablation.json").read_text("utf-8"))[0]["rows"]
    assert stricter[0]["coverage [%]"] < rows[0]["coverage [%]"]


def test_bad_input_is_one_sentence(tmp_path: Path) -> None:
    observations, truth = write_tiny_case(tmp_path)
    file = tmp_path / "file"
    file.write_text("")
    known = ("ablate", observations, "--truth", truth, "-o", tmp_path / "out")
    assert "--truth" in sentence(cli("ablate", observations, "-o", tmp_path / "out"))
    assert "no configuration" in sentence(cli(*known, "--only", "nothing"))
    assert "is a file" in sentence(cli("ablate", "-o", file))
    assert "--simulated is 0" in sentence(cli("ablate", "--simulated", "0", "-o", tmp_path / "out"))
    assert f"{file} is a file" in sentence(cli("ablate", "-o", file / "inside"))
    assert "--first-seed is -1" in sentence(cli("ablate", "--first-seed", "-1", "-o", tmp_path / "out"))
    assert "no .npz file" in sentence(cli("ablate", observations, "--truth", file, "-o", tmp_path / "out"))
    assert "--backbone belongs to simulated" in sentence(cli(*known, "--backbone", "yoloe"))
    assert "exclude" in sentence(cli(*known, "--simulated", "2"))
    assert "no stage photogrammetry" in sentence(cli(*known, "--photogrammetry.lattice", "640"))
    assert "one --sites for each" in sentence(cli("tables", tmp_path, "-o", tmp_path / "out"))
    assert "nothing to measure" in sentence(cli("tables", "--simulated", "0", "-o", tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_tables_say_on_which_sites_parameters_were_chosen() -> None:
    assert read_seeds(20, None) == range(200, 220)
    assert tuple(read_seeds(20, None)) == HELD_OUT_SEEDS
    assert not set(TUNING_SEEDS) & set(HELD_OUT_SEEDS)
    assert source_of(range(119, 121)).endswith("119 to 120, on which parameters were chosen")
    assert source_of(range(200, 201)) == "simulated site with seed 200, on which nothing was tuned"


def test_views_of_other_names_are_refused(tiny: Case, tmp_path: Path) -> None:
    from excavatwin.simulation import save_truth

    observations, truth = write_tiny_case(tmp_path)
    renamed = tuple(replace(view, name=f"other_{view.name}") for view in tiny.truth.views)
    save_truth(replace(tiny.truth, views=renamed), truth)
    with pytest.raises(InputError, match=r"other_00\.jpg"):
        case_from_files(observations, truth)


def test_tables_of_given_data_as_a_user_runs_it(dataset: tuple[Path, Path], tmp_path: Path) -> None:  # noqa: F811
    folder, sites = dataset
    done = cli("tables", folder, "--sites", sites, "--simulated", "0", "-o", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    geometry = json.loads((tmp_path / "out" / "tables.json").read_text("utf-8"))[0]["rows"]
    terrain = next(row for row in geometry if row["task"] == "Terrain elevation" and row["data set"] == "OCES")
    assert terrain["paper: MAE [cm]"] == 12.61
    assert 1 < terrain["ours: MAE [cm]"] < 10


@pytest.mark.slow
def test_on_a_simulated_site_the_method_beats_plain_voting() -> None:
    case = simulated_case(101, "mask2former", views=8, width=259)
    assert case.references
    found = study_case(case, "mask2former", only=(BACKBONE, "plain 3D voting"))
    full = found.rows[FULL]
    assert full["miou"] > found.rows["plain 3D voting"]["miou"]
    assert full["miou"] > found.rows[BACKBONE]["miou"] + 10
    assert abs(full["elevation_scale_error"]) < 5
    assert full["elevation_fitted_ratio"] < 1.5
