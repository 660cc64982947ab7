"""Videos: sharp, different frames are taken; bad files are named."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from excavatwin.capture import VideoSampling, find_photos, open_capture, read_photo
from excavatwin.capture.video import displacement, sharpness
from excavatwin.errors import InputError

av = pytest.importorskip("av")
FPS, WIDTH, HEIGHT = 20, 320, 240


def canvas(width: int = 1600) -> np.ndarray:
    """A textured strip over which the camera flies."""
    rng = np.random.default_rng(4)
    fine = rng.integers(0, 256, (HEIGHT // 6, width // 6, 3)).astype(np.uint8)
    return cv2.resize(fine, (width, HEIGHT), interpolation=cv2.INTER_CUBIC)


def film(path: Path, offsets: list[float], blurred: set[int] = frozenset(), codec: str = "mpeg4") -> Path:
    """A video that shows the strip at these horizontal offsets [px]."""
    strip = canvas()
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=FPS)
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = WIDTH, HEIGHT, "yuv420p", 8_000_000
        for index, offset in enumerate(offsets):
            image = np.ascontiguousarray(strip[:, int(offset) : int(offset) + WIDTH])
            if index in blurred:
                image = cv2.blur(image, (25, 1))
            for packet in stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    return path


def numbers(photos) -> list[int]:
    return [int(photo.name.rsplit("_", 1)[1].split(".")[0]) for photo in photos]


def test_steady_flight_gives_evenly_different_frames(tmp_path):
    video = film(tmp_path / "flight.mp4", [3 * i for i in range(200)])
    photos = find_photos(video, tmp_path / "frames")
    assert 10 <= len(photos) <= 26
    assert numbers(photos) == sorted(numbers(photos))
    steps = np.diff(numbers(photos)) * 3 / WIDTH
    assert steps.min() >= VideoSampling().min_motion * 0.9
    assert steps.max() < 0.35  # enough overlap for matching
    for photo in photos:
        assert photo.path.parent == tmp_path / "frames"
        assert read_photo(photo).shape == (HEIGHT, WIDTH, 3) == (photo.height, photo.width, 3)
    assert len({photo.camera for photo in photos}) == 1
    assert [photo.time for photo in photos] == pytest.approx([n / FPS for n in numbers(photos)])


def test_blurred_frames_are_avoided(tmp_path):
    sharp = set(range(0, 160, 5))
    video = film(tmp_path / "shaky.mp4", [4 * i for i in range(160)], blurred=set(range(160)) - sharp)
    chosen = numbers(find_photos(video, tmp_path / "frames"))
    assert len(chosen) > 5
    assert set(chosen) <= sharp


def test_a_blurred_stretch_is_left_out(tmp_path):
    blurred = set(range(80, 110))
    video = film(tmp_path / "swing.mp4", [4 * i for i in range(200)], blurred=blurred)
    chosen = set(numbers(find_photos(video, tmp_path / "frames")))
    assert not chosen & blurred
    assert max(chosen) > 120


def test_standing_still_gives_one_frame(tmp_path):
    video = film(tmp_path / "still.mp4", [100.0] * 80 + [100 + 5 * i for i in range(40)])
    chosen = numbers(find_photos(video, tmp_path / "frames"))
    assert sum(n < 80 for n in chosen) == 1
    assert any(n > 90 for n in chosen)


def test_the_same_video_gives_the_same_frames(tmp_path):
    video = film(tmp_path / "flight.mp4", [3 * i for i in range(80)])
    first, second = (find_photos(video, tmp_path / name) for name in ("a", "b"))
    assert [p.name for p in first] == [p.name for p in second]
    for a, b in zip(first, second, strict=True):
        assert a.path.read_bytes() == b.path.read_bytes()


def test_a_video_that_breaks_off_is_used_and_named(tmp_path):
    whole = film(tmp_path / "flight.mkv", [3 * i for i in range(160)]).read_bytes()
    broken = tmp_path / "broken.mkv"
    broken.write_bytes(whole[: len(whole) * 6 // 10])
    capture = open_capture(broken, tmp_path / "frames")
    assert 4 < len(capture.photos) < 20


@pytest.mark.parametrize("content", [b"", b"this is no video at all" * 50])
def test_no_video_inside_is_an_input_error(tmp_path, content):
    path = tmp_path / "bad.mp4"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"bad\.mp4"):
        find_photos(path, tmp_path / "frames")


def test_sound_only_is_an_input_error(tmp_path):
    path = tmp_path / "sound.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000)
        stream.layout = "mono"
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), format="s16", layout="mono")
        frame.sample_rate = 8000
        for packet in [*stream.encode(frame), *stream.encode()]:
            container.mux(packet)
    with pytest.raises(InputError, match="no video stream"):
        find_photos(path, tmp_path / "frames")


def test_frames_need_a_folder(tmp_path):
    video = film(tmp_path / "flight.mp4", [0.0] * 5)
    with pytest.raises(InputError, match="frames"):
        find_photos(video)


def test_displacement_and_sharpness_measure_what_they_say():
    strip = cv2.cvtColor(canvas(), cv2.COLOR_RGB2GRAY)
    a, b = strip[:, :WIDTH], strip[:, 32 : 32 + WIDTH]
    assert displacement(a, a) == pytest.approx(0, abs=1e-3)
    assert displacement(a, b) == pytest.approx(32 / WIDTH, rel=0.05)
    assert displacement(a, strip[:, -WIDTH:]) > 0.2
    assert sharpness(a) > 3 * sharpness(cv2.blur(a, (9, 9)))
