"""nerfstudio's transforms.json with depth maps or a point cloud; also of Polycam, Record3D and instant-ngp."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import ClassVar

from excavatwin.backbones.cards import Card, Tried
from excavatwin.backbones.finished.clouds import CloudFile
from excavatwin.backbones.finished.depth_images import read_depth
from excavatwin.backbones.finished.found import FoundCamera, Scene
from excavatwin.backbones.finished.lenses import Lens
from excavatwin.backbones.finished.posed_depth import DepthMap
from excavatwin.backbones.finished.reader import Finished
from excavatwin.backbones.finished.transforms_file import read_transforms
from excavatwin.errors import InputError, require

USUAL_UNIT = 1e-3
"""nerfstudio's own default of ``depth_unit_scale_factor``."""


@dataclass(frozen=True)
class Nerfstudio(Finished):
    """``transforms.json`` with ``depth_file_path`` in its frames, else with ``ply_file_path``.

    The file does not say whether its unit is the metre, nor which way is up: with photos from a phone that measures
    (Polycam, Record3D, ARKit), say ``metres_per_unit = 1`` and, for nerfstudio's own exports, ``up = "z"``.
    """

    card: ClassVar[Card] = Card(
        name="nerfstudio",
        kind="reconstructor",
        summary="transforms.json of nerfstudio (Polycam, Record3D, instant-ngp) with depth maps or a cloud",
        tried=Tried.FILES,
        modules=("pycolmap", "cv2"),
        install="pip install --upgrade excavatwin",
        argument="source",
        source="https://docs.nerf.studio/quickstart/data_conventions.html",
    )
    watched: ClassVar[tuple[str, ...]] = ("*.json", "*.ply", "*depth*/*")

    depth_unit_scale_factor: float | None = None
    """What depth values are multiplied by; None for what the file says, else 0.001 (millimetres)."""

    def __post_init__(self) -> None:
        """Check the parameters."""
        super().__post_init__()
        require(self, "depth_unit_scale_factor", 0, open_low=True)

    def read(self, source: Path) -> Scene:
        """Frames, depth maps and cloud."""
        path = source / "transforms.json" if source.is_dir() else source
        if not path.is_file():
            raise InputError(f"{source} holds no transforms.json; give the file or its folder.")
        found = read_transforms(path)
        unit = self.depth_unit_scale_factor or found.unit or USUAL_UNIT
        deep = any(frame.depth is not None for frame in found.frames)
        if not deep and (found.cloud is None or not found.cloud.is_file()):
            raise InputError(
                f"{path} has neither depth_file_path in its frames nor a ply_file_path that exists; export it with "
                "depth, or give a point cloud: --reconstructor cloud:CLOUD."
            )
        doubts = [] if deep else [f"{path} names no depth maps: the photos see its cloud instead."]
        if self.metres_per_unit is None:
            doubts.append(f"{path} does not say whether its unit is the metre; if it is, set metres_per_unit to 1.")
        return Scene(
            where=str(path),
            cameras=tuple(
                FoundCamera(
                    frame.name,
                    frame.lens,
                    frame.T_W_cam,
                    None if frame.depth is None else partial(_depth, frame.depth, frame.lens, unit),
                    "has no depth_file_path",
                )
                for frame in found.frames
            ),
            cloud=None if deep or found.cloud is None else CloudFile(found.cloud),
            doubts=tuple(doubts),
        )


def _depth(path: Path, lens: Lens, unit: float) -> DepthMap:
    depth = read_depth(path, unit)
    return DepthMap(depth, lens.resized(depth.shape[1], depth.shape[0]))
