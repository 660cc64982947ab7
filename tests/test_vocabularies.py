"""Labels in other vocabularies become evidence for the task classes."""

from __future__ import annotations

import numpy as np
import pytest

from excavatwin.errors import InputError, ObservationError
from excavatwin.exchange import load_observations
from excavatwin.scene.taxonomy import TaskClass
from excavatwin.vocabularies import canonical, read_vocabulary, shipped_vocabularies
from site_example import example_observations
from test_exchange_roundtrip import plain

SIZES = {
    "ade20k-150": 150,
    "ade20k-full": 847,
    "cityscapes": 19,
    "coco-panoptic": 133,
    "goose-64": 64,
    "lvis-v1": 1203,
    "mapillary-vistas": 66,
    "mapillary-vistas-2": 124,
    "rellis-3d": 20,
    "task": 6,
    "worksite": 0,
    "yoloe-tags": 0,
}


@pytest.fixture(scope="module")
def contract():
    return plain(example_observations())


def labelled(contract, path, labels, **more):
    arrays = {key: array for key, array in contract.items() if key != "evidence"}
    np.savez(path, **arrays, labels=labels, **more)
    return path


def ids(values, shape=(2, 40, 60), dtype=np.uint8):
    """A label image that holds each of the values."""
    return np.resize(np.array(values, dtype), shape)


def test_shipped_vocabularies_are_whole():
    assert dict.fromkeys(shipped_vocabularies()) == dict.fromkeys(SIZES)
    for name, size in SIZES.items():
        vocabulary = read_vocabulary(name)
        assert len(vocabulary.names) == size
        assert vocabulary.mapping.name == name
        M = vocabulary.matrix(vocabulary.classes)
        assert M.shape == (len(vocabulary.classes), 5)
        assert size in (0, len(vocabulary.classes))
        assert M.min() >= 0
        assert M.sum(1).max() <= 1


@pytest.mark.parametrize(
    ("vocabulary", "i", "name", "expected"),
    [
        ("ade20k-150", 13, "earth, ground", {TaskClass.CONSTRUCTION_TERRAIN: 1}),
        ("ade20k-150", 2, "sky", {}),
        ("ade20k-150", 8, "windowpane", {TaskClass.OBSTACLE: 1}),
        ("coco-panoptic", 126, "dirt-merged", {TaskClass.CONSTRUCTION_TERRAIN: 1}),
        ("coco-panoptic", 130, "rock-merged", {TaskClass.OBSTACLE: 0.5, TaskClass.CONSTRUCTION_TERRAIN: 0.5}),
        ("cityscapes", 8, "vegetation", {TaskClass.REMOVABLE_COVER: 1}),
        ("goose-64", 57, "heavy_machinery", {TaskClass.EXCAVATOR: 1}),
        ("rellis-3d", 34, "rubble", {TaskClass.CONSTRUCTION_TERRAIN: 1}),
        ("ade20k-full", 456, "excavator", {TaskClass.EXCAVATOR: 1}),
        ("ade20k-full", 118, "land, ground, soil", {TaskClass.CONSTRUCTION_TERRAIN: 1}),
        ("ade20k-full", 14, "car, auto, automobile, machine, motorcar", {TaskClass.OBSTACLE: 1}),
        ("ade20k-full", 28, "shelf", {TaskClass.OBSTACLE: 0.25}),
        ("mapillary-vistas", 29, "Terrain", {TaskClass.CONSTRUCTION_TERRAIN: 0.5, TaskClass.REMOVABLE_COVER: 0.5}),
        ("mapillary-vistas", 65, "Unlabeled", {}),
        ("mapillary-vistas-2", 121, "Ground", {TaskClass.CONSTRUCTION_TERRAIN: 0.5, TaskClass.OTHER_TERRAIN: 0.5}),
        ("lvis-v1", 841, "power_shovel", {TaskClass.EXCAVATOR: 1}),
        ("lvis-v1", 0, "aerosol can/spray can", {TaskClass.OBSTACLE: 0.25}),
        ("task", 4, "excavator", {TaskClass.EXCAVATOR: 1}),
    ],
)
def test_known_rows(vocabulary, i, name, expected):
    found = read_vocabulary(vocabulary)
    assert found.mapping.weights[canonical(name)] == expected
    assert found.mapping.weights[canonical(found.names[i])] == expected


