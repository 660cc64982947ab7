"""Cameras and boxes of Objectron's two files, in our conventions.

ARKit's world is y up, its cameras look along -z with x to the right of the *landscape* sensor; the clips are portrait,
so that the photo's right is the camera's +y and its down the camera's +x. Field numbers are those of the schemas
``a_r_capture_metadata.proto``, ``annotation_data.proto`` and ``object.proto`` of google-research-datasets/Objectron.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from excavatwin.datasets.wire_format import Message, split_stream
from excavatwin.errors import InputError
from excavatwin.scene.frames import project

#: Our world (z up) from ARKit's (y up): x stays, y becomes z.
R_W_AR = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
#: Camera of ARKit from ours, for photos shown upright and as the sensor lies. Columns: our right, down, forward.
R_AR_CAM = {
    "portrait": np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]),
    "landscape": np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]]),
}
#: Corners 1..8 of a box of unit size, x slowest, as the keypoints are numbered after the centre.
UNIT_BOX = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


@dataclass(frozen=True, eq=False)
class ArCamera:
    """One frame's camera as ARKit wrote it."""

    time: float
    """[s]"""
    T_AR_gl: Float64[np.ndarray, "4 4"]
    """Camera-to-world, OpenGL axes of the landscape sensor, world y up [m]."""
    K_sensor: Float64[np.ndarray, "3 3"]
    """Intrinsics of the landscape sensor [px]."""
    resolution: tuple[int, int]
    """Width, height of the landscape sensor [px]."""
    tracked: bool
    """Whether ARKit called its tracking normal (or did not say)."""

    def pose(self, orientation: str) -> Float64[np.ndarray, "4 4"]:
        """Camera-to-world in our world, OpenCV axes of the photo as shown."""
        T_W_cam = np.eye(4)
        T_W_cam[:3, :3] = R_W_AR @ self.T_AR_gl[:3, :3] @ R_AR_CAM[orientation]
        T_W_cam[:3, 3] = R_W_AR @ self.T_AR_gl[:3, 3]
        return T_W_cam

    def intrinsics(self, orientation: str, size: tuple[int, int]) -> Float64[np.ndarray, "3 3"]:
        """Of the photo as shown, of ``size`` = (width, height) pixels.

        With u = fx x/d + cx and v = cy - fy y/d on the sensor, the upright photo has its column at H - v and its row at
        u: the focal lengths change places.
        """
        (fx, _, cx), (_, fy, cy) = self.K_sensor[0], self.K_sensor[1]
        width, height = self.resolution
        if orientation == "portrait":
            K, shown = np.array([[fy, 0, height - cy], [0, fx, cx], [0, 0, 1.0]]), (height, width)
        else:
            K, shown = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), (width, height)
        return np.diag([size[0] / shown[0], size[1] / shown[1], 1.0]) @ K


@dataclass(frozen=True, eq=False)
class ArBox:
    """A box that a person fitted to an object."""

    object_id: int
    category: str
    R_AR_box: Float64[np.ndarray, "3 3"]
    t_AR_box: Float64[np.ndarray, "3"]
    size: Float64[np.ndarray, "3"]
    """Along the box's x, y (up) and z [m]."""

    def corners(self) -> Float64[np.ndarray, "8 3"]:
        """Corners in our world, in the order of the keypoints."""
        return ((UNIT_BOX * self.size) @ self.R_AR_box.T + self.t_AR_box) @ R_W_AR.T

    def pose(self) -> Float64[np.ndarray, "4 4"]:
        """Box-to-world with the box's axes reordered so that the third is its top: x, -z, y."""
        T_W_object = np.eye(4)
        T_W_object[:3, :3] = R_W_AR @ self.R_AR_box @ R_W_AR.T
        T_W_object[:3, 3] = R_W_AR @ self.t_AR_box
        return T_W_object


@dataclass(frozen=True, eq=False)
class Annotated:
    """One annotated frame: where the corners of the first box were drawn."""

    index: int
    corners: Float64[np.ndarray, "8 2"]
    """In widths and heights of the photo as shown, from its top left corner."""
    camera: ArCamera | None
    object_id: int


