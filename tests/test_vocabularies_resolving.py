"""A model's own class names become weights for the task classes, and no class is dropped in silence."""

from __future__ import annotations

import random

import numpy as np
import pytest

from excavatwin.errors import InputError
from excavatwin.vocabularies import parse_remap, read_vocabulary, resolve, shipped_vocabularies

CT, OT, RC, EX, OB = np.eye(5, dtype=np.float32)
OWN = """
policy = "mine"
no_surface = ["haze"]
otherwise = { obstacle = 0.25 }
[classes]
spoil = "construction_terrain"
haze = "nothing"
"""


def names_of(vocabulary: str) -> list[str]:
    return list(read_vocabulary(vocabulary).classes)


@pytest.mark.parametrize("name", shipped_vocabularies())
def test_the_mapping_of_exactly_these_classes_is_chosen_whatever_their_order(name):
    names = names_of(name)
    random.Random(0).shuffle(names)
    found = resolve(names)
    assert (found.mapping, found.policy) == (name, read_vocabulary(name).policy)
    np.testing.assert_array_equal(found.weights, read_vocabulary(name).matrix(names))


def test_among_several_that_cover_the_smallest_is_chosen():
    assert resolve(["road", "sky"]).mapping == "cityscapes"
    assert resolve(["grass", "sky"]).mapping == "rellis-3d"
    assert resolve(["excavator"]).mapping == "task"
    assert resolve(["excavator", "soil", "sky"]).mapping == "worksite"


def test_channels_keep_the_order_of_the_model():
    found = resolve(["Sky", "heavy_machinery", "rock", "water"], "goose-64:strict")
    np.testing.assert_array_equal(found.weights, [0 * CT, EX, CT, 0 * CT])
    assert found.no_surface.tolist() == [True, False, False, True]
    assert (found.mapping, found.policy) == ("goose-64", "strict")
    assert found.weights.dtype == np.float32


def test_another_policy_of_the_chosen_mapping():
    found = resolve(names_of("goose-64"), ":strict")
    assert (found.mapping, found.policy) == ("goose-64", "strict")
    with pytest.raises(InputError, match="no policy 'lenient'"):
        resolve(names_of("goose-64"), ":lenient")


def test_all_unmapped_classes_are_listed():
    with pytest.raises(InputError) as refused:
        resolve(["grass", "sphagnum", "tree", "zeppelin", "sheet pile"], "goose-64")
    message = str(refused.value)
    assert "goose-64 says nothing about 5 of 5: 'grass', 'sphagnum', 'tree', 'zeppelin', 'sheet pile'" in message
    with pytest.raises(InputError, match=r"nearest, rellis-3d, has no line for 2 of 4: 'sphagnum', 'zeppelin'") as r:
        resolve(["grass", "sphagnum", "tree", "zeppelin"])
    assert '--map "sphagnum=TASK_CLASS"' in str(r.value)


def test_the_users_own_lines_stand_above_the_mapping():
    remap = parse_remap(["sphagnum=construction_terrain", "zeppelin=nothing", "grass=other_terrain:0.5+obstacle:0.5"])
    found = resolve(["grass", "sphagnum", "tree", "zeppelin"], remap=remap)
    np.testing.assert_array_equal(found.weights, [(OT + OB) / 2, CT, RC, 0 * CT])
    assert found.policy == (
        "diggable; grass=other_terrain:0.5+obstacle:0.5; sphagnum=construction_terrain; zeppelin=nothing"
    )


def test_a_remapped_class_does_not_hide_which_mapping_is_meant():
    assert resolve(names_of("cityscapes"), remap={"truck": "excavator"}).mapping == "cityscapes"


def test_a_class_is_remapped_by_its_first_synonym_too():
    found = resolve(["earth, ground", "sky"], "ade20k-150", {"earth": "other_terrain"})
    np.testing.assert_array_equal(found.weights, [OT, 0 * OT])


def test_a_sky_that_the_user_remaps_is_a_surface():
    assert resolve(["sky", "road"], remap={"sky": "obstacle"}).no_surface.tolist() == [False, False]


