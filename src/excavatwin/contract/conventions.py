"""Readings that other conventions would give to the same numbers, each with the name of the mistake and its remedy.

A view whose depth was unprojected with a wrong pose still meets its own pixels; only other views can tell.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from excavatwin.contract.crossing import Glimpse, Intrinsics, Pose, Reading
from excavatwin.scene.frames import invert_rigid

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Mistake:
    """A usual mistake, and how the numbers are to be read if it was made."""

    reading: Reading
    cause: str
    remedy: str


def mistakes(glimpses: Sequence[Glimpse]) -> Iterator[Mistake]:
    """All usual mistakes of pose, intrinsics, depth and picture, the most frequent first."""
    yield from _POSES
    yield from _DEPTHS
    yield from _intrinsics(glimpses)
    yield from _PICTURES


def _transposed(T: Pose) -> Pose:
    turned = T.copy()
    turned[:3, :3] = T[:3, :3].T
    return turned


def _moved(T: Pose) -> Pose:
    """The rotation is camera-to-world already, the translation still world-to-camera."""
    moved = T.copy()
    moved[:3, 3] = -T[:3, :3] @ T[:3, 3]
    return moved


_POSES = (
    Mistake(
        Reading(pose=invert_rigid),
        "the poses are world-to-camera (inverted)",
        "invert them before unprojecting; T_R_cam must be camera-to-world",
    ),
    Mistake(
        Reading(pose=lambda T: T @ OPENGL),
        "the camera axes are OpenGL's (y up, z backward)",
        "negate the second and third column of the poses before unprojecting",
    ),
    Mistake(
        Reading(pose=lambda T: invert_rigid(OPENGL @ T)),
        "the poses are world-to-camera with OpenGL axes",
        "invert them, then negate their second and third column",
    ),
    Mistake(
        Reading(pose=_transposed),
        "the rotation is transposed (row-major read as column-major)",
        "transpose the 3 x 3 block of the poses before unprojecting",
    ),
    Mistake(
        Reading(pose=_moved),
        "the translation is that of world-to-camera beside a camera-to-world rotation",
        "the camera's position is -R t, with R camera-to-world",
    ),
)

_DEPTHS = (
    Mistake(
        Reading(stretch=lambda ray: 1 / np.sqrt(1 + (ray**2).sum(axis=1))),
        "the depth is the length of the ray, not the distance along the optical axis",
        "divide it by the length of the ray (x/z, y/z, 1) before unprojecting",
    ),
    Mistake(
        Reading(stretch=lambda ray: np.sqrt(1 + (ray**2).sum(axis=1))),
        "depth along the optical axis was unprojected with rays of unit length",
        "unproject with rays (x/z, y/z, 1)",
    ),
    Mistake(
        Reading(stretch=lambda ray: 1e-3),
        "the depth is in millimetres while the poses are in metres",
        "divide the depth by 1000",
    ),
    Mistake(
        Reading(stretch=lambda ray: 1e3),
        "the depth is in metres while the poses are in millimetres",
        "divide the translations of the poses by 1000",
    ),
)

_PICTURES = (
    Mistake(Reading(picture=lambda tone: tone[:, ::-1]), "the images are mirrored left to right", "flip them back"),
    Mistake(Reading(picture=lambda tone: tone[::-1]), "the images are upside down (mirrored)", "flip their rows"),
    Mistake(
        Reading(picture=lambda tone: tone[::-1, ::-1]),
        "the images are turned by 180 degrees",
        "honour the EXIF orientation of the photos (read_photo does)",
    ),
    Mistake(
        Reading(picture=lambda tone: tone.T if tone.shape[0] == tone.shape[1] else tone),
        "rows and columns of the images are swapped",
        "swap the first two axes of the images",
    ),
)


def _intrinsics(glimpses: Sequence[Glimpse]) -> Iterator[Mistake]:
    """Mistakes that put the principal point off the middle."""
    K, shape = glimpses[0].K, glimpses[0].depth.shape
    across, down = K[0, 2] / (shape[1] / 2), K[1, 2] / (shape[0] / 2)
    if max(abs(across - 1), abs(down - 1)) < 0.02:
        return
    ratio = (across + down) / 2
    if abs(across - down) < 0.02 * ratio:
        scale = np.array([[1 / ratio], [1 / ratio], [1.0]])
        yield Mistake(
            Reading(intrinsics=lambda K, shape: K * scale),
            f"K belongs to an image {ratio:.3g} times as large",
            f"divide its first two rows by {ratio:.4g} before unprojecting",
        )
    if abs(K[0, 2] - shape[0] / 2) < 0.02 * shape[0] and abs(K[1, 2] - shape[1] / 2) < 0.02 * shape[1]:
        yield Mistake(
            Reading(intrinsics=lambda K, shape: K[np.ix_((1, 0, 2), (1, 0, 2))]),
            "x and y of K are swapped (rows taken for columns, H for W)",
            "K is fx 0 cx / 0 fy cy / 0 0 1, with x along a row",
        )
    dx, dy = K[0, 2] - shape[1] / 2, K[1, 2] - shape[0] / 2
    forgotten = "padding" if min(dx, dy) < -0.5 else "crop"
    yield Mistake(
        Reading(intrinsics=_centred),
        f"the {forgotten} is forgotten in K, whose principal point is ({dx:+.0f}, {dy:+.0f}) px off the middle",
        f"take {dx:.0f} from cx and {dy:.0f} from cy: the offset of the image on the lattice",
    )


def _centred(K: Intrinsics, shape: tuple[int, int]) -> Intrinsics:
    centred = K.copy()
    centred[:2, 2] = shape[1] / 2, shape[0] / 2
    return centred
