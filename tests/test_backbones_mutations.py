"""Every usual mistake of convention, made on purpose, is found, and the first finding names it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from excavatwin.contract.findings import Severity
from excavatwin.contract.labels import label_mistakes
from excavatwin.contract.validation import validate
from mutating import Mutation, image, resized_labels, shifted
from mutations import TABLE
from sound_views import SHAPES, one_hot, sound

PAGE = Path(__file__).parent.parent / "docs" / "validation.md"
#: Mistakes with which a map can still be made: told, not refused.
TOLD = {
    "points in camera coordinates, poses lost",
    "everything in millimetres, declared as metres",
    "image half a pixel off",
    "lattice half a pixel off",
    "K half a pixel off",
    "K half a pixel off (depth unprojected with it)",
    "evidence half a pixel off",
    "independent scores that add up to 2",
    "confidence declared as 1 + exp without the 1",
    "confidence never filled",
    "uncertainty as confidence",
}
PALETTE = np.array([[0, 0, 0], [196, 132, 60], [222, 207, 170], [72, 150, 72], [245, 190, 0], [200, 40, 60]], np.uint8)


def findings(mutation: Mutation):
    """What the validator says when it is given no more than the mistake needs."""
    good = sound(mutation.mode)
    photos = good.photos if mutation.by == "photos" else None
    witness = good.witness if mutation.by == "witness" else None
    return validate(mutation.change(good.observations), photos, witness)


@pytest.mark.parametrize("mutation", TABLE, ids=lambda mutation: mutation.mistake)
def test_mistake_is_named_first(mutation: Mutation) -> None:
    found = findings(mutation)
    assert found, "nothing was found"
    assert mutation.named in str(found[0]), [str(one) for one in found]
    assert (found[0].severity is Severity.REPORT) == (mutation.mistake in TOLD), found[0].severity


@pytest.mark.parametrize("mode", SHAPES)
def test_the_unbroken_is_not_accused(mode: str) -> None:
    good = sound(mode)
    assert validate(good.observations, good.photos, good.witness) == ()


def test_half_a_pixel_is_measured() -> None:
    """Sub-pixel registration tells the shift itself, not only its kind."""
    good = sound()
    (found,) = validate(image(shifted(0.5, 0.5))(good.observations), good.photos)
    assert found.figures["shift_x_px"] == pytest.approx(0.5, abs=0.03)
    assert found.figures["shift_y_px"] == pytest.approx(0.5, abs=0.03)


LABELS = {
    "RGB-coded label image": (lambda label: PALETTE[label], "RGB-coded"),
    "grey label image with three channels": (lambda label: np.stack([label] * 3, axis=-1), "grey RGB image"),
    "colours packed into one number": (
        lambda label: PALETTE[label].astype(np.int64) @ np.array([65536, 256, 1]),
        "RGB-coded",
    ),
    "label image counted from 1": (lambda label: label + 1, "counted from 1"),
    "label image of another vocabulary": (lambda label: np.where(label == 2, 30, label), "another vocabulary"),
    "label image resized with interpolation": (resized_labels, "resized with interpolation"),
    "label image of means": (lambda label: label * 0.99, "resized with interpolation"),
}


def label_image() -> np.ndarray:
    evidence = one_hot(sound().observations.views[0]).evidence
    return np.where(evidence.any(-1), evidence.argmax(-1) + 1, 0).astype(np.int64)


@pytest.mark.parametrize("name", LABELS)
def test_label_images(name: str) -> None:
    change, named = LABELS[name]
    (found,) = label_mistakes(change(label_image()), set(range(6)))
    assert named in str(found)
    assert found.severity is Severity.REFUSE


def test_good_label_images_are_not_accused() -> None:
    assert label_mistakes(label_image(), set(range(6))) == ()
    assert label_mistakes(label_image()[::2, ::2].repeat(2, 0).repeat(2, 1), set(range(6))) == ()  # nearest neighbour


def table() -> str:
    """The table of docs/validation.md: every mistake that the tests above inject."""
    rows = ["| mistake | told by | outcome | named by the words |", "|---|---|---|---|"]
    for one in TABLE:
        outcome = "reported" if one.mistake in TOLD else "refused"
        rows.append(f"| {one.mistake} | {one.by} | {outcome} | {one.named} |")
    for name, (_, named) in LABELS.items():
        rows.append(f"| {name} | numbers | refused | {named} |")
    return "\n".join(rows) + "\n"


def test_the_page_lists_what_is_tested() -> None:
    """After a change: ``python tests/test_backbones_mutations.py`` writes the table anew."""
    assert table() in PAGE.read_text()
    assert f"{len(TABLE) + len(LABELS)} mistakes" in PAGE.read_text()


if __name__ == "__main__":
    text = re.sub(r"(\|.*\n)+", lambda _: table(), PAGE.read_text(), count=1)
    PAGE.write_text(re.sub(r"\d+ mistakes", f"{len(TABLE) + len(LABELS)} mistakes", text))