def test_task_labels_need_no_mapping(contract, tmp_path):
    labels = ids([0, 1, 2, 3, 4, 5, 255])
    scores = np.full(labels.shape, 0.25, np.float32)
    view = load_observations(labelled(contract, tmp_path / "a.npz", labels, scores=scores)).views[0]
    for k in range(1, 6):
        assert (view.evidence[labels[0] == k] == 0.25 * np.eye(5)[k - 1]).all()
    assert (view.evidence[np.isin(labels[0], (0, 255))] == 0).all()


def test_named_vocabulary_in_any_order(contract, tmp_path):
    path = labelled(contract, tmp_path / "a.npz", ids([0, 1, 2]), vocabulary=["sky", "Tree", "earth, ground"])
    with pytest.raises(InputError, match=r"no class mapping .*'ade20k-150' covers it"):
        load_observations(path)
    loaded = load_observations(path, mapping="ade20k-150")
    labels = ids([0, 1, 2])[0]
    np.testing.assert_array_equal(loaded.views[0].evidence[labels == 1][0], [0, 0, 1, 0, 0])
    np.testing.assert_array_equal(loaded.views[0].evidence[labels == 2][0], [1, 0, 0, 0, 0])
    assert loaded.views[0].evidence[labels == 0].max() == 0
    assert loaded.source == {"class_mapping": "ade20k-150", "class_mapping_policy": "diggable"}


def test_ids_of_a_mapping_without_a_vocabulary(contract, tmp_path):
    path = labelled(contract, tmp_path / "a.npz", ids([34, 4]), class_mapping="rellis-3d")
    view = load_observations(path).views[0]
    np.testing.assert_array_equal(view.evidence[0, 0], [1, 0, 0, 0, 0])
    np.testing.assert_array_equal(view.evidence[0, 1], [0, 0, 1, 0, 0])
    path = labelled(contract, tmp_path / "b.npz", ids([2]), class_mapping="rellis-3d")
    with pytest.raises(ObservationError, match=r"labels holds 2 .*ids of the mapping 'rellis-3d'"):
        load_observations(path)


def test_evidence_of_a_vocabulary_is_merged_by_summing(contract, tmp_path):
    raw = np.random.default_rng(0).random((2, 40, 60, 3)).astype(np.float32)
    arrays = {**contract, "evidence": raw, "vocabulary": ["grass", "tree", "mountain"], "class_mapping": "ade20k-150"}
    np.savez(tmp_path / "a.npz", **arrays)
    evidence = load_observations(tmp_path / "a.npz").views[1].evidence
    np.testing.assert_allclose(evidence[..., 2], raw[1, ..., 0] + raw[1, ..., 1], rtol=1e-6)
    np.testing.assert_allclose(evidence[..., 0], raw[1, ..., 2] / 2, rtol=1e-6)


def test_a_mapping_of_my_own(contract, tmp_path):
    own = tmp_path / "own.toml"
    own.write_text('policy = "mine"\n[classes]\nratchet = "excavator"\nzeppelin = { construction_terrain = 0.7 }\n')
    path = labelled(contract, tmp_path / "a.npz", ids([1, 0]), vocabulary=["ratchet", "zeppelin"])
    with pytest.raises(InputError, match="foreign classes: 'ratchet', 'zeppelin'"):
        load_observations(path)
    loaded = load_observations(path, mapping=own)
    np.testing.assert_allclose(loaded.views[0].evidence[0, 0], [0.7, 0, 0, 0, 0])
    assert loaded.source == {"class_mapping": "own", "class_mapping_policy": "mine"}
    path = labelled(contract, tmp_path / "b.npz", ids([2]), vocabulary=["ratchet", "zeppelin", "crane"])
    with pytest.raises(InputError, match="says nothing about 1 of 3: 'crane'"):
        load_observations(path, mapping=own)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[classes", "not valid TOML"),
        ("name = 'x'", r"no table \[classes\]"),
        ('[classes]\na = "excavater"', "'excavater' is not a task class"),
        ("[classes]\na = 3", 'needs "task_class"'),
        ("[classes]\na = { excavator = 2 }", "weight of 'a' is 2"),
        ('[classes]\na = "nothing"\nA = "nothing"', "names 'A' twice"),
        ('ids = [1]\n[classes]\na = "nothing"\nb = "nothing"', "1 ids for 2 classes"),
        ('[classes]\na = "nothing"\n[aliases]\nb = "c"', "alias 'b' stands for 'c'"),
    ],
)
def test_bad_mapping_files(text, message, tmp_path):
    (tmp_path / "own.toml").write_text(text)
    with pytest.raises(InputError, match=message):
        read_vocabulary(tmp_path / "own.toml")


