"""Mistakes of lattices, pictures, evidence and confidence, made on purpose; see tests/mutations.py."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mutating import (
    Mutation,
    bytes_,
    each,
    errors_for_confidence,
    evidence,
    ids,
    image,
    lattice,
    middle_square,
    next_image,
    one_less,
    one_more,
    other_K_photo,
    resized_labels,
    shifted,
    shuffled,
    squeezed,
    swapped_size,
)

LATTICES = [
    Mutation(
        "K of the photo that does not belong to K of the lattice",
        each(other_K_photo),
        "one of both belongs to an image 2 times as large",
        "numbers",
    ),
    Mutation(
        "lattice half a pixel off",
        lattice(lambda A: A + np.array([[0, 0, 0.25], [0, 0, 0.25]])),  # (x + 0.5) / 2 - 0.5 where it is x / 2
        "half a pixel",
        "photos",
    ),
    Mutation("image half a pixel off", image(shifted(0.5, 0.5)), "half a pixel", "photos"),
    Mutation(
        "crop forgotten in the lattice",
        lattice(lambda A: A * np.array([1, 1, 0])),
        "the offset of the crop",
        "photos",
    ),
    Mutation(
        "padding forgotten in the lattice",
        lattice(lambda A: A * np.array([1, 1, 0])),
        "the offset of the",
        "photos",
        "pad",
    ),
    Mutation(
        "lattice of a stretched photo for a cropped one",
        lattice(lambda A: np.array([[364 / 728, 0, 0], [0, 224 / 548, 0]])),
        "the crop is forgotten",
        "photos",
    ),
    Mutation(
        "lattice of another resized size",
        lattice(lambda A: 0.97 * A),
        "the scale of another resized image",
        "photos",
    ),
    Mutation("width and height of the photo swapped", swapped_size, "width and height are swapped (H and W", "photos"),
]
PICTURES = [
    Mutation("BGR image", image(lambda i: i[..., ::-1]), "the channel order is BGR", "photos"),
    Mutation("image mirrored", image(lambda i: i[:, ::-1]), "the images are mirrored left to right", "views"),
    Mutation("image upside down", image(lambda i: i[::-1]), "the images are upside down", "views"),
    Mutation("image turned by 180 degrees", image(lambda i: i[::-1, ::-1]), "turned by 180 degrees", "views"),
    Mutation(
        "image turned by 90 degrees on a square lattice",
        image(lambda i: np.rot90(i)),
        "turned by 90 degrees",
        "photos",
        "pad",
    ),
    Mutation("H and W of the image swapped", image(lambda i: i.swapaxes(0, 1)), "images has shape", "numbers"),
    Mutation(
        "H and W of the image swapped, square lattice",
        image(lambda i: i.swapaxes(0, 1)),
        "rows and columns of the images are swapped",
        "views",
        "pad",
    ),
    Mutation("image in 0..1", image(lambda i: (i / 255).astype(np.uint8)), "values are 0..1 instead", "photos"),
    Mutation("images of other photos", next_image, "do not show what their photos show", "photos"),
]
LAYERS = [
    Mutation(
        "H and W of the points swapped",
        each(
            lambda view: replace(
                view,
                points=np.ascontiguousarray(view.points.swapaxes(0, 1)),
                confidence=view.confidence.T.copy(),
                image=None,
                evidence=np.ascontiguousarray(view.evidence.swapaxes(0, 1)),
                lattice=None,
            )
        ),
        "rows and columns are swapped",
        "numbers",
    ),
    Mutation(
        "H and W of the points swapped, square lattice",
        each(lambda view: replace(view, points=np.ascontiguousarray(view.points.swapaxes(0, 1)))),
        "rows and columns are swapped",
        "numbers",
        "pad",
    ),
    Mutation(
        "H and W of the evidence swapped",
        evidence(lambda e: e.swapaxes(0, 1)),
        "(rows and columns are swapped)",
        "numbers",
    ),
    Mutation(
        "H and W of the evidence swapped, square lattice",
        evidence(lambda e: e.swapaxes(0, 1)),
        "rows and columns of the evidence are swapped",
        "pictures",
        "pad",
    ),
    Mutation("evidence mirrored", evidence(lambda e: e[:, ::-1]), "the evidence is mirrored", "pictures"),
    Mutation("evidence half a pixel off", evidence(shifted(0.5, 0.5)), "half a pixel", "pictures", "pad"),
    Mutation("evidence shifted", evidence(shifted(6, -4)), "the evidence is shifted", "pictures"),
    Mutation("evidence with padding on both sides", evidence(squeezed(True)), "the padding is forgotten", "pictures"),
    Mutation("evidence with padding at the end", evidence(squeezed(False)), "the padding is forgotten", "pictures"),
    Mutation("evidence of the middle square", evidence(middle_square), "the crop is forgotten", "pictures"),
]
CLASSES = [
    Mutation("logits as evidence", evidence(lambda e: 8 * e - 4), "logits need exp or sigmoid first", "numbers"),
    Mutation("positive logits as evidence", evidence(lambda e: 9 * e), "logits are given as evidence", "numbers"),
    Mutation(
        "8-bit scores as evidence",
        evidence(bytes_),
        "scores in 0..255",
        "numbers",
    ),
    Mutation("independent scores that add up to 2", evidence(lambda e: 0.4 + 0.0 * e), "independent scores", "numbers"),
    Mutation("1-based labels", ids(one_more), "(1-based labels)", "witness"),
    Mutation(
        "arg-max index as id",
        ids(one_less),
        "the index of the arg-max channel",
        "witness",
    ),
    Mutation(
        "class ids in another order",
        ids(shuffled),
        "in another order",
        "witness",
    ),
    Mutation("interpolated labels", ids(resized_labels), "resized with interpolation", "numbers"),
]
CONFIDENCES = [
    Mutation(
        "logits as confidence",
        each(lambda view: replace(view, confidence=2 * np.log(view.confidence) - 3)),
        "logits need exp or sigmoid first",
        "numbers",
    ),
    Mutation(
        "confidence declared as 1 + exp without the 1",
        each(lambda view: replace(view, confidence=view.confidence - 1)),
        "another activation than declared",
        "numbers",
    ),
    Mutation(
        "confidence never filled",
        each(lambda view: replace(view, confidence=0 * view.confidence)),
        "the confidence was never filled",
        "numbers",
    ),
    Mutation("uncertainty as confidence", errors_for_confidence, "an uncertainty", "views"),
]
