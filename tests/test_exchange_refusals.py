"""Every way to break the contract is refused with the view, the numbers and the remedy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from excavatwin.errors import ObservationError
from excavatwin.exchange import load_observations
from site_example import example_observations
from test_exchange_roundtrip import plain

Arrays = dict[str, Any]
CONTRACT = ("points", "confidence", "evidence", "T_world_cam", "K")


@pytest.fixture(scope="module")
def contract():
    return plain(example_observations())


def put(key: str, index: Any, value: Any) -> Callable[[Arrays], None]:
    def change(arrays: Arrays) -> None:
        arrays[key][index] = value

    return change


def make(**changes: Callable[[Arrays], Any]) -> Callable[[Arrays], None]:
    def change(arrays: Arrays) -> None:
        for key, of in changes.items():
            arrays[key] = of(arrays)

    return change


def drop(key: str) -> Callable[[Arrays], None]:
    return lambda arrays: arrays.pop(key)


def labelled(of: Callable[[Arrays], Any]) -> Callable[[Arrays], None]:
    def change(arrays: Arrays) -> None:
        labels = of(arrays)
        del arrays["evidence"]
        arrays["labels"] = labels

    return change


def mirrored(arrays: Arrays) -> np.ndarray:
    T = arrays["T_world_cam"].copy()
    T[0, :3, 0] *= -1
    return T


REFUSALS = {
    "no points": (drop("points"), r"has no 'points'; it has: confidence, evidence, T_world_cam, K"),
    "no pose": (drop("T_world_cam"), r"has no 'T_world_cam'"),
    "no semantics": (drop("evidence"), r"has no 'evidence' or 'labels'"),
    "one view": (make(points=lambda a: a["points"][0]), r"points has shape \(40, 60, 3\); expected \(S, H, W, 3\)"),
    "fewer": (make(K=lambda a: a["K"][:1]), r"K has shape \(1, 3, 3\) but points has 2 views"),
    "channels first": (
        make(points=lambda a: a["points"].transpose(0, 3, 1, 2)),
        r"view 0 .*points has shape \(3, 40, 60\); expected \(H, W, 3\)",
    ),
    "text": (make(K=lambda a: a["K"].astype(str)), r"view 0 .*K has dtype <U.*; expected real numbers"),
    "infinite": (
        put("points", (1, 2, 3), np.inf),
        r"view 1 .*an infinite coordinate at 1 pixel, first at row 2, column 3",
    ),
    "far away": (
        make(
            points=lambda a: a["points"] + np.array([0, 4.4e6, 0]),
            T_world_cam=lambda a: a["T_world_cam"] + np.array([[0, 0, 0, 0], [0, 0, 0, 4.4e6], [0] * 4, [0] * 4]),
        ),
        r"float32 keeps steps of 0\.5 only.*subtract a common origin",
    ),
    "small confidence": (
        make(confidence=lambda a: a["confidence"][:, ::2]),
        r"confidence has shape \(20, 60\) but its points are 40 x 60",
    ),
    "swapped": (make(confidence=lambda a: a["confidence"].transpose(0, 2, 1)), r"rows and columns are swapped"),
    "nan confidence": (
        make(confidence=lambda a: a["confidence"] * np.nan),
        r"confidence is not finite at \d+ pixels that have a point",
    ),
    "negative": (
        put("confidence", (1, 39, 59), -0.25),
        r"view 1 .*is negative at 1 pixel \(down to -0.25\)",
    ),
    "logits": (put("evidence", (0, 39, 0, 2), -4), r"evidence is negative.*logits need exp or sigmoid"),
    "six channels": (
        make(evidence=lambda a: np.zeros((2, 40, 60, 6))),
        r"evidence has shape \(40, 60, 6\).*expected \(40, 60, 5\)",
    ),
    "short pose": (make(T_world_cam=lambda a: a["T_world_cam"][:, :3]), r"shape \(3, 4\); expected \(4, 4\); append"),
    "nan pose": (put("T_world_cam", (0, 1, 1), np.nan), r"view 0 .*T_world_cam is not finite"),
    "transposed pose": (
        make(T_world_cam=lambda a: a["T_world_cam"].transpose(0, 2, 1)),
        r"last row of T_world_cam is .*transposed \(row-vector convention\)",
    ),
    "sheared": (put("T_world_cam", (1, 0, 0), 3), r"view 1 .*rotation of T_world_cam is off by .*orthonormal"),
    "scaled": (
        make(T_world_cam=lambda a: a["T_world_cam"] * [[2.0], [2], [2], [1]]),
        r"it is a rotation times 2: scale the translations",
    ),
    "left-handed": (make(T_world_cam=mirrored), r"determinant -1.000, a mirror: the axes are left-handed"),
    "transposed K": (
        make(K=lambda a: a["K"].transpose(0, 2, 1)),
        r"last row of K is 30 20 1; expected 0 0 1; it is",
    ),
    "normalised K": (make(K=lambda a: a["K"] / [[60.0], [40], [1]]), r"normalised by the image size"),
    "negative focal": (put("K", (0, 0, 0), -50), r"focal lengths -50"),
    "huge K": (make(K=lambda a: a["K"] * [[9.0], [9], [1]]), r"does not fit an image of 60 x 40 px"),
    "names": (make(names=lambda a: np.array(["a", "a"])), r"views 0 and 1 are both named 'a'"),
    "numbered": (make(names=lambda a: np.array([1, 2])), r"expected names to be \(S,\) strings"),
    "float image": (make(images=lambda a: np.zeros((2, 40, 60, 3))), r"images has dtype float64; expected uint8"),
    "up": (make(up=lambda a: np.zeros(3)), r"up is .*expected three finite numbers"),
    "scale": (make(metres_per_unit=lambda a: np.array(-1.0)), r"metres_per_unit is -1.0; expected one positive"),
    "label 7": (
        labelled(lambda a: np.full((2, 40, 60), 7, np.uint8)),
        r"view 0 .*labels holds 7 at 2400 pixels.*expected task class ids 0..5, or 255",
    ),
    "soft labels": (labelled(lambda a: np.zeros((2, 40, 60))), r"labels has dtype float64; expected whole numbers"),
    "mask size": (
        labelled(lambda a: np.ones((2, 20, 30), np.uint8)),
        r"labels is 20 x 30 but its points are 40 x 60 pixels; segment the same lattice",
    ),
    "no view": (make(**{k: lambda a, k=k: a[k][:0] for k in CONTRACT}), r"holds no view"),
    "provenance": (make(provenance=lambda a: np.array('{"georeference": 3}')), r"provenance .* is not what ExcavaTwin"),
}


@pytest.mark.parametrize("name", REFUSALS)
def test_refused(name, contract, tmp_path):
    change, message = REFUSALS[name]
    arrays = {key: array.copy() for key, array in contract.items()}
    change(arrays)
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(ObservationError, match=message):
        load_observations(tmp_path / "a.npz")


def test_the_first_wrong_view_is_named(contract, tmp_path):
    arrays = {key: array.copy() for key, array in contract.items()}
    arrays["confidence"][1, 0, 0] = -1
    arrays["points"][0, 0, 0] = np.inf
    np.savez(tmp_path / "a.npz", **arrays, names=["a.jpg", "b.jpg"])
    with pytest.raises(ObservationError, match=r"^view 0 \('a.jpg'\): points has an infinite coordinate"):
        load_observations(tmp_path / "a.npz")


def test_not_a_file(tmp_path):
    with pytest.raises(ObservationError, match="there is no observations file"):
        load_observations(tmp_path / "none.npz")
    (tmp_path / "text.npz").write_text("hello")
    with pytest.raises(ObservationError, match=r"is not an \.npz file|never unpickled"):
        load_observations(tmp_path / "text.npz")
    np.save(tmp_path / "one.npy", np.zeros(3))
    with pytest.raises(ObservationError, match="holds a single array"):
        load_observations(tmp_path / "one.npy")
    with pytest.raises(ObservationError, match=r"has no views\.json"):
        load_observations(tmp_path)


def test_a_cut_off_file(contract, tmp_path):
    np.savez(tmp_path / "a.npz", **contract)
    whole = (tmp_path / "a.npz").read_bytes()
    (tmp_path / "a.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ObservationError, match="damaged"):
        load_observations(tmp_path / "a.npz")


def test_objects_are_never_unpickled(contract, tmp_path):
    np.savez(tmp_path / "a.npz", **{**contract, "names": np.array(["a", None], object)})
    with pytest.raises(ObservationError, match="never unpickled"):
        load_observations(tmp_path / "a.npz")


def test_a_folder_that_lists_what_is_not_there(tmp_path):
    (tmp_path / "views.json").write_text('{"views": [{"name": "a", "file": "a.npz"}]}')
    with pytest.raises(ObservationError, match=r"view 0 names the file 'a.npz', which is not in"):
        load_observations(tmp_path)
    (tmp_path / "views.json").write_text("{")
    with pytest.raises(ObservationError, match="not valid JSON"):
        load_observations(tmp_path)


def test_keys_that_are_not_read_are_said(contract, tmp_path):
    spare = {"metre_per_unit": 0.5, "labels": np.ones(contract["points"].shape[:3], np.uint8)}
    np.savez(tmp_path / "a.npz", **(contract | spare))
    doubts = load_observations(tmp_path / "a.npz").doubts
    assert any("metre_per_unit" in doubt and "misspelt" in doubt for doubt in doubts)
    assert any("labels were not used" in doubt for doubt in doubts)