def test_unknown_mapping_lists_the_shipped_ones():
    with pytest.raises(
        InputError, match="neither a readable TOML file nor one of the shipped ones: ade20k-150, ade20k-full, city"
    ):
        read_vocabulary("ade")


# --- policies -------------------------------------------------------------------------------------------------------

STRICT = {
    "goose-64": {"gravel": 2, "low grass": 2, "rock": 1, "debris": 5},
    "rellis-3d": {"grass": 2, "rubble": 5, "log": 5},
    "ade20k-150": {"grass": 2, "rock": 1},
    "lvis-v1": {"log": 5, "garbage": 5},
    "coco-panoptic": {"gravel": 2, "grass-merged": 2, "rock-merged": 1},
}


@pytest.mark.parametrize("name", STRICT)
def test_the_strict_policy_differs_where_it_says(name):
    diggable, strict = read_vocabulary(name), read_vocabulary(name, policy="strict")
    assert (diggable.policy, strict.policy) == ("diggable", "strict")
    assert diggable.names == strict.names
    other = {c: w for c, w in strict.mapping.weights.items() if w != diggable.mapping.weights[c]}
    assert other == {c: {TaskClass(k): 1.0} for c, k in STRICT[name].items()}
    assert read_vocabulary(f"{name}:strict").mapping.weights == strict.mapping.weights
    assert read_vocabulary(f"{name}:diggable").mapping.weights == diggable.mapping.weights


def test_the_policy_reaches_evidence_and_provenance(contract, tmp_path):
    path = labelled(contract, tmp_path / "a.npz", ids([24]))  # gravel
    loaded = load_observations(path, mapping="goose-64:strict")
    np.testing.assert_array_equal(loaded.views[0].evidence[0, 0], [0, 1, 0, 0, 0])
    assert loaded.source == {"class_mapping": "goose-64", "class_mapping_policy": "strict"}


def test_the_policy_reaches_a_site_from_the_command_line(tmp_path):
    import json

    from excavatwin.cli import main
    from test_cli import observations

    labels = np.full((3, 48, 64), 24, np.uint8)  # gravel
    file = observations(tmp_path / "o.npz", evidence=None, labels=labels)
    for policy, task_class in (("diggable", 1), ("strict", 2)):
        site = tmp_path / policy
        assert main(["fuse", str(file), "-o", str(site), "--class-mapping", f"goose-64:{policy}"]) == 0
        assert f'"class_mapping_policy": "{policy}"' in json.dumps(json.loads((site / "run.json").read_text()))
        from PIL import Image

        seen = np.unique(np.array(Image.open(site / "labels" / "view_000.png")))
        assert task_class in seen
        assert 3 - task_class not in seen


def test_unknown_policies_are_refused(tmp_path):
    with pytest.raises(InputError, match="no policy 'lenient'; it has: diggable, strict"):
        read_vocabulary("goose-64:lenient")
    with pytest.raises(InputError, match="no policy 'strict'; it has: identity"):
        read_vocabulary("task", policy="strict")
    with pytest.raises(InputError, match="asked for policy 'strict' and for 'diggable'"):
        read_vocabulary("goose-64:strict", policy="diggable")
    own = tmp_path / "own.toml"
    own.write_text('[classes]\na = "obstacle"\n[policies.mine]\nb = "excavator"\n')
    with pytest.raises(InputError, match=r"\[policies.mine\] maps 'b'"):
        read_vocabulary(own, policy="mine")
    own.write_text('[classes]\na = "obstacle"\n[policies.mine]\na = "excavator"\n')
    assert read_vocabulary(f"{own}:mine").mapping.weights["a"] == {TaskClass.EXCAVATOR: 1.0}
