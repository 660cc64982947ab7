"""Finished labels of photos become evidence on the lattice, and wrong ones are refused with the mistake's name."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from excavatwin.backbones.catalogue import make
from excavatwin.backbones.protocols import Picture
from excavatwin.backbones.segmenters.labelled import polygon_mask
from excavatwin.backbones.segmenters.masks import Masks
from excavatwin.backbones.segmenters.photo_sampling import shares, to_photo
from excavatwin.backbones.segmenters.run_lengths import decoded, unpacked
from excavatwin.backbones.segmenters.yolo_text import yaml_names
from excavatwin.errors import InputError
from excavatwin.scene.observations import Lattice

CT, OT, RC, EX, OB = np.eye(5, dtype=np.float32)


def lattice(width: int, height: int, scale: float = 0.5, distortion=(0.0, 0.0, 0.0, 0.0), shift=(0.0, 0.0)) -> Lattice:
    K = np.array([[0.9 * width, 0, width / 2 + 3], [0, 0.9 * width, height / 2 - 2], [0, 0, 1]])
    return Lattice(width, height, np.array([[scale, 0, shift[0]], [0, scale, shift[1]]]), K, distortion)


def picture(shape=(60, 80), name="a.jpg", at: Lattice | None = None) -> Picture:
    return Picture(np.zeros((*shape, 3), np.uint8), name, at)


def written(folder: Path, array: np.ndarray, name: str = "a.png", mode: str | None = None, **more) -> Path:
    folder.mkdir(exist_ok=True, parents=True)
    image = Image.fromarray(np.asarray(array))
    (image if mode is None else image.convert(mode)).save(folder / name, **more)
    return folder


def halves(left: int, right: int, shape=(60, 80), dtype=np.uint8) -> np.ndarray:
    ids = np.full(shape, left, dtype)
    ids[:, shape[1] // 2 :] = right
    return ids


# --- from photo to lattice ------------------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(
    st.floats(0.1, 1.5),
    st.tuples(st.floats(-0.15, 0.15), st.floats(-0.03, 0.03), st.floats(-2e-3, 2e-3), st.floats(-2e-3, 2e-3)),
    st.tuples(st.floats(-20, 20), st.floats(-20, 20)),
)
def test_to_photo_is_the_inverse_of_from_photo(scale, distortion, shift):
    at = lattice(800, 600, scale, distortion, shift)
    uv = np.stack(np.meshgrid(np.linspace(50, 750, 7), np.linspace(50, 550, 7)), -1).reshape(-1, 2)
    np.testing.assert_allclose(to_photo(at, at.from_photo(uv)), uv, atol=1e-3)


def test_shares_are_areas():
    labels = np.random.default_rng(0).integers(0, 3, (120, 160))
    found = shares(labels, np.eye(3, dtype=np.float32), lattice(160, 120, 0.25), (30, 40))
    exact = np.eye(3)[labels].reshape(30, 4, 40, 4, 3).mean((1, 3))
    np.testing.assert_allclose(found, exact, atol=1e-6)


@pytest.mark.parametrize("scale", [0.1, 0.5, 0.37, 1.0, 1.7])
def test_a_border_stays_where_it_is(scale):
    labels = halves(0, 1, (300, 400))
    H, W = round(300 * scale), round(400 * scale)
    found = shares(labels, np.eye(2, dtype=np.float32), lattice(400, 300, scale), (H, W))[..., 1]
    assert abs((1 - found).sum(1).mean() - 200 * scale) < 0.25 if scale < 1 else 0.51  # sampled at 4 places at most
    mirrored = shares(labels[:, ::-1], np.eye(2, dtype=np.float32), lattice(400, 300, scale), (H, W))[..., 0]
    if scale in (0.1, 0.5, 1.0):
        np.testing.assert_allclose(mirrored[:, ::-1], 1 - found, atol=1e-6)


def test_labels_are_read_through_the_lens():
    at = lattice(400, 300, 0.5, (-0.2, 0.05, 1e-3, -1e-3))
    _, col = np.indices((300, 400))
    table = np.arange(400, dtype=np.float32)[:, None]
    found = shares(col, table, at, (150, 200))[..., 0]
    centres = np.stack(np.meshgrid(np.arange(200) + 0.5, np.arange(150) + 0.5), -1).reshape(-1, 2)
    expected = to_photo(at, centres)[:, 0].reshape(150, 200) - 0.5
    inner = (slice(20, -20), slice(20, -20))
    assert np.abs(found - expected)[inner].max() < 0.6
    assert abs((found - expected)[inner].mean()) < 0.05
    assert np.abs(found - 2 * (np.arange(200) + 0.5)[None])[:, :20].max() > 3  # without the lens it would be wrong


def test_what_lies_outside_the_photo_is_not_known():
    found = shares(
        np.zeros((30, 40), int), np.ones((1, 1), np.float32), lattice(40, 30, 1.0, shift=(10.0, 0.0)), (30, 60)
    )
    assert not found[:, :10].any()
    assert (found[:, 10:50] == 1).all()
    assert not found[:, 50:].any()


# --- label images ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["L", "P", "I;16", "I", "RGB"])
def test_ids(tmp_path, mode):
    ids = halves(31, 50)  # soil and low grass of GOOSE
    if mode == "P":
        image = Image.fromarray(ids)
        image.putpalette(np.random.default_rng(0).integers(0, 256, 768).astype(np.uint8).tobytes())
        image.save(tmp_path / "a.png")
    elif mode == "RGB":
        written(tmp_path, np.repeat(ids[..., None], 3, -1))
    else:
        written(tmp_path, ids.astype({"L": np.uint8, "I;16": np.uint16, "I": np.int32}[mode]), "a.tif")
    seen = Masks(str(tmp_path), vocabulary="goose-64")(picture())
    np.testing.assert_array_equal(seen.evidence[0, [0, 39, 40, 79]], [CT, CT, RC, RC])
    assert bool(seen.doubts) == (mode == "RGB")
    assert Masks(str(tmp_path), vocabulary="goose-64:strict")(picture()).evidence[0, 79].tolist() == OT.tolist()


def test_masks_in_the_catalogue(tmp_path):
    written(tmp_path, halves(1, 5), "photo.jpg.png")
    segmenter = make("segmenter", f"masks:{tmp_path}")
    seen = segmenter(picture(name="photo.jpg"))
    np.testing.assert_array_equal(seen.evidence[0, [0, 79]], [CT, OB])
    assert seen.doubts == ("no vocabulary was given: its ids are read as task classes 0 to 5.",)
    before = segmenter.identity()
    written(tmp_path, halves(1, 4), "photo.jpg.png", compress_level=1)
    assert segmenter.identity() != before
    assert segmenter(picture(name="photo.jpg")).evidence[0, 79].tolist() == EX.tolist()


def test_the_identity_follows_what_names_the_classes(tmp_path):
    written(tmp_path / "labels", halves(0, 1))
    names, own = tmp_path / "classes.txt", tmp_path / "own.toml"
    own.write_text('[classes]\nsoil = "construction_terrain"\nbush = "nothing"\n')
    names.write_text("soil\nbush\n")
    model = Masks(str(tmp_path / "labels"), mapping=f"{own}:own")
    first = model.identity()
    np.testing.assert_array_equal(model(picture()).evidence[0, [0, 79]], [CT, 0 * CT])
    names.write_text("bush\nsoil")
    assert model.identity() != first
    np.testing.assert_array_equal(model(picture()).evidence[0, [0, 79]], [0 * CT, CT])
    second = model.identity()
    own.write_text('[classes]\nsoil = "construction_terrain"\nbush = "obstacle"\n')
    assert model.identity() != second


def test_sky_void_and_certainty(tmp_path):
    ids = halves(53, 31)  # sky, soil
    ids[:10] = 255
    written(tmp_path, ids)
    seen = Masks(str(tmp_path), vocabulary="goose-64", certainty=0.8, remap={"soil": "other_terrain"})(picture())
    assert seen.no_surface[20, 0]
    assert not seen.no_surface[:10].any()
    assert not seen.evidence[:10].any()
    np.testing.assert_allclose(seen.evidence[20, 60], 0.8 * OT)


def test_names_in_a_list_beside_the_labels(tmp_path):
    written(tmp_path / "labels", halves(0, 2))
    (tmp_path / "classes.txt").write_text("sphagnum\ngrass\nexcavator\n")
    with pytest.raises(InputError, match="has no line for 1 of 3: 'sphagnum'"):
        Masks(str(tmp_path / "labels"))(picture())
    seen = Masks(str(tmp_path / "labels"), remap={"sphagnum": "construction_terrain"})(picture())
    np.testing.assert_array_equal(seen.evidence[0, [0, 79]], [CT, EX])


@pytest.mark.parametrize("vocabulary", ["goose-64", "rellis-3d", "cityscapes", "mapillary-vistas"])
def test_colours_of_a_known_palette(tmp_path, vocabulary):
    from excavatwin.vocabularies import read_vocabulary

    known = read_vocabulary(vocabulary)
    names = [name for name in known.classes if known.matrix([name]).any()]
    painted = np.array([[known.colours[known.key(name)] for name in names]], np.uint8)
    written(tmp_path, np.repeat(painted, 2, 0))
    seen = Masks(str(tmp_path), vocabulary=vocabulary)(picture((2, len(names))))
    np.testing.assert_array_equal(seen.evidence[0], known.matrix(names))


@pytest.mark.parametrize(
    ("array", "vocabulary", "message"),
    [
        (
            halves(1, 150),
            "ade20k-150",
            r"holds the id 150, .* \(ids 0 to 149\) .* count from 1; give --masks.offset -1",
        ),
        (halves(1, 19), "cityscapes", r"seem to count from 1; give --masks.offset -1"),
        (halves(1, 77), "cityscapes", r"holds the id 77, .*; give the vocabulary that it was made with"),
        (halves(0, 6), "", r"holds the id 6, which task \(ids 0 to 5\) does not have"),
        (
            np.dstack([halves(1, 2), halves(3, 4), halves(5, 6)]),
            "ade20k-150",
            r"painted \(RGB\), but .* class ids, and ade",
        ),
        (
            np.dstack([halves(1, 2), halves(3, 4), halves(5, 6)]),
            "goose-64",
            r"the colour \(1, 3, 5\), .* another palette",
        ),
        (np.full((60, 80, 3), (0, 97, 209), np.uint8), "goose-64", "its channels are blue, green, red: export RGB"),
        (halves(1, 2).T, "task", r"are 60 x 80 px, the photo 80 x 60; they lie on their side"),
        (halves(1, 2, (60, 60)), "task", "neither cropped nor padded"),
        (np.ones((60, 80), np.float32), "task", "has the mode F"),
    ],
)
def test_wrong_label_images_are_named(tmp_path, array, vocabulary, message):
    written(tmp_path, array, "a.tif")
    with pytest.raises(InputError, match=message):
        Masks(str(tmp_path), vocabulary=vocabulary)(picture())


def test_labels_that_count_from_one_are_moved(tmp_path):
    ids = halves(14, 150)  # 1-based: earth and flag
    ids[0] = 0
    written(tmp_path, ids)
    seen = Masks(str(tmp_path), vocabulary="ade20k-150", offset=-1)(picture())
    assert not seen.evidence[0].any()
    np.testing.assert_array_equal(seen.evidence[1, [0, 79]], [CT, OB])


def test_lossy_labels_are_refused(tmp_path):
    written(tmp_path, halves(1, 2), "a.jpg")
    with pytest.raises(InputError, match="is JPG, which changes the values of labels"):
        Masks(str(tmp_path), form="images", vocabulary="task")(picture())
    written(tmp_path, halves(1, 2), "a.png")  # labels beside the photo
    assert Masks(str(tmp_path), vocabulary="task")(picture()).evidence[0, 0].tolist() == CT.tolist()


def test_labels_of_another_size_are_rescaled_and_told(tmp_path):
    written(tmp_path, halves(1, 2, (30, 40)))
    seen = Masks(str(tmp_path), vocabulary="task")(picture())
    assert seen.doubts == ("its labels have another size than the photo; they are rescaled.",)
    assert (seen.evidence[:, :40] == CT).all()
    assert (seen.evidence[:, 40:] == OT).all()


def test_photos_without_labels_abstain_and_are_told(tmp_path):
    written(tmp_path, halves(1, 2))
    seen = Masks(str(tmp_path), vocabulary="task")(picture(name="b.jpg"))
    assert not seen.evidence.any()
    assert seen.doubts == (f"has no labels in {tmp_path}; it has no evidence.",)
    with pytest.raises(InputError, match="the picture has none"):
        Masks(str(tmp_path), vocabulary="task")(picture(name=""))


def test_which_file_belongs_to_a_photo(tmp_path):
    written(tmp_path, halves(1, 2), "a_labelids.png")
    written(tmp_path, halves(3, 4), "a_color.png")
    seen = Masks(str(tmp_path), vocabulary="task", suffix="_labelids")(picture(name="A.JPG"))
    assert seen.evidence[0, 0].tolist() == CT.tolist()
    written(tmp_path / "one", halves(1, 2))
    written(tmp_path / "one" / "two", halves(1, 2))
    with pytest.raises(InputError, match=r"both belong to a; keep one"):
        Masks(str(tmp_path / "one"), vocabulary="task")(picture())
    with pytest.raises(InputError, match=r"holds no label file named like PHOTO_x\.png"):
        Masks(str(tmp_path / "one"), vocabulary="task", suffix="_x")(picture())
    with pytest.raises(InputError, match="there is no nowhere"):
        Masks("nowhere")(picture())
    with pytest.raises(InputError, match="needs labels; give --segmenter masks:FOLDER"):
        Masks()(picture())


def test_scores(tmp_path):
    written(tmp_path / "labels", halves(1, 2))
    written(tmp_path / "scores", halves(51, 255), "a.png")
    masks = Masks(str(tmp_path / "labels"), vocabulary="task", scores=str(tmp_path / "scores"))
    np.testing.assert_allclose(masks(picture()).evidence[0, [0, 79]], [0.2 * CT, OT], atol=1e-4)
    written(tmp_path / "scores", halves(0.5, 0.25, dtype=np.float32), "a.tif")
    (tmp_path / "scores" / "a.png").unlink()
    np.testing.assert_allclose(masks(picture()).evidence[0, [0, 79]], [0.5 * CT, 0.25 * OT], atol=1e-4)
    written(tmp_path / "scores", halves(0.5, 25, dtype=np.float32), "a.tif")
    with pytest.raises(InputError, match=r"holds scores from 0.5 to 25; expected 0 to 1"):
        masks(picture())
    (tmp_path / "scores" / "a.tif").rename(tmp_path / "scores" / "b.tif")
    seen = masks(picture())
    assert seen.doubts == ("has labels, but no image of scores; it has no evidence.",)
    assert not seen.evidence.any()


# --- COCO -----------------------------------------------------------------------------------------------------------


def coco(folder: Path, annotations: list[dict], name: str = "instances.json", **more) -> Path:
    table = {
        "images": [{"id": 7, "file_name": "photos/a.jpg", "width": 80, "height": 60}],
        "categories": [{"id": 1, "name": "excavator"}, {"id": 5, "name": "soil"}, {"id": 9, "name": "sky"}],
        "annotations": [{"id": n, "image_id": 7} | one for n, one in enumerate(annotations)],
    }
    (folder / name).write_text(json.dumps(table | more))
    return folder / name


def rectangle(x0: float, y0: float, x1: float, y1: float) -> list[float]:
    return [x0, y0, x1, y0, x1, y1, x0, y1]


def test_instances_of_coco(tmp_path):
    runs = [0, 60 * 40, 60 * 40]  # left half, down the columns
    annotations = [
        {"category_id": 1, "segmentation": [rectangle(10, 10, 20, 20)], "score": 0.6},
        {"category_id": 5, "segmentation": {"counts": runs, "size": [60, 80]}, "score": 0.3},
        {"category_id": 9, "segmentation": [rectangle(60, 0, 80, 10), rectangle(60, 40, 80, 60)]},
    ]
    path = coco(tmp_path, annotations)
    seen = make("segmenter", f"masks:{path}")(picture())
    truth = np.zeros((60, 80, 5), np.float32)
    truth[:, :40] = 0.3 * CT
    truth[10:20, 10:20] = 0.6 * EX
    np.testing.assert_allclose(seen.evidence, truth, atol=1e-6)
    assert seen.no_surface.sum() == 20 * 10 + 20 * 20
    assert seen.doubts == ()
    np.testing.assert_array_equal(Masks(str(tmp_path))(picture()).evidence, seen.evidence)
    assert Masks(str(path))(picture(name="b.jpg")).doubts


def test_of_equally_sure_instances_the_smallest_is_on_top(tmp_path):
    annotations = [
        {"category_id": 1, "segmentation": [rectangle(10, 10, 20, 20)]},
        {"category_id": 5, "segmentation": [rectangle(0, 0, 80, 60)]},
    ]
    for some in (annotations, annotations[::-1]):
        evidence = Masks(str(coco(tmp_path, some)))(picture()).evidence
        assert evidence[15, 15].tolist() == EX.tolist()
        assert evidence[5, 5].tolist() == CT.tolist()


def test_panoptic_png(tmp_path):
    colours = np.zeros((60, 80, 3), np.uint8)
    colours[:, :40] = (3, 1, 0)  # 259
    colours[:30, 40:] = (0, 0, 1)  # 65536
    written(tmp_path / "panoptic", colours)
    segments = [{"id": 259, "category_id": 5}, {"id": 65536, "category_id": 1}]
    path = coco(tmp_path, [{"file_name": "a.png", "segments_info": segments}], "panoptic.json")
    evidence = Masks(str(path))(picture()).evidence
    np.testing.assert_array_equal(evidence[[0, 0, 59], [0, 79, 79]], [CT, EX, 0 * CT])
    path = coco(tmp_path, [{"file_name": "a.png", "segments_info": segments[:1]}], "panoptic.json")
    with pytest.raises(InputError, match="holds the segment 65536, which"):
        Masks(str(path))(picture())
    (tmp_path / "panoptic" / "a.png").unlink()
    with pytest.raises(InputError, match="which is neither beside it nor in"):
        Masks(str(path))(picture())


@pytest.mark.parametrize(
    ("annotation", "message"),
    [
        ({"category_id": 1, "bbox": [1, 2, 3, 4]}, "annotation 0 has no segmentation"),
        ({"category_id": 2, "segmentation": [rectangle(0, 0, 9, 9)]}, "has the category 2, which"),
        (
            {"category_id": 1, "segmentation": {"counts": [5], "size": [60, 80]}},
            "covers 5 pixels, but its size says 60 x 80",
        ),
        ({"category_id": 1, "segmentation": {"counts": [5], "size": [5, 1]}}, "is 1 x 5 px, its image 80 x 60"),
    ],
)
def test_wrong_annotations_are_named(tmp_path, annotation, message):
    with pytest.raises(InputError, match=message):
        Masks(str(coco(tmp_path, [annotation])))(picture())


def test_files_that_are_no_coco_annotations(tmp_path):
    (tmp_path / "a.json").write_text('[{"image_id": 7}]')
    with pytest.raises(InputError, match="holds results only"):
        Masks(str(tmp_path))(picture())
    (tmp_path / "a.json").write_text('{"images": []}')
    with pytest.raises(InputError, match="has no list 'annotations'"):
        Masks(str(tmp_path))(picture())
    (tmp_path / "a.json").write_text("{")
    with pytest.raises(InputError, match="cannot be read as JSON"):
        Masks(str(tmp_path))(picture())
    (tmp_path / "b.json").write_text("{}")
    with pytest.raises(InputError, match=r"holds 2 JSON files \(a.json, b.json\)"):
        Masks(str(tmp_path))(picture())


def test_run_lengths_are_those_of_pycocotools():
    mask = pytest.importorskip("pycocotools.mask", reason="needs pycocotools: make test-backbones")
    rng = np.random.default_rng(0)
    for shape in ((1, 1), (7, 5), (60, 80), (300, 211)):
        for share in (0.0, 0.02, 0.5, 1.0):
            truth = (rng.random(shape) < share) if share in (0, 1) else blobs(shape, share, rng)
            packed = mask.encode(np.asfortranarray(truth.astype(np.uint8)))
            np.testing.assert_array_equal(decoded(packed["counts"], *shape), truth)
            np.testing.assert_array_equal(decoded(packed["counts"].decode(), *shape), truth)
            assert sum(unpacked(packed["counts"])[1::2]) == truth.sum()
    with pytest.raises(InputError, match="ends within a number"):
        unpacked("o")


def blobs(shape, share, rng):
    import cv2

    noise = cv2.GaussianBlur(rng.random(shape), (0, 0), 3)
    return noise < np.quantile(noise, share)


def test_polygons_agree_with_pycocotools_but_for_border_pixels():
    mask = pytest.importorskip("pycocotools.mask", reason="needs pycocotools: make test-backbones")
    rng = np.random.default_rng(1)
    for _ in range(20):
        angles = np.sort(rng.uniform(0, 2 * np.pi, 9))
        corners = np.stack([40 + 30 * rng.random(9) * np.cos(angles), 30 + 25 * rng.random(9) * np.sin(angles)], -1)
        ours = polygon_mask(corners, 80, 60)
        theirs = mask.decode(mask.merge(mask.frPyObjects([corners.ravel().tolist()], 60, 80))).astype(bool)
        off = np.argwhere(ours ^ theirs)[:, ::-1, None] + 0.5  # theirs is rounded to a fifth of a pixel
        edges = np.roll(corners, -1, axis=0) - corners
        along = np.clip(((off[..., 0][:, None] - corners) * edges).sum(-1) / (edges**2).sum(-1), 0, 1)
        nearest = np.linalg.norm(off[..., 0][:, None] - corners - along[..., None] * edges, axis=-1).min(1)
        assert nearest.max(initial=0) < 0.2


def test_a_polygon_is_the_pixels_whose_centres_it_holds():
    corners = np.array([[2.4, 1.6], [7.6, 1.6], [7.6, 4.4], [2.4, 4.4]])
    mask = polygon_mask(corners, 10, 6)
    assert np.argwhere(mask).min(0).tolist() == [2, 2]
    assert np.argwhere(mask).max(0).tolist() == [3, 7]
    assert mask.sum() == 12
    assert polygon_mask(corners - 20, 10, 6).sum() == 0
    assert polygon_mask(np.array([[-5, -5], [50, -5], [50, 50], [-5, 50.0]]), 10, 6).all()


# --- YOLO text ------------------------------------------------------------------------------------------------------


def yolo(folder: Path, lines: str) -> Path:
    (folder / "labels").mkdir(exist_ok=True)
    (folder / "labels" / "a.txt").write_text(lines)
    (folder / "data.yaml").write_text("path: ../x\nnc: 2\nnames:\n  0: excavator\n  1: soil # loose\n")
    return folder / "labels"


def test_yolo_text(tmp_path):
    labels = yolo(tmp_path, "1 0 0 1 0 1 1 0 1 0.5\n0 0.25 0.5 0.5 0.5 0.5 1 0.25 1 0.9\n\n")
    seen = make("segmenter", f"masks:{labels}")(picture())
    truth = np.broadcast_to(0.5 * CT, (60, 80, 5)).copy()
    truth[30:, 20:40] = 0.9 * EX
    np.testing.assert_allclose(seen.evidence, truth, atol=1e-6)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("0 0.5 0.5 0.1 0.1", "has 5 numbers: a box, no outline"),
        ("0 0.5 0.5 0.1 0.1 0.9", "has 6 numbers: a box, no outline"),
        ("0 10 10 20 10 20 20", "has a coordinate of 20; YOLO text holds shares 0..1, not pixels"),
        ("2 0 0 1 0 1 1", "has the class 2, but there are 2 .* count from 1: give --masks.offset -1"),
        ("7 0 0 1 0 1 1", r"has the class 7, but there are 2 \(0 to 1\)\."),
        ("x 0 0 1 0 1 1", "is not numbers"),
        ("0 0 0 1 0 1 1 3", "the score 3"),
    ],
)
def test_wrong_yolo_text_is_named(tmp_path, line, message):
    labels = yolo(tmp_path, f"1 0 0 1 0 1 1\n{line}\n")
    with pytest.raises(InputError, match=rf"a.txt, line 2.*{message}"):
        Masks(str(labels))(picture())


def test_classes_of_yolo_text(tmp_path):
    for text in (
        "names: [a b, 'c, d']",
        "names:\n- a b\n- 'c, d'\nnc: 2",
        "names:\n  1: c, d\n  0: a b\n",
        "names: {0: a b, 1: 'c, d'}",
    ):
        assert yaml_names(text) == ("a b", "c, d")
    assert yaml_names("nc: 3") == ()
    labels = yolo(tmp_path, "4 0 0 1 0 1 1")
    assert Masks(str(labels), vocabulary="task")(picture()).evidence[0, 79].tolist() == EX.tolist()
    (tmp_path / "data.yaml").unlink()
    with pytest.raises(InputError, match=r"are not known; put data\.yaml or classes"):
        Masks(str(labels))(picture())


# --- a whole site ---------------------------------------------------------------------------------------------------


def test_true_labels_of_a_rendered_site_come_back(tmp_path):
    from emulated_views import true_views

    view = true_views()[0]
    label = view.label.astype(np.uint8)
    h, w = label.shape
    written(tmp_path, label, "v.png")
    at = lattice(w, h, 0.5)
    seen = Masks(str(tmp_path), vocabulary="task")(picture((h // 2, w // 2), "v.jpg", at))
    best = np.where(seen.evidence.any(-1), seen.evidence.argmax(-1) + 1, 0)
    blocks = label[: h // 2 * 2, : w // 2 * 2].reshape(h // 2, 2, w // 2, 2)
    pure = (blocks == blocks[:, :1, :, :1]).all((1, 3))
    assert pure.mean() > 0.8
    np.testing.assert_array_equal(best[pure], blocks[:, 0, :, 0][pure])


# --- the page -------------------------------------------------------------------------------------------------------


def test_the_page_has_every_key_of_the_toml_and_its_example_reads(tmp_path):
    import re
    from dataclasses import fields

    from excavatwin.backbones.segmenters.onnx_description import Description, read_description

    page = (Path(__file__).parents[1] / "docs" / "labels-and-onnx.md").read_text("utf-8")
    keys = {one.name for one in fields(Description)} - {"ids"}
    assert keys <= set(re.findall(r"\w+", page.partition("## Labels")[0]))
    documented = re.findall(r"^\| (.+?) \|", page.partition("## Labels")[0], re.MULTILINE)
    named = {key for row in documented for key in re.findall(r"`\[?(\w+)\]?`", row)}
    assert named | {"model", "classes", "mean", "std"} == keys
    example = re.search(r"```toml\n(.*?)```", page, re.DOTALL)
    assert example
    (tmp_path / "terrain.toml").write_text(example.group(1))
    (tmp_path / "terrain.onnx").touch()
    assert read_description(tmp_path / "terrain.toml").classes == ("soil", "low_grass", "sky")
    for option in re.findall(r"--masks\.(\w+)", page):
        assert option in {one.name for one in fields(Masks)}