def read_ar_stream(path: Path) -> list[ArCamera]:
    """The cameras of ``geometry.pbdata``, one a frame of the clip.

    Raises:
        InputError: the file is damaged, or a frame has no camera.
    """
    try:
        frames = [Message(part) for part in split_stream(path.read_bytes())]
        cameras = [_camera(frame.message(4), frame.number(1)) for frame in frames]
    except (OSError, InputError) as error:
        raise InputError(f"{path} is no AR stream of Objectron: {error}") from error
    absent = next((i for i, camera in enumerate(cameras) if camera is None), None)
    if absent is not None or not cameras:
        raise InputError(f"{path}: frame {absent or 0} has no camera; download the file again.")
    return [camera for camera in cameras if camera is not None]


def read_annotation(path: Path) -> tuple[list[ArBox], list[Annotated]]:
    """Boxes and annotated frames of an annotation file.

    Raises:
        InputError: the file is damaged, or a box is incomplete.
    """
    try:
        message = Message(path.read_bytes())
        boxes = [_box(part) for part in message.messages(1)]
        frames = [found for part in message.messages(2) if (found := _annotated(part)) is not None]
    except (OSError, InputError) as error:
        raise InputError(f"{path} is no annotation of Objectron: {error}") from error
    return boxes, frames


def best_orientation(
    cameras: dict[int, ArCamera], boxes: list[ArBox], frames: list[Annotated]
) -> tuple[str, float | None]:
    """How the clip is shown, as told by the drawn corners; portrait where nothing was drawn.

    Args:
        cameras: by frame of the clip.

    Returns:
        Orientation, and the median miss of our projection [widths of the photo]; None where nothing was drawn.
    """
    corners = {box.object_id: box.corners() for box in boxes}
    misses: dict[str, list[float]] = {orientation: [] for orientation in R_AR_CAM}
    for frame in frames[:: max(1, len(frames) // 20)]:
        camera = cameras.get(frame.index, frame.camera)
        if camera is None or frame.object_id not in corners:
            continue
        for orientation, found in misses.items():
            K = camera.intrinsics(orientation, (1, 1))
            uv, depth = project(K, camera.pose(orientation), corners[frame.object_id])
            found += np.where(depth > 0, np.linalg.norm(uv - frame.corners, axis=1), np.inf).tolist()
    if not any(misses.values()):
        return "portrait", None
    medians = {orientation: float(np.median(found)) for orientation, found in misses.items()}
    best = min(medians, key=lambda orientation: medians[orientation])
    return best, medians[best]


def _camera(message: Message, time: float) -> ArCamera | None:
    transform, intrinsics = message.floats(3), message.floats(7)
    if len(transform) != 16 or len(intrinsics) != 9:
        return None
    K = intrinsics.reshape(3, 3)
    if K[0, 2] == 0 and K[2, 0] != 0:  # some writers store columns first
        K = K.T
    size = (message.integer(5, 1920), message.integer(6, 1440))
    return ArCamera(time, transform.reshape(4, 4), K, size, message.integer(1, 3) in (0, 3))


def _box(message: Message) -> ArBox:
    R, t, size = message.floats(4), message.floats(5), message.floats(6)
    if len(R) != 9 or len(t) != 3 or len(size) != 3 or (size <= 0).any():
        raise InputError(f"object {message.integer(1)} lacks rotation, translation or scale.")
    return ArBox(message.integer(1), message.text(2), R.reshape(3, 3), t, size)


def _annotated(message: Message) -> Annotated | None:
    """The first object that was drawn in a frame, with its eight corners; the first keypoint is the centre."""
    for part in message.messages(2):
        points = [keypoint.message(3) for keypoint in part.messages(2)]
        if len(points) == 9:
            corners = np.array([(point.number(1), point.number(2)) for point in points[1:]])
            camera = _camera(message.message(3), message.number(4))
            return Annotated(message.integer(1), corners, camera, part.integer(1))
    return None
