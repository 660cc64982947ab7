"""The door: catalogue, cards, weights that are never fetched silently, lattices, memory. Without torch."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from excavatwin.backbones import catalogue, extras, weights
from excavatwin.backbones.cards import Card, Tried, Weights
from excavatwin.backbones.device import halving
from excavatwin.backbones.lattices import IMAGENET, fit, lattice_shape, normalised
from excavatwin.errors import InputError, MissingExtraError
from excavatwin.survey.backbone_states import find_entry, states
from excavatwin.survey.readiness import make_ready, restrictions

NETWORK = Card(
    "seer",
    "segmenter",
    "sees",
    Tried.STAND_IN,
    modules=("numpy",),
    install='pip install "excavatwin[seer]"',
    weights=(Weights("lab/seer-large", 2.5e9, "CC-BY-NC-4.0", False), Weights("lab/seer-small", 1e8, "MIT", True)),
)


@pytest.fixture
def hub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache of the hub."""
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path / "hub"))
    return tmp_path / "hub"


def put(hub: Path, repo: str, revision: str = "abc123") -> Path:
    """Weights as the hub's library leaves them behind."""
    folder = hub / f"models--{repo.replace('/', '--')}"
    (folder / "refs").mkdir(parents=True)
    (folder / "refs" / "main").write_text(revision)
    (folder / "snapshots" / revision).mkdir(parents=True)
    (folder / "snapshots" / revision / "model.safetensors").write_bytes(b"0" * 10)
    return folder / "snapshots" / revision


# --- catalogue ------------------------------------------------------------------------------------------------------