def test_classes_may_all_be_the_users_own():
    found = resolve(["a", "b"], remap={"a": "excavator", "b": "nothing"})
    assert (found.mapping, found.policy) == ("own", "own; a=excavator; b=nothing")
    np.testing.assert_array_equal(found.weights, [EX, 0 * EX])


def test_misspelt_remaps_name_the_nearest_class():
    with pytest.raises(InputError, match=r"'gravl' \(did you mean 'gravel'\?\), 'xyz', which are not among the 2"):
        resolve(["gravel", "road"], "goose-64", {"gravl": "obstacle", "xyz": "obstacle"})
    with pytest.raises(InputError, match="'xyz', which is not among the 2 classes of the model: gravel, road"):
        resolve(["gravel", "road"], "goose-64", {"xyz": "obstacle"})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("gravel", "is not NAME=TASK_CLASS"),
        ("=obstacle", "is not NAME=TASK_CLASS"),
        ("gravel=constuction_terrain", "'constuction_terrain' is not a task class"),
        ("gravel=obstacle:0.5+nothing:0.5", "'nothing' is not a task class"),
        ("gravel=obstacle:0.5+excavator", "'excavator' has no weight"),
        ("gravel=obstacle:half", "'obstacle:half' has no weight"),
        ("gravel=obstacle:2", "weight of 'gravel' is 2"),
        ("gravel=obstacle:0.7+excavator:0.7", "sum to 1.4"),
        (["gravel=obstacle", "Gravel=nothing"], "speaks of 'Gravel' twice"),
    ],
)
def test_bad_remaps(text, message):
    with pytest.raises(InputError, match=message):
        resolve(["gravel"], "goose-64", parse_remap(text))


def test_otherwise_is_explicit_and_told(tmp_path):
    (tmp_path / "own.toml").write_text(OWN)
    found = resolve(["spoil", "lamp", "haze", "vase"], str(tmp_path / "own.toml"))
    np.testing.assert_array_equal(found.weights, [CT, OB / 4, 0 * OB, OB / 4])
    assert found.otherwise == ("lamp", "vase")
    assert found.sentence() == "4 classes by the mapping own (mine); 2 by its 'otherwise': lamp, vase."
    assert resolve(["spoil"], str(tmp_path / "own.toml")).otherwise == ()


def test_with_a_vocabulary_otherwise_holds_for_its_classes_only(tmp_path):
    (tmp_path / "own.toml").write_text('vocabulary = ["lamp, light", "spoil", "haze"]\n' + OWN)
    vocabulary = read_vocabulary(tmp_path / "own.toml")
    assert vocabulary.names == {0: "lamp, light", 1: "spoil", 2: "haze"}
    assert resolve(["lamp", "spoil"], str(tmp_path / "own.toml")).otherwise == ("lamp",)
    with pytest.raises(InputError, match="says nothing about 1 of 2: 'vase'"):
        resolve(["vase", "lamp"], str(tmp_path / "own.toml"))
    (tmp_path / "own.toml").write_text('vocabulary = ["spoil", "lamp"]\n' + OWN)
    with pytest.raises(InputError, match=r"\[classes\] maps 'haze', which is not in vocabulary"):
        read_vocabulary(tmp_path / "own.toml")


def test_first_synonyms_of_two_meanings_are_nobodys(tmp_path):
    lines = ('"plant, flora" = "removable_cover"', '"plant, works" = "obstacle"', '"bush, shrub" = "removable_cover"')
    (tmp_path / "own.toml").write_text("\n".join(("[classes]", *lines)))
    found = resolve(["plant, works", "plant, flora", "bush"], str(tmp_path / "own.toml"))
    np.testing.assert_array_equal(found.weights, [OB, RC, RC])
    with pytest.raises(InputError, match="says nothing about 1 of 1: 'plant'"):
        resolve(["plant"], str(tmp_path / "own.toml"))


