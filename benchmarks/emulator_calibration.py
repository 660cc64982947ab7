"""The emulated segmenters against the paper's backbone rows (tab:semantic_accuracy), and the emulated geometry's drift.

    python benchmarks/emulator_calibration.py [--seeds 100 101 ...] [--picture FILE.jpg]

Twelve orbit views of 518 x 392 a site, on the random sites that are for tuning (100-107). mIoU is strict, over the five
task classes, per pixel, unknown = wrong, on pixels whose true world point lies on the site's square; a pixel is
labelled when its best evidence is at least 0.2. "voted" is the plain mean of all views in 15 cm voxels of the TRUE
geometry, and "stays" the share of wrong pixels that this leaves wrong: the part of the errors that sticks to the world.
"agreed" and the second "stays" are the same after the mapper's colour-guided agreement, over the TRUE terrain. The
last row has the same errors as the OCES one, but none that follow looks. Each site is rendered once, with colours: a
minute or two a site. The figures stand in docs/emulators.md.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from excavatwin.scene.taxonomy import PALETTE, TERRAIN_CLASSES, K
from excavatwin.semantics.agreement import agreed
from excavatwin.semantics.consistency import Consistency
from excavatwin.simulation import RenderedView, orbit, random_site, render_view
from excavatwin.simulation.camera import Camera
from excavatwin.simulation.emulators import Mask2FormerLike, VggtLike, YoloeLike, true_similarity

ROWS = {
    "YOLOE on OCES": (YoloeLike(), 6.53, 2.70),
    "Mask2Former on OCES": (Mask2FormerLike(), 34.71, 91.85),
    "YOLOE on GOOSE-Ex": (YoloeLike.goose_ex(), 3.34, 2.57),
    "Mask2Former on GOOSE-Ex": (Mask2FormerLike.goose_ex(), 21.40, 94.26),
    "Mask2Former on OCES, look=0": (Mask2FormerLike(look=0, skill=1.655, nothing=0.84), 34.71, 91.85),
}
"""Emulator, and the paper's mIoU and coverage of the backbone alone [%]."""
LABELLED = 0.2
"""Least evidence of a labelled pixel."""
VOXEL = 0.15
"""[m]"""


@dataclass(frozen=True, eq=False)
class Seen:
    """A site's true views, and which pixels are scored."""

    seed: int
    views: list[RenderedView]
    cameras: tuple[Camera, ...]
    scored: np.ndarray

    def pick(self, images: list[np.ndarray]) -> np.ndarray:
        """The scored pixels of images of every view, one after the other."""
        return np.concatenate([image[use] for image, use in zip(images, self.scored, strict=True)])


def look(seed: int, views: int = 12) -> Seen:
    """Fly over a random site."""
    site = random_site(seed)
    cameras = orbit(views, width=518, aspect=392 / 518, seed=seed)
    seen = [render_view(site, camera, samples=1) for camera in cameras]
    with np.errstate(invalid="ignore"):
        scored = np.array([(np.abs(view.points[..., :2]) <= site.extent / 2).all(-1) for view in seen])
    return Seen(seed, seen, cameras, scored)


def labels(evidence: np.ndarray) -> np.ndarray:
    """Class of the best evidence, 0 where it is too weak."""
    return np.where(evidence.max(-1) >= LABELLED, evidence.argmax(-1) + 1, 0)


def scores(evidence: np.ndarray, true: np.ndarray) -> dict[str, np.ndarray]:
    """Strict mIoU, coverage, IoU by class, share of the labelled that is right, and what their scores claim [%]."""
    found = labels(evidence)
    counts = np.bincount(true.astype(int) * (K + 1) + found, minlength=(K + 1) ** 2).reshape(K + 1, K + 1)[1:]
    hit = np.diag(counts[:, 1:])
    iou = np.where(counts.sum(1) > 0, hit / np.maximum(counts.sum(1) + counts[:, 1:].sum(0) - hit, 1), np.nan)
    labelled = found > 0
    return {
        "mIoU": 100 * np.nanmean(iou),
        "coverage": 100 * labelled.mean(),
        "iou": 100 * iou,
        "right": 100 * (found == true)[labelled].mean(),
        "claimed": 100 * evidence.max(-1)[labelled].mean(),
    }