def test_every_shipped_backbone_has_a_full_card_and_imports_no_model_library() -> None:
    script = (
        "import sys\n"
        "from excavatwin.backbones import catalogue\n"
        "for kind in ('reconstructor', 'segmenter'):\n"
        "    for entry in catalogue.entries(kind):\n"
        "        card = entry.card()\n"
        "        assert (card.name, card.kind) == (entry.name, entry.kind), card\n"
        "        assert card.summary and (not card.modules or card.install), card\n"
        "        entry.load()()\n"
        "heavy = {'torch', 'transformers', 'ultralytics', 'onnxruntime', 'numba', 'pycolmap'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_unknown_names_are_answered_with_the_nearest() -> None:
    with pytest.raises(InputError, match="did you mean vggt"):
        catalogue.make("reconstructor", "vgt")
    with pytest.raises(InputError, match="there are: photogrammetry"):
        catalogue.make("reconstructor", "zzzzzz")
    with pytest.raises(InputError, match="takes nothing after the colon"):
        catalogue.make("segmenter", "appearance:weights.pt")
    with pytest.raises(InputError, match="did you mean mask2former"):
        find_entry("maskformer")


def test_states_tell_what_to_type_next() -> None:
    rows = {row.card.name: row for kind in ("reconstructor", "segmenter") for row in states(kind)}  # type: ignore[arg-type]
    assert rows["photogrammetry"].state == rows["appearance"].state == "ready"
    for row in rows.values():
        if row.missing:
            assert row.next.startswith("pip install"), row
        else:
            assert f"--{row.card.kind} {row.card.name}" in row.next


# --- libraries and weights ------------------------------------------------------------------------------------------


def test_missing_library_gives_the_exact_line(monkeypatch: pytest.MonkeyPatch) -> None:
    card = Card(
        "seer", "segmenter", "sees", Tried.STAND_IN, modules=("numpy", "no_such_library"), install="pip install x"
    )
    with pytest.raises(MissingExtraError, match="no_such_library, which is not installed; run: pip install x"):
        extras.need(card)
    extras.need(NETWORK)
    assert extras.versions(NETWORK).startswith("numpy ")


def test_weights_are_found_in_the_cache_of_the_hub_or_by_path(hub: Path, tmp_path: Path) -> None:
    assert weights.find(NETWORK) is None
    here = put(hub, "lab/seer-large")
    assert weights.find(NETWORK) == here
    assert weights.find(NETWORK, "seer-small") is None
    assert weights.fingerprint(NETWORK) == "lab/seer-large@abc123"
    mine = tmp_path / "mine.pt"
    mine.write_bytes(b"1")
    assert weights.find(NETWORK, str(mine)) == mine
    first = weights.fingerprint(NETWORK, str(mine))
    mine.write_bytes(b"12")
    assert weights.fingerprint(NETWORK, str(mine)) != first
    with pytest.raises(InputError, match="there is no"):
        weights.find(NETWORK, str(tmp_path / "none" / "mine.pt"))


def test_half_a_download_is_not_taken_for_weights(hub: Path) -> None:
    snapshots = put(hub, "lab/seer-large", "old").parent
    refs = snapshots.parent / "refs" / "main"
    (snapshots / "new").mkdir()
    (snapshots / "new" / "config.json").write_text("{}")
    refs.write_text("new")
    assert weights.find(NETWORK) == snapshots / "old"
    (snapshots / "new" / "model.safetensors.index.json").write_text('{"weight_map": {"a": "1.safetensors"}}')
    (snapshots / "new" / "2.safetensors").write_bytes(b"0")
    assert weights.find(NETWORK) == snapshots / "old"
    (snapshots / "new" / "1.safetensors").symlink_to("gone")
    assert weights.find(NETWORK) == snapshots / "old"
    (snapshots / "new" / "1.safetensors").unlink()
    (snapshots / "new" / "1.safetensors").write_bytes(b"0")
    assert weights.find(NETWORK) == snapshots / "new"
    refs.write_text("old")
    assert weights.find(NETWORK) == snapshots / "old"
    (snapshots / "old" / "model.safetensors").unlink()
    (snapshots / "new" / "1.safetensors").unlink()
    assert weights.find(NETWORK) is None


@pytest.mark.parametrize(
    ("wanted", "path"),
    [("lab/seer-large", False), ("seer-large", False), ("", False), ("seer.pt", True), ("./seer", True), ("~/x", True),
     ("a/b/c", True)],
)  # fmt: skip
def test_names_on_the_hub_and_paths(wanted: str, path: bool) -> None:
    assert weights.is_path(wanted) is path


def test_without_consent_nothing_is_fetched(hub: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fetched: list[str] = []
    monkeypatch.setattr(weights, "download", lambda one: fetched.append(one.repo) or put(hub, one.repo))
    asked: list[str] = []
    with pytest.raises(InputError, match=r"2\.5 GB, licence CC-BY-NC-4\.0, which restricts commercial use.*--download"):
        weights.provide(NETWORK, "", lambda question: bool(asked.append(question)))
    assert not fetched
    assert "lab/seer-large, 2.5 GB" in asked[0]
    assert weights.provide(NETWORK, "", lambda question: True).name == "abc123"
    assert fetched == ["lab/seer-large"]
    weights.provide(NETWORK, "", lambda question: pytest.fail("they are here: nobody is asked"))


def test_everything_is_refused_before_anything_is_asked(hub: Path) -> None:
    class Seer:
        card: ClassVar[Card] = NETWORK
        weights: ClassVar[str] = ""

        def identity(self) -> str:
            return "1"

    class Blind(Seer):
        card: ClassVar[Card] = Card("blind", "segmenter", "", Tried.STAND_IN, modules=("no_such_library",), install="x")

    with pytest.raises(MissingExtraError):
        make_ready([Seer(), Blind()], lambda question: pytest.fail("asked before all libraries were there"))


def test_terms_are_said_for_code_and_weights() -> None:
    assert restrictions(NETWORK) == ["seer: its weights lab/seer-large are under CC-BY-NC-4.0; see to its terms."]
    assert restrictions(NETWORK, "lab/seer-small") == []
    strict = Card("yolo", "segmenter", "", Tried.REAL_CODE, licence="AGPL-3.0", commercial=False)
    assert "AGPL-3.0" in " ".join(restrictions(strict))


# --- lattices -------------------------------------------------------------------------------------------------------

SIDES = st.integers(40, 900)


@given(SIDES, SIDES, st.sampled_from(["crop", "pad", "stretch"]), st.integers(2, 12), st.integers(2, 12))
@settings(deadline=None, max_examples=60)
def test_corners_of_the_photo_come_where_the_affine_says(
    width: int, height: int, mode: str, rows: int, cols: int
) -> None:
    shape = (14 * rows, 14 * cols)
    f = fit((width, height), shape, mode)  # type: ignore[arg-type]
    corners = np.array([[0, 0, 1], [width, height, 1]]) @ f.affine.T
    (left, top), (right, bottom) = corners
    assert right - left == pytest.approx(f.resized[0])
    assert bottom - top == pytest.approx(f.resized[1])
    inside = f.inside()
    if mode == "pad":
        assert left >= 0
        assert top >= 0
        assert right <= shape[1] + 1e-9
        assert bottom <= shape[0] + 1e-9
    else:
        assert inside.all()
    v, u = np.mgrid[: shape[0], : shape[1]] + 0.5
    naive = (u > left) & (u < right) & (v > top) & (v < bottom)
    np.testing.assert_array_equal(inside, naive)


@pytest.mark.parametrize("mode", ["crop", "pad", "stretch"])
def test_what_the_photo_shows_lies_where_the_affine_says(mode: str) -> None:
    width, height = 300, 200
    u = np.arange(width) + 0.5
    photo = np.zeros((height, width, 3), np.uint8)
    photo[..., 0] = u * 0.8
    photo[..., 1] = (np.arange(height)[:, None] + 0.5) * 0.8
    f = fit((width, height), (84, 112), mode)  # type: ignore[arg-type]
    image, inside = f.image(photo), f.inside()
    back = np.linalg.inv(np.vstack([f.affine, [0, 0, 1]]))
    rows, cols = np.nonzero(inside)
    x, y, _ = back @ np.stack([cols + 0.5, rows + 0.5, np.ones(len(rows))])
    deep = (x > 10) & (x < width - 10) & (y > 10) & (y < height - 10)
    assert np.abs(image[rows, cols, 0] - 0.8 * x)[deep].max() < 2
    assert np.abs(image[rows, cols, 1] - 0.8 * y)[deep].max() < 2
    assert (image[~inside] == 255).all()
    K = np.array([[500.0, 0, 56], [0, 480, 42], [0, 0, 1]])
    np.testing.assert_allclose(np.vstack([f.affine, [0, 0, 1]]) @ f.K_photo(K), K, atol=1e-9)


def test_lattices_of_the_networks_we_know() -> None:
    assert lattice_shape((4000, 3000), 518, 14) == (392, 518)  # VGGT: width 518, height to a multiple of 14
    assert lattice_shape((3000, 4000), 518, 14) == (518, 392)
    assert lattice_shape((4000, 3000), 518, 14, "pad") == (518, 518)
    assert lattice_shape((1920, 1080), 512, 16) == (288, 512)  # MASt3R
    with pytest.raises(InputError, match="use 518 or 532"):
        lattice_shape((4000, 3000), 520, 14)


def test_networks_are_given_red_first() -> None:
    red = np.zeros((4, 6, 3), np.uint8)
    red[..., 0] = 255
    tensor = normalised(red, *IMAGENET)
    assert tensor.shape == (3, 4, 6)
    np.testing.assert_allclose(tensor[:, 0, 0], [(1 - 0.485) / 0.229, -0.456 / 0.224, -0.406 / 0.225], rtol=1e-5)


# --- memory ---------------------------------------------------------------------------------------------------------


def test_memory_that_runs_out_is_halved_and_said() -> None:
    tried: list[int] = []
    said: list[str] = []

    def run(size: int) -> str:
        tried.append(size)
        if size > 5:
            raise RuntimeError("CUDA out of memory. Tried to allocate 2 GiB")
        return "done"

    assert halving(run, 20, 2, said.append) == "done"
    assert tried == [20, 10, 5]
    assert said == ["memory ran out with 20 images at a time; going on with 10.", said[1]]
    with pytest.raises(InputError, match="2 images at a time"):
        halving(lambda size: run(99), 4, 2, said.append)


def test_other_failures_are_not_taken_for_memory() -> None:
    def broken(size: int) -> None:
        raise RuntimeError("shapes do not match")

    with pytest.raises(RuntimeError, match="shapes"):
        halving(broken, 8, 1, lambda sentence: None)
