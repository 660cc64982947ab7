"""Folders of photos: order, orientation, modes, and every way in which they can be wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from excavatwin.capture import find_photos, open_capture, read_photo
from excavatwin.errors import ExcavatwinError, InputError

ORIENTATION = 0x0112


def picture(height: int = 96, width: int = 128, seed: int = 0) -> np.ndarray:
    """A colourful gradient with noise, no symmetry."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    rgb = np.stack([x * 255 / width, y * 255 / height, (x + 2 * y) % 256], -1)
    return np.clip(rgb + rng.normal(0, 8, rgb.shape), 0, 255).astype(np.uint8)


def save(path: Path, image: np.ndarray | None = None, **options) -> Path:
    Image.fromarray(picture() if image is None else image).save(path, **options)
    return path


def test_natural_order_any_case_and_hidden_files(tmp_path):
    for name in ("IMG_10.JPG", "IMG_9.jpeg", "img_2.PNG", "IMG_1.tif", "IMG_011.TIFF"):
        save(tmp_path / name)
    save(tmp_path / ".IMG_3.jpg")
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / "IMG_4.jpg").mkdir()
    names = [photo.name for photo in find_photos(tmp_path)]
    assert names == ["IMG_1.tif", "img_2.PNG", "IMG_9.jpeg", "IMG_10.JPG", "IMG_011.TIFF"]


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("long_side", [None, 64])
def test_orientation_is_honoured(tmp_path, orientation, long_side):
    upright = picture()
    stored = {
        1: upright,
        2: upright[:, ::-1],
        3: upright[::-1, ::-1],
        4: upright[::-1],
        5: upright.transpose(1, 0, 2),
        6: np.rot90(upright, 1),
        7: upright.transpose(1, 0, 2)[::-1, ::-1],
        8: np.rot90(upright, -1),
    }[orientation]
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    Image.fromarray(np.ascontiguousarray(stored)).save(tmp_path / "a.png", exif=exif)
    (photo,) = find_photos(tmp_path)
    assert (photo.width, photo.height) == (128, 96)
    seen = read_photo(photo, long_side)
    if long_side is None:
        assert np.array_equal(seen, upright)
    else:
        assert seen.shape == (48, 64, 3)
        coarse = np.asarray(Image.fromarray(upright).resize((64, 48), Image.Resampling.LANCZOS), float)
        assert np.abs(seen - coarse).mean() < 4


def test_shrinking_keeps_the_picture_and_never_enlarges(tmp_path):
    big = np.kron(picture(60, 80), np.ones((20, 20, 1), np.uint8))
    save(tmp_path / "big.jpg", big, quality=95)
    (photo,) = find_photos(tmp_path)
    small = read_photo(photo, 100)
    assert small.shape == (75, 100, 3)
    assert small.dtype == np.uint8
    reference = np.asarray(Image.fromarray(big).resize((100, 75), Image.Resampling.BOX), float)
    assert np.abs(small - reference).mean() < 6
    assert read_photo(photo, 5000).shape == (1200, 1600, 3)


def test_grey_palette_alpha_cmyk_and_16_bit(tmp_path):
    rgb = Image.fromarray(picture())
    rgb.convert("L").save(tmp_path / "a_grey.png")
    rgb.convert("P").save(tmp_path / "b_palette.png")
    rgb.convert("RGBA").save(tmp_path / "c_alpha.png")
    rgb.convert("CMYK").save(tmp_path / "d_cmyk.jpg")
    grey = np.asarray(rgb.convert("L"), np.uint16)
    Image.fromarray(grey * 257).save(tmp_path / "e_16bit.png")
    Image.fromarray(grey * 16).save(tmp_path / "f_12bit.tif")
    images = {photo.name[0]: read_photo(photo) for photo in find_photos(tmp_path)}
    assert set(images) == set("abcdef")
    for image in images.values():
        assert image.shape == (96, 128, 3)
        assert image.dtype == np.uint8
    assert np.array_equal(images["c"], np.asarray(rgb))
    for key in "ef":
        assert np.abs(images[key][..., 0] - grey.astype(float)).max() <= 1
    assert np.abs(images["d"].astype(float) - np.asarray(rgb)).mean() < 20


def test_a_damaged_photo_is_skipped_and_named(tmp_path):
    whole = save(tmp_path / "good.jpg").read_bytes()
    (tmp_path / "half.jpg").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "none.jpg").write_bytes(b"")
    (tmp_path / "text.png").write_text("this is no picture")
    Image.fromarray(np.ones((80, 80), np.float32)).save(tmp_path / "depth.tif")
    save(tmp_path / "icon.png", picture(16, 16))
    capture = open_capture(tmp_path)
    assert [photo.name for photo in capture.photos] == ["good.jpg"]
    reasons = {skipped.name: skipped.reason for skipped in capture.skipped}
    assert set(reasons) == {"half.jpg", "none.jpg", "text.png", "depth.tif", "icon.png"}
    assert "damaged" in reasons["half.jpg"]
    assert "copy it again" in reasons["half.jpg"]
    assert "empty" in reasons["none.jpg"]
    assert "PNG" in reasons["text.png"]
    assert "not a picture" in reasons["depth.tif"]
    assert "16 x 16" in reasons["icon.png"]


def test_only_damaged_photos_are_an_error_that_names_one(tmp_path):
    whole = save(tmp_path / "half.jpg").read_bytes()
    (tmp_path / "half.jpg").write_bytes(whole[:800])
    with pytest.raises(InputError, match=r"none of the 1 photo files.*half\.jpg"):
        find_photos(tmp_path)


def test_a_photo_that_vanishes_later_is_an_input_error(tmp_path):
    path = save(tmp_path / "a.jpg")
    (photo,) = find_photos(tmp_path)
    path.unlink()
    with pytest.raises(InputError, match=r"a\.jpg"):
        read_photo(photo)


@pytest.mark.parametrize("pair", [("IMG_1.jpg", "IMG_1.png"), ("a.JPG", "A.tif")])
def test_names_that_would_collide_in_the_results_are_refused(tmp_path, pair):
    for name in pair:
        save(tmp_path / name)
    with pytest.raises(InputError, match="same name"):
        find_photos(tmp_path)


def test_wrong_sources_say_what_was_found_and_expected(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        find_photos(tmp_path / "missing")
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(InputError, match=r"no files.*\.jpg"):
        find_photos(empty)
    (empty / "raw.DNG").write_bytes(b"x")
    with pytest.raises(InputError, match=r"only \.dng"):
        find_photos(empty)
    nested = tmp_path / "project"
    (nested / "images").mkdir(parents=True)
    save(nested / "images" / "a.jpg")
    with pytest.raises(InputError, match="subfolder 'images'"):
        find_photos(nested)
    with pytest.raises(InputError, match="single photo"):
        find_photos(nested / "images" / "a.jpg")
    (tmp_path / "a.pdf").write_bytes(b"x")
    with pytest.raises(InputError, match="neither a folder"):
        find_photos(tmp_path / "a.pdf")
    assert issubclass(InputError, ExcavatwinError)


def test_progress_counts_every_file(tmp_path):
    for index in range(5):
        save(tmp_path / f"{index}.png")
    calls: list[tuple[str, int, int]] = []
    find_photos(tmp_path, progress=lambda stage, done, total: calls.append((stage, done, total)))
    assert calls == [("read photos", done, 5) for done in range(6)]