def voted(seen: Seen, evidence: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(evidence of voxels, voxel of the scored pixels) by voting: mean over a view's pixels, then over the views."""
    cell = np.floor(seen.pick([view.points for view in seen.views]) / VOXEL).astype(np.int64) + 2000
    _, voxel = np.unique((cell[:, 0] * 4000 + cell[:, 1]) * 4000 + cell[:, 2], return_inverse=True)
    views = len(seen.views)
    number = np.repeat(np.arange(views), seen.scored.sum((1, 2)))
    sample, of_pixel = np.unique(voxel * views + number, return_inverse=True)
    size, seen_by = np.bincount(of_pixel), np.bincount(sample // views)
    mean = [
        np.bincount(sample // views, np.bincount(of_pixel, evidence[:, k]) / size) / seen_by for k in range(K)
    ]  # fmt: skip
    return np.stack(mean, -1).astype(np.float32), voxel


def guided(seen: Seen, vote: np.ndarray, voxel: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Votes after the mapper's colour-guided agreement among the voxels that are mostly terrain in truth."""
    size = np.bincount(voxel)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(voxel, column) / size for column in values.T], -1).astype(np.float32)

    stage = Consistency()
    terrain = np.bincount(voxel, np.isin(true, TERRAIN_CLASSES)) > size / 2
    xy = mean(seen.pick([view.points for view in seen.views]))[terrain, :2]
    rgb = mean(seen.pick([view.image for view in seen.views]))[terrain]
    expected = agreed(xy, rgb, vote[terrain], stage.radius * VOXEL, stage.ridge)
    after = vote.copy()
    spoke = vote[terrain].any(-1, keepdims=True)
    after[terrain] += stage.agreement * spoke * (expected - vote[terrain])
    return after


def calibration(seen: Seen, evidence: list[np.ndarray]) -> dict[str, np.ndarray]:
    """Scores of a segmenter on a site, and what voting and agreement on the true geometry make of them."""
    alone, true = seen.pick(evidence), seen.pick([view.label for view in seen.views])
    vote, voxel = voted(seen, alone)
    wrong = labels(alone) != true
    out = scores(alone, true)
    for name, of_voxels in (("voted", vote), ("agreed", guided(seen, vote, voxel, true))):
        out[name] = scores(of_voxels[voxel], true)["mIoU"]
        out[f"{name} stays"] = 100 * (labels(of_voxels[voxel]) != true)[wrong].mean()
    return out


def drift(seen: Seen, geometry: VggtLike) -> tuple[float, float, float]:
    """(error of a point [% of its distance, median], views' mean offset from each other [same], elevation MAE [m])."""
    observations = geometry(seen.views, seen.cameras, seen.seed)
    T = true_similarity(observations, seen.views)
    error = [a.points @ T[:3, :3].T + T[:3, 3] - b.points for a, b in zip(observations.views, seen.views, strict=True)]
    depth = seen.pick([view.depth for view in seen.views])
    relative = np.linalg.norm(seen.pick(error), axis=-1) / depth
    mean = np.array([np.nanmedian(e[use], axis=0) for e, use in zip(error, seen.scored, strict=True)])
    apart = np.sqrt(2) * np.linalg.norm(mean - mean.mean(0), axis=1).mean() / np.median(depth)
    return 100 * float(np.nanmedian(relative)), 100 * float(apart), float(np.nanmean(np.abs(seen.pick(error)[:, 2])))


def picture(seen: Seen, numbers: tuple[int, ...], path: Path) -> None:
    """Photo, truth, YOLOE-like and Mask2Former-like labels of some views, one view a row; pale = low score."""
    from PIL import Image

    palette = np.full((256, 3), 255, np.uint8)
    for k, colour in PALETTE.items():
        palette[k] = colour
    evidence = [segmenter(seen.views, seen.cameras, seen.seed) for segmenter, _, _ in list(ROWS.values())[:2]]
    rows = []
    for i in numbers:
        row = [seen.views[i].image, palette[seen.views[i].label]]
        for images in evidence:
            found, score = labels(images[i]), images[i].max(-1, keepdims=True)
            tint = 255 - score * (255 - palette[found].astype(float))
            row.append(np.where((found == 0)[..., None], 225, tint).astype(np.uint8))
        rows.append(np.concatenate(row, 1))
    Image.fromarray(np.concatenate(rows)).save(path, quality=85)


def main() -> None:
    """Print the calibration table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(100, 108)))
    parser.add_argument("--picture", type=Path, help="picture of two views of the first site")
    arguments = parser.parse_args()
    found: dict[str, list[dict[str, np.ndarray]]] = {name: [] for name in ROWS}
    drifts = []
    for seed in arguments.seeds:
        pictured = arguments.picture is not None and seed == arguments.seeds[0]
        seen = look(seed)
        drifts.append(drift(seen, VggtLike()))
        for name, (segmenter, _, _) in ROWS.items():
            found[name].append(calibration(seen, segmenter(seen.views, seen.cameras, seed)))
        if pictured:
            picture(seen, (0, 5), arguments.picture)
    columns = ["backbone", "mIoU", "paper", "coverage", "paper", "CT", "OT", "RC", "EX", "OB", "right", "claimed"]
    columns += ["voted", "stays", "agreed", "stays"]
    print("|", " | ".join(columns), "|")
    print("|" + "---|" * len(columns))
    for name, (_, miou, coverage) in ROWS.items():
        mean = {key: np.nanmean([site[key] for site in found[name]], axis=0) for key in found[name][0]}
        iou = " | ".join(f"{value:.1f}" for value in mean["iou"])
        print(
            f"| {name} | {mean['mIoU']:.2f} | {miou:.2f} | {mean['coverage']:.2f} | {coverage:.2f} | {iou} "
            f"| {mean['right']:.1f} | {mean['claimed']:.1f} | {mean['voted']:.2f} | {mean['voted stays']:.0f} "
            f"| {mean['agreed']:.2f} | {mean['agreed stays']:.0f} |"
        )
    error, apart, elevation = np.mean(drifts, axis=0)
    print(
        f"\nVGGT-like: a point is {error:.2f} % of its distance off (median), two views lie {apart:.2f} % apart, "
        f"elevation is {100 * elevation:.1f} cm off (mean), all after the best similarity."
    )


if __name__ == "__main__":
    main()
