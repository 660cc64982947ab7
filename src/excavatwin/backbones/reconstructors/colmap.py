"""COLMAP's results: a sparse model, and the depth maps or the fused cloud of its dense steps (Schönberger 2016)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from excavatwin.backbones.cards import Card, Tried
from excavatwin.backbones.finished.clouds import CloudFile
from excavatwin.backbones.finished.colmap_files import (
    PosedImage,
    SparseModel,
    dense_folder,
    depth_maps,
    models_in,
    read_array,
    read_model,
)
from excavatwin.backbones.finished.found import FoundCamera, Scene
from excavatwin.backbones.finished.lenses import Lens
from excavatwin.backbones.finished.posed_depth import DepthMap
from excavatwin.backbones.finished.reader import Finished
from excavatwin.errors import InputError

SAME = 1e-3
"""Models share a frame when their cameras agree within this share of the distance between cameras."""


@dataclass(frozen=True)
class Colmap(Finished):
    """A COLMAP workspace: ``sparse/`` and ``dense/``, or one of the two; binary or text.

    Depth comes from ``stereo/depth_maps/*.geometric.bin`` (else ``*.photometric.bin``, else ``fused.ply``), which lie
    on the undistorted images. The photos may be those or the original ones; for the originals the model with their
    lens is looked for beside the dense folder. COLMAP's pixel centres lie at +0.5, as ours do.
    """

    card: ClassVar[Card] = Card(
        name="colmap",
        kind="reconstructor",
        summary="a COLMAP workspace: sparse model with depth maps or fused cloud",
        tried=Tried.FILES,
        modules=("pycolmap", "cv2"),
        install="pip install --upgrade excavatwin",
        argument="source",
        source="https://github.com/colmap/colmap",
    )
    watched: ClassVar[tuple[str, ...]] = ("cameras.*", "images.*", "points3D.*", "*metric.bin", "fused.ply")

    def read(self, source: Path) -> Scene:
        """Model, depth maps and lenses of a workspace."""
        if not source.is_dir():
            raise InputError(f"{source} is a file; give the folder that holds COLMAP's sparse/ and dense/.")
        dense = dense_folder(source)
        if dense is None:
            raise InputError(_no_depth(source))
        inside = models_in(dense / "sparse") if (dense / "sparse").is_dir() else []
        if not inside:
            raise InputError(f"{dense} holds dense results but no model in sparse/; give COLMAP's whole dense folder.")
        model = read_model(inside[0])
        original = _original(source, dense, model)
        maps = {
            name: path for name in model.images if (path := _map_of(dense, name)) is not None
        }  # only files that are there
        fused = dense / "fused.ply"
        if not maps and not fused.is_file():
            raise InputError(_no_depth(source))
        doubts = []
        rough = sum(path.name.endswith(".photometric.bin") for path in maps.values())
        if rough:
            doubts.append(f"{rough} depth maps of {dense} were not checked against other views (photometric.bin).")
        if not maps:
            doubts.append(f"{dense} holds no depth maps: the photos see {fused.name} instead.")
        cameras = [_camera(name, image, original, dense, maps.get(name)) for name, image in model.images.items()]
        return Scene(
            where=str(dense),
            cameras=tuple(cameras),
            cloud=None if maps else CloudFile(fused),
            confidence="constant: COLMAP's files tell none",
            doubts=tuple(doubts),
        )


def _camera(name: str, image: PosedImage, original: SparseModel | None, dense: Path, path: Path | None) -> FoundCamera:
    lens = original.images[name].lens if original is not None and name in original.images else image.lens
    return FoundCamera(
        name=name,
        lens=lens,
        T_W_cam=image.T_W_cam,
        depth=None if path is None else (lambda: _depth(path, image.lens)),
        lack="has no stereo/depth_maps/*.geometric.bin",
        undistorted=(image.lens, dense / "images" / name),
    )


def _depth(path: Path, lens: Lens) -> DepthMap:
    depth = read_array(path)
    return DepthMap(depth, lens.resized(depth.shape[1], depth.shape[0]))


def _map_of(dense: Path, name: str) -> Path | None:
    paths = (depth_maps(dense) / f"{name}.{kind}.bin" for kind in ("geometric", "photometric"))
    return next((path for path in paths if path.is_file()), None)


def _original(source: Path, dense: Path, model: SparseModel) -> SparseModel | None:
    """The model of the photos before undistortion, in the same frame; of several the one with the most images."""
    own = {path.resolve() for path in models_in(dense)}
    folders = [path for root in (source, source.parent, dense.parent) for path in _quietly(root) if path not in own]
    best = None
    for folder in dict.fromkeys(folders):
        found = read_model(folder)
        shared = [name for name in found.images if name in model.images]
        if shared and _same_frame(found, model, shared) and (best is None or len(shared) > best[0]):
            best = (len(shared), found)
    return best[1] if best else None


def _quietly(root: Path) -> list[Path]:
    return models_in(root) if root.is_dir() else []


def _same_frame(a: SparseModel, b: SparseModel, shared: Sequence[str]) -> bool:
    first, second = (np.array([model.images[name].T_W_cam for name in shared]) for model in (a, b))
    spread = max(float(np.ptp(first[:, :3, 3], axis=0).max()), 1e-12)
    near = np.abs(first[:, :3, 3] - second[:, :3, 3]).max() < SAME * spread or len(shared) == 1
    return bool(near and np.abs(first[:, :3, :3] - second[:, :3, :3]).max() < SAME)


def _no_depth(source: Path) -> str:
    models = models_in(source)
    if not models:
        return f"{source} holds no COLMAP model; give the folder with sparse/ and dense/ (cameras, images, points3D)."
    return (
        f"{source} holds a sparse COLMAP model but no depth; run `colmap image_undistorter --image_path PHOTOS "
        f"--input_path {models[0]} --output_path {source / 'dense'}` and `colmap patch_match_stereo --workspace_path "
        f"{source / 'dense'}` (needs CUDA), or give a point cloud of the same frame: --reconstructor cloud:CLOUD."
    )
