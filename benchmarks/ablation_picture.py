"""What the parts of the method do to one photo of a simulated site: the picture beside the ablation.

    python benchmarks/ablation_picture.py [--seed 200] [--view 0] -o docs/ablation.jpg

Rows: emulated YOLOE and Mask2Former. Columns: photo and truth, the backbone alone, plain 3D voting, the full method,
and where its label changes (black) without view reliability and without object support.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from excavatwin.mapper import Mapper, Memory
from excavatwin.scene.taxonomy import NOT_OBSERVED, PALETTE
from excavatwin.scene.trace import Trace
from excavatwin.studies.ablation import configurations, with_references
from excavatwin.studies.cases import SEGMENTERS, Case, simulated_case
from excavatwin.studies.pixels import LABELLED

CHANGED = ("w/o view reliability", "w/o object support")


def painted(label: np.ndarray) -> np.ndarray:
    """Label image in the palette."""
    table = np.full((256, 3), 255, np.uint8)
    for k, colour in PALETTE.items():
        table[int(k)] = colour
    return table[label]


def fused(trace: Trace, view: int) -> np.ndarray:
    """The fused label image of one view; unknown where a pixel has no point."""
    return trace.points.unflatten(trace.labels.label[trace.voxels.of_point], 0)[view]


def row(case: Case, view: int) -> list[tuple[str, np.ndarray]]:
    """Names and pictures of one backbone."""
    seen, true = case.observations.views[view], case.labels[view]
    outside = true == NOT_OBSERVED
    best = seen.evidence.max(axis=-1)
    alone = np.where(best >= LABELLED, seen.evidence.argmax(axis=-1) + 1, 0)
    memory: Memory = {}
    mappers = configurations(with_references(Mapper(), case))
    label = {name: fused(mappers[name].trace(case.observations, memory=memory), view)
             for name in ("full method", "plain 3D voting", *CHANGED)}  # fmt: skip

    def scored(image: np.ndarray) -> np.ndarray:
        return painted(np.where(outside, NOT_OBSERVED, image).astype(np.uint8))

    assert seen.image is not None
    changes = np.full((*true.shape, 3), 255, np.uint8)
    pictures = [("photo", seen.image), ("truth", scored(true)), ("backbone", scored(alone))]
    pictures += [(name, scored(label[name])) for name in ("plain 3D voting", "full method")]
    for name in CHANGED:
        differs = (label[name] != label["full method"]) & ~outside
        pictures.append((f"changed {name}", np.where(differs[..., None], 0, changes).astype(np.uint8)))
    return pictures


def main() -> None:
    """Draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=200)
    parser.add_argument("--view", type=int, default=0)
    parser.add_argument("-o", "--output", type=Path, required=True)
    wanted = parser.parse_args()
    rows = [row(simulated_case(wanted.seed, name), wanted.view) for name in SEGMENTERS]
    width, height, margin = 300, 227, 16
    sheet = Image.new("RGB", (len(rows[0]) * width, len(rows) * (height + margin)), "white")
    draw = ImageDraw.Draw(sheet)
    for y, (backbone, pictures) in enumerate(zip(SEGMENTERS, rows, strict=True)):
        for x, (name, picture) in enumerate(pictures):
            corner = (x * width, y * (height + margin))
            draw.text((corner[0] + 4, corner[1] + 2), f"{backbone}-like: {name}", fill="black")
            sheet.paste(Image.fromarray(picture).resize((width - 4, height - 2)), (corner[0], corner[1] + margin))
    sheet.save(wanted.output, quality=85, optimize=True)


if __name__ == "__main__":
    main()
