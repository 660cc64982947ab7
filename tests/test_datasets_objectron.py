"""Objectron from its bytes: wire format, cameras of an upright phone, boxes, and what is wrong with some clips."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import objectron_example
from excavatwin.datasets import examine, open_dataset
from excavatwin.datasets.wire_format import Message, split_stream
from excavatwin.errors import InputError
from excavatwin.scene.frames import project
from excavatwin.scene.taxonomy import TaskClass
from objectron_example import counted, double, integer, loose, packed, single


def test_examples_of_the_format_s_own_documentation() -> None:
    assert Message(bytes.fromhex("089601")).integer(1) == 150
    assert Message(bytes.fromhex("120774657374696e67")).text(2) == "testing"
    assert Message(bytes.fromhex("1a03089601")).message(3).integer(1) == 150
    assert Message(b"").integer(1, 7) == 7
    assert Message(b"").message(3).text(1) == ""


@settings(deadline=None, max_examples=60)
@given(
    st.integers(-(2**31), 2**31 - 1),
    st.floats(width=64, allow_nan=False),
    st.lists(st.floats(width=32, allow_nan=False), max_size=40),
    st.text(max_size=200),
    st.booleans(),
)
def test_wire_format_round_trip(number: int, real: float, many: list[float], text: str, packs: bool) -> None:
    values = (packed if packs else loose)(20, np.array(many, np.float32))
    content = integer(1, number) + double(2, real) + values + counted(300, text.encode()) + single(5, 0.5)
    message = Message(content)
    assert message.integer(1) == number
    assert message.number(2) == real
    assert message.number(5) == 0.5
    assert message.floats(20).tolist() == np.array(many, np.float32).tolist()
    assert message.text(300) == text
    assert split_stream(b"".join(struct.pack("<I", len(content)) + content for _ in range(3))) == [content] * 3
    for end in (len(content) - 1, len(content) - 3):  # cut inside the last field, a float
        with pytest.raises(InputError, match=r"cut off|no protocol buffer"):
            Message(content[:end])


@pytest.mark.parametrize("content", [b"\x0b", b"\x80", b"\x0a\x05abc", b"\xff" * 12])
def test_what_is_no_protocol_buffer_is_refused(content: bytes) -> None:
    with pytest.raises(InputError, match=r"cut off|no protocol buffer"):
        Message(content)


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    root = objectron_example.write(tmp_path_factory.mktemp("objectron"), video=True)
    return open_dataset(root)


@pytest.mark.parametrize(
    "form",
    [{}, {"packing": loose}, {"columns_first": True}, {"landscape": True}],
    ids=["as is", "loose", "columns", "wide"],
)
def test_boxes_fall_on_their_drawn_corners(tmp_path, form) -> None:
    """The world's box, through our cameras, meets the corners that OpenGL's projection drew."""
    dataset = open_dataset(objectron_example.write(tmp_path, **form))
    recording = dataset.recording("chair/batch-3/12")
    assert recording.doubts == ()
    landscape = form.get("landscape", False)
    known = recording.objects[0]
    half = np.array(known.size) / 2
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    ours = (signs * half) @ known.T_W_object[:3, :3].T + known.T_W_object[:3, 3]
    R = objectron_example.box_rotation()
    corners = (objectron_example.UNIT[1:] * objectron_example.SIZE) @ R.T + objectron_example.CENTRE
    for k, frame in enumerate(recording.frames):
        assert frame.size == (objectron_example.SENSOR if landscape else objectron_example.SENSOR[::-1])
        uv, depth = project(frame.K_cam, frame.T_W_cam, ours)
        drawn = objectron_example.drawn(corners, objectron_example.transform(k, 12), landscape) * frame.size
        assert (depth > 0).all()
        distance = np.linalg.norm(uv[:, None] - drawn[None], axis=-1)
        assert distance.min(1).max() < 0.01  # the corners are the same, in another order
        assert len(set(distance.argmin(1))) == 8
        assert abs(np.linalg.det(frame.T_W_cam[:3, :3]) - 1) < 1e-6


def test_the_world_is_z_up_and_metric(clip) -> None:
    recording = clip.recording("chair/batch-3/12")
    known = recording.objects[0]
    np.testing.assert_allclose(known.size, (0.30, 0.20, 0.12), atol=1e-6)  # height last
    np.testing.assert_allclose(known.T_W_object[:3, 3], (0.1, 0.05, 0.06), atol=1e-6)
    np.testing.assert_allclose(known.T_W_object[:3, 2], (0, 0, 1), atol=1e-6)
    assert (known.category, known.task_class) == ("chair", TaskClass.OBSTACLE)
    centres = np.array([frame.T_W_cam[:3, 3] for frame in recording.frames])
    np.testing.assert_allclose(centres[:, 2], 0.5, atol=1e-6)
    down = np.array([frame.T_W_cam[:3, 1] for frame in recording.frames])
    assert (down[:, 2] < -0.5).all()  # photos stand upright


def test_clips_are_counted_and_read_when_asked_for(clip) -> None:
    assert clip.counts == {"clips": 1, "clips with boxes": 1, "clips with AR stream": 1, "clips with video": 1}
    assert clip.splits == {"train": 1, "test": 0}
    assert clip.categories == ("chair",)
    recording = clip.recording("chair/batch-3/12")
    assert recording.split == "train"
    assert len(recording.frames) == 12
    image = recording.frames[5].image()
    assert image.shape == (160, 120, 3)
    assert abs(int(np.median(image)) - 50) < 6
    assert examine(clip).problems == ()


def test_the_folder_s_category_wins_and_jumps_are_flagged(tmp_path) -> None:
    recording = open_dataset(objectron_example.write(tmp_path, category="bowl", jump=0.6)).recording("chair/batch-3/12")
    assert recording.objects[0].category == "chair"
    assert recording.breaks == (8,)
    assert any("calls its object 'bowl'" in doubt for doubt in recording.doubts)
    assert any("jumps before 1 frames (first: 8)" in doubt for doubt in recording.doubts)


def test_without_an_ar_stream_the_annotated_cameras_remain(tmp_path) -> None:
    dataset = open_dataset(objectron_example.write(tmp_path, stream=False))
    recording = dataset.recording("chair/batch-3/12")
    assert [frame.name for frame in recording.frames] == [f"{k:06d}" for k in range(0, 12, 2)]
    assert abs(int(np.median(recording.frames[2].image())) - 40) < 6  # of the video's frame 4
    assert "no geometry.pbdata" in recording.doubts[0]


def test_damaged_files_are_refused(tmp_path) -> None:
    root = objectron_example.write(tmp_path)
    stream = root / "videos/chair/batch-3/12/geometry.pbdata"
    whole = stream.read_bytes()
    stream.write_bytes(whole[:-10])
    with pytest.raises(InputError, match=r"no AR stream of Objectron: message 11 ends at byte \d+ of \d+; .* cut off"):
        open_dataset(root).recording("chair/batch-3/12")
    stream.write_bytes(b"")
    with pytest.raises(InputError, match="has no camera"):
        open_dataset(root).recording("chair/batch-3/12")
    stream.write_bytes(whole)
    note = root / "annotations/chair/batch-3/12.pbdata"
    note.write_bytes(counted(1, integer(1, 0) + counted(2, b"chair")))
    with pytest.raises(InputError, match="object 0 lacks rotation, translation or scale"):
        open_dataset(root).recording("chair/batch-3/12")
    found = examine(open_dataset(root))
    assert len(found.problems) == 1


def test_poses_that_do_not_fit_the_boxes_are_doubted(tmp_path) -> None:
    root = objectron_example.write(tmp_path)
    other = objectron_example.write(tmp_path / "other", jump=0.5)
    stream = other / "videos/chair/batch-3/12/geometry.pbdata"
    content = stream.read_bytes()
    frame = 4 + int.from_bytes(content[:4], "little")
    (root / "videos/chair/batch-3/12/geometry.pbdata").write_bytes(content[-frame:] * 12)  # one pose for all frames
    recording = open_dataset(root).recording("chair/batch-3/12")
    assert any("miss their drawn corners" in doubt for doubt in recording.doubts)


def test_many_clips_in_natural_order_with_what_is_missing(tmp_path) -> None:
    for name in ("chair/batch-10/2", "chair/batch-9/11", "chair/batch-9/2", "shoe/batch-1/0"):
        objectron_example.write(tmp_path, name=name, category=name.split("/")[0])
    (tmp_path / "annotations/shoe/batch-1/0.pbdata").unlink()
    dataset = open_dataset(tmp_path)
    assert dataset.names == ("chair/batch-9/2", "chair/batch-9/11", "chair/batch-10/2", "shoe/batch-1/0")
    assert "annotations of 1 clips (shoe/batch-1/0, ...)" in dataset.missing
    assert "class bike" in dataset.missing
    lonely = dataset.recording("shoe/batch-1/0")
    assert lonely.objects == ()
    assert "taken to be portrait" in lonely.doubts[0]
