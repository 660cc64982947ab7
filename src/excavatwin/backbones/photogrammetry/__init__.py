"""Photos to world points on the CPU, without weights: structure from motion, then dense multi-view depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np

from excavatwin.backbones.cards import Card, Tried
from excavatwin.backbones.photogrammetry.dense import Dense
from excavatwin.backbones.photogrammetry.placement import Placement
from excavatwin.backbones.photogrammetry.placing import Placing
from excavatwin.errors import InputError
from excavatwin.scene.frames import unproject
from excavatwin.scene.observations import Observations, View
from excavatwin.scene.photo import Photo
from excavatwin.scene.progress import Progress, silent
from excavatwin.scene.taxonomy import TASK_CLASSES

__all__ = ["Dense", "Photogrammetry", "Placement", "Placing"]


@dataclass(frozen=True)
class Photogrammetry:
    """The built-in reconstructor: for every photo a world point map, its confidence, pose and intrinsics."""

    card: ClassVar[Card] = Card(
        name="photogrammetry",
        kind="reconstructor",
        summary="structure from motion and dense stereo on the CPU, without weights; metric with GPS or a length",
        tried=Tried.BUILT_IN,
        modules=("pycolmap", "cv2"),
        install="pip install --upgrade excavatwin",
    )

    placing: Placing = field(default_factory=Placing)
    """How the photos are placed."""
    lattice: int = 640
    """Longer side of the lattice on which depth is found; smaller photos keep their size [px]."""
    dense: Dense = field(default_factory=Dense)
    """How depth is found."""

    def identity(self) -> str:
        """Versions of the libraries."""
        from excavatwin.backbones.extras import versions

        return versions(self.card)

    def __call__(
        self, photos: Sequence[Photo], progress: Progress = silent, scratch: Path | None = None
    ) -> Observations:
        """Place the photos, then find their depth: ``place`` and ``densify`` in one; ``scratch`` is not needed."""
        return self.densify(self.place(photos, progress), photos, progress)

    def place(self, photos: Sequence[Photo], progress: Progress = silent) -> Placement:
        """Poses, lens, sparse points, vertical and, where GPS allows it, scale and map coordinates.

        Raises:
            InputError: fewer than three readable photos.
            ReconstructionError: no three photos hang together.
        """
        from excavatwin.backbones.photogrammetry.georeference import upright
        from excavatwin.backbones.photogrammetry.poses import structure_from_motion

        return upright(structure_from_motion(photos, self.placing, progress), photos)

    def densify(self, placement: Placement, photos: Sequence[Photo], progress: Progress = silent) -> Observations:
        """Depth of every placed photo as world points; evidence is all zero until a segmenter fills it.

        Confidence is the number of photos that confirm a pixel's depth (at least two, three in oblique photos).

        Raises:
            InputError: a placed photo is no longer among ``photos`` or can no longer be read.
        """
        from excavatwin.backbones.photogrammetry.dense import densify
        from excavatwin.backbones.photogrammetry.undistortion import undistort

        of_name = {photo.name: photo for photo in photos}
        missing = [camera.name for camera in placement.cameras if camera.name not in of_name]
        if missing:
            raise InputError(
                f"Photo {missing[0]} was placed but is no longer there; put it back or place the photos again."
            )
        images, lattices = [], []
        for done, camera in enumerate(placement.cameras):
            progress("undistortion", done, len(placement.cameras))
            image, lattice = undistort(camera, of_name[camera.name], self.lattice)
            images.append(image)
            lattices.append(lattice)
        progress("undistortion", len(images), len(images))
        views = []
        depths = densify(images, placement.points, self.dense, progress)
        for image, lattice, (depth, support) in zip(images, lattices, depths, strict=True):
            known = np.isfinite(depth) if image.valid is None else np.isfinite(depth) & (image.valid > 0)
            view = View(
                name=image.name,
                points=unproject(np.where(known, depth, np.float32(np.nan)), image.K_cam, image.T_R_cam),
                confidence=np.where(known, support, 0).astype(np.float32),
                evidence=np.zeros((*depth.shape, len(TASK_CLASSES)), np.float32),
                T_R_cam=image.T_R_cam,
                K_cam=image.K_cam,
                image=image.image,
                lattice=lattice,
            )
            views.append(view)
        return Observations(
            views=tuple(views),
            up=np.array([0.0, 0.0, 1.0]),
            metres_per_unit=placement.metres_per_unit,
            georeference=placement.georeference,
            unplaced=placement.unplaced,
            doubts=placement.doubts,
            source={
                "reconstructor": "photogrammetry",
                "gravity": placement.up_from,
                "calibration": placement.calibration,
                "confidence": "photos that agree",
                **placement.source,
            },
        )

    @staticmethod
    def save_placement(placement: Placement, folder: Path) -> Path:
        """Write ``placement.npz`` into an existing folder."""
        from excavatwin.backbones.photogrammetry.placement_file import save_placement

        return save_placement(placement, folder)

    @staticmethod
    def load_placement(folder: Path) -> Placement:
        """Read what ``save_placement`` wrote."""
        from excavatwin.backbones.photogrammetry.placement_file import load_placement

        return load_placement(folder)
