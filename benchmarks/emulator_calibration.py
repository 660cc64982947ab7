"""The emulated segmenters against the paper's backbone rows (tab:semantic_accuracy), and the emulated geometry's drift.

    python benchmarks/emulator_calibration.py [--seeds 100 101 ...] [--pictures FOLDER]

Twelve orbit views of 518 x 392 a site, on the random sites that are for tuning (100-107). mIoU is strict, over the five
task classes, per pixel, unknown = wrong, on pixels whose true world point lies on the site's square; a pixel is
labelled when its best evidence is at least 0.2. A class without a true pixel on a site does not count there. About
15 s a site, most of it rendering. The figures stand in docs/emulators.md.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from excavatwin.scene.taxonomy import PALETTE, K
from excavatwin.simulation import RenderedView, orbit, random_site, render_view
from excavatwin.simulation.camera import Camera
from excavatwin.simulation.emulators import Mask2FormerLike, VggtLike, YoloeLike, true_similarity
from excavatwin.simulation.emulators.emulation import Segmenter

ROWS: dict[str, tuple[Segmenter, float, float]] = {
    "YOLOE on OCES": (YoloeLike(), 6.53, 2.70),
    "Mask2Former on OCES": (Mask2FormerLike(), 34.71, 91.85),
    "YOLOE on GOOSE-Ex": (YoloeLike.goose_ex(), 3.34, 2.57),
    "Mask2Former on GOOSE-Ex": (Mask2FormerLike.goose_ex(), 21.40, 94.26),
}
"""Emulator, and the paper's mIoU and coverage [%]."""
LABELLED = 0.2


@dataclass(frozen=True, eq=False)
class Seen:
    """A site's true views, and which pixels are scored."""

    seed: int
    views: list[RenderedView]
    cameras: tuple[Camera, ...]
    scored: np.ndarray


def look(seed: int, views: int = 12, samples: int = 0) -> Seen:
    """Fly over a random site."""
    site = random_site(seed)
    cameras = orbit(views, width=518, aspect=392 / 518, seed=seed)
    seen = [render_view(site, camera, samples=samples) for camera in cameras]
    with np.errstate(invalid="ignore"):
        scored = np.array([(np.abs(view.points[..., :2]) <= site.extent / 2).all(-1) for view in seen])
    return Seen(seed, seen, cameras, scored)


def labels(evidence: np.ndarray) -> np.ndarray:
    """Class of the best evidence, 0 where it is too weak."""
    return np.where(evidence.max(-1) >= LABELLED, evidence.argmax(-1) + 1, 0)


def scores(seen: Seen, evidence: list[np.ndarray]) -> dict[str, object]:
    """Strict mIoU, coverage, IoU by class, share of labelled pixels that are right, and the claimed share."""
    e = np.array(evidence)[seen.scored]
    found, true = labels(e), np.array([view.label for view in seen.views])[seen.scored]
    counts = np.bincount(true * (K + 1) + found, minlength=(K + 1) ** 2).reshape(K + 1, K + 1)[1:]
    hit = np.diag(counts[:, 1:])
    iou = np.where(counts.sum(1) > 0, hit / np.maximum(counts.sum(1) + counts[:, 1:].sum(0) - hit, 1), np.nan)
    labelled = found > 0
    return {
        "mIoU": 100 * np.nanmean(iou),
        "coverage": 100 * labelled.mean(),
        "iou": 100 * iou,
        "right": 100 * (found == true)[labelled].mean(),
        "claimed": 100 * e.max(-1)[labelled].mean(),
        "counts": counts,
    }


def drift(seen: Seen, geometry: VggtLike) -> tuple[float, float, float]:
    """(median distance error [%] of the distance, disagreement of views [%], mean elevation error [m])."""
    observations = geometry(seen.views, seen.cameras, seen.seed)
    T = true_similarity(observations, seen.views)
    error = np.array([v.points @ T[:3, :3].T + T[:3, 3] for v in observations.views])
    error -= np.array([v.points for v in seen.views])
    own = [e[s] for e, s in zip(error, seen.scored, strict=True)]
    depth = np.array([v.depth for v in seen.views])[seen.scored]
    relative = np.linalg.norm(np.concatenate(own), axis=-1) / depth
    means = np.array([np.nanmedian(e, axis=0) for e in own])
    apart = np.sqrt(2) * np.linalg.norm(means - means.mean(0), axis=1).mean() / np.median(depth)
    return 100 * float(np.nanmedian(relative)), 100 * float(apart), float(np.nanmean(np.abs(np.concatenate(own)[:, 2])))


def picture(seen: Seen, evidence: dict[str, list[np.ndarray]], numbers: tuple[int, ...], path: Path) -> None:
    """Photo, truth and labels of some views side by side, one view a row."""
    from PIL import Image

    palette = np.zeros((256, 3), np.uint8)
    for k, colour in PALETTE.items():
        palette[k] = colour
    rows = []
    for i in numbers:
        view = seen.views[i]
        row = [view.image, palette[view.label]]
        row += [np.where(view.label[..., None] == 255, 255, palette[labels(e[i])]) for e in evidence.values()]
        rows.append(np.concatenate([part.astype(np.uint8) for part in row], 1))
    Image.fromarray(np.concatenate(rows)).save(path)


def main() -> None:
    """Print the calibration table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(100, 108)))
    parser.add_argument("--pictures", type=Path, help="folder for pictures of the first site")
    arguments = parser.parse_args()
    found: dict[str, list[dict[str, object]]] = {name: [] for name in ROWS}
    drifts = []
    for seed in arguments.seeds:
        first = arguments.pictures and seed == arguments.seeds[0]
        seen = look(seed, samples=2 if first else 0)
        drifts.append(drift(seen, VggtLike()))
        for name, (segmenter, _, _) in ROWS.items():
            evidence = segmenter(seen.views, seen.cameras, seed)
            found[name].append(scores(seen, evidence))
            if first:
                arguments.pictures.mkdir(parents=True, exist_ok=True)
                picture(seen, {name: evidence}, (0, 5), arguments.pictures / f"{name.replace(' ', '_')}.png")
    print("| backbone | mIoU % | paper | coverage % | paper | CT | OT | RC | EX | OB | right % | claimed % |")
    print("|---|---|---|---|---|---|---|---|---|---|---|---|")
    for name, (_, miou, coverage) in ROWS.items():
        keys = ("mIoU", "coverage", "right", "claimed")
        mean = {key: np.mean([site[key] for site in found[name]]) for key in keys}
        iou = " | ".join(f"{value:.1f}" for value in np.nanmean([s["iou"] for s in found[name]], axis=0))
        print(
            f"| {name} | {mean['mIoU']:.2f} | {miou:.2f} | {mean['coverage']:.2f} | {coverage:.2f} | {iou} "
            f"| {mean['right']:.1f} | {mean['claimed']:.1f} |"
        )
    error, apart, elevation = np.mean(drifts, axis=0)
    print(f"\nVGGT-like: points {error:.2f} % of the distance off (median), views {apart:.2f} % apart, "
          f"elevation {100 * elevation:.1f} cm off (mean).")  # fmt: skip


if __name__ == "__main__":
    main()