def test_evidence_is_bounded_and_missing_mass_stays_missing():
    found = resolve(["gravel", "low_grass", "sky"], "goose-64")
    p = np.array([[[0.2, 0.3, 0.1], [0.7, 0.7, 0.0], [0.1, 0.0, 0.6]]], np.float32)
    np.testing.assert_allclose(found.evidence(p)[0, 0], [0.2, 0, 0.3, 0, 0])
    np.testing.assert_allclose(found.evidence(p)[0, 1], [0.5, 0, 0.5, 0, 0])
    assert found.surfaceless(p).tolist() == [[False, False, True]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('no_surface = ["sea"]\n[classes]\na = "nothing"', "no_surface names 'sea', which is not in"),
        ('[classes]\na = "nothing"\n[colours]\na = [1, 2]', r"colour of 'a' is \[1, 2\]"),
        ('[classes]\na = "nothing"\n[colours]\nb = [1, 2, 3]', r"\[colours\] paints 'b'"),
        ("[classes]\na = { obstacle = 0.7, excavator = 0.7 }", "weights of 'a' sum to 1.4"),
        ('vocabulary = ["a", "b"]\n[classes]\na = "nothing"', "vocabulary has 'b', which"),
        ('ids = [3, 3]\n[classes]\na = "nothing"\nb = "nothing"', "one id to two classes"),
    ],
)
def test_bad_keys_of_mapping_files(text, message, tmp_path):
    (tmp_path / "own.toml").write_text(text)
    with pytest.raises(InputError, match=message):
        read_vocabulary(tmp_path / "own.toml")


# --- the shipped ones -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", shipped_vocabularies())
def test_sky_and_water_never_vote(name):
    vocabulary = read_vocabulary(name)
    silent = [n for n in vocabulary.classes if not vocabulary.matrix([n]).any()]
    wet = [n for n in vocabulary.classes if set(n.lower().replace("-", " ").split()) & {"sky", "sea", "lake", "river"}]
    wet = [n for n in wet if n not in ("sea star", "river boat")]
    assert set(wet) <= set(silent)
    assert vocabulary.surfaceless(wet).all()
    assert not vocabulary.matrix([n for n in vocabulary.classes if vocabulary.surfaceless([n])[0]] or ["sky"][:0]).any()


def test_tags_of_a_prompt_free_model_are_told_apart_from_those_that_have_no_line():
    tags = [*names_of("yoloe-tags"), "wedding cake", "beautiful"]
    found = resolve(tags)
    assert (found.mapping, found.otherwise) == ("yoloe-tags", ("wedding cake", "beautiful"))
    assert found.weights[tags.index("excavator")].tolist() == EX.tolist()
    with pytest.raises(InputError, match="has no line for 2 of 3: 'wedding cake', 'beautiful'"):
        resolve(["excavator", "wedding cake", "beautiful"])


def test_lvis_names_of_detectron_and_of_ultralytics_are_one_class():
    names = ["bow_(decorative_ribbons)", "power_shovel", "power shovel/dredge", "dumpster"]
    np.testing.assert_array_equal(resolve(names, "lvis-v1").weights, [OB / 4, EX, EX, OB])
    assert resolve(names, "lvis-v1").otherwise == ("bow_(decorative_ribbons)",)


@pytest.mark.parametrize("name", ["goose-64", "rellis-3d", "cityscapes", "mapillary-vistas"])
def test_palettes_are_whole_and_name_one_vote_each(name):
    vocabulary = read_vocabulary(name)
    assert set(vocabulary.colours) == {vocabulary.key(n) for n in vocabulary.classes}
    votes: dict = {}
    for key, colour in vocabulary.colours.items():
        assert votes.setdefault(colour, vocabulary.mapping.weights[key]) == vocabulary.mapping.weights[key]


def test_one_colour_for_two_votes_is_refused(tmp_path):
    text = '[classes]\na = "obstacle"\nb = "excavator"\n[colours]\na = [1, 2, 3]\nb = [1, 2, 3]\n'
    (tmp_path / "own.toml").write_text(text)
    with pytest.raises(InputError, match=r"'b' has the colour \[1, 2, 3\] of a class that votes otherwise"):
        read_vocabulary(tmp_path / "own.toml")
