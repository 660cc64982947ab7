"""A small Objectron clip, written byte by byte: AR stream, annotation, index, and a video where asked for.

Corners are drawn by OpenGL's projection as the data set's own notebook does it (matrices, then column from the second
and row from the first normalised coordinate), not by the formulas of the reader under test.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

SENSOR = (160, 120)
FX, FY, CX, CY = 130.0, 131.0, 78.0, 62.0
#: Along the box's x, y (up), z [m].
SIZE = np.array([0.30, 0.12, 0.20])
CENTRE = np.array([0.1, 0.06, -0.05])  # world y up; the box stands on y = 0
YAW = 0.4
UNIT = np.array([[0, 0, 0], *([x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5))])


def varint(value: int) -> bytes:
    value &= (1 << 64) - 1
    out = b""
    while value > 0x7F:
        out += bytes([value & 0x7F | 0x80])
        value >>= 7
    return out + bytes([value])


def integer(number: int, value: int) -> bytes:
    return varint(number << 3) + varint(value)


def single(number: int, value: float) -> bytes:
    return varint(number << 3 | 5) + struct.pack("<f", value)


def double(number: int, value: float) -> bytes:
    return varint(number << 3 | 1) + struct.pack("<d", value)


def counted(number: int, content: bytes) -> bytes:
    return varint(number << 3 | 2) + varint(len(content)) + content


def packed(number: int, values: np.ndarray) -> bytes:
    return counted(number, np.asarray(values, "<f4").tobytes())


def loose(number: int, values: np.ndarray) -> bytes:
    return b"".join(single(number, float(v)) for v in np.ravel(values))


def box_rotation() -> np.ndarray:
    c, s = np.cos(YAW), np.sin(YAW)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def transform(k: int, count: int) -> np.ndarray:
    """Camera-to-world of frame k, OpenGL axes of the sensor, for a phone that is held upright."""
    angle = 0.5 * k / count
    eye = np.array([0.9 * np.sin(angle), 0.5, 0.9 * np.cos(angle)])
    back = (eye - CENTRE) / np.linalg.norm(eye - CENTRE)
    right = np.cross([0.0, 1, 0], back)
    right /= np.linalg.norm(right)
    up = np.cross(back, right)
    T = np.eye(4)
    # Upright, the sensor's x runs down the phone and its y to the right.
    T[:3, 0], T[:3, 1], T[:3, 2], T[:3, 3] = -up, right, back, eye
    return T


def projection() -> np.ndarray:
    width, height = SENSOR
    P = np.zeros((4, 4))
    P[0, 0], P[0, 2] = 2 * FX / width, 1 - 2 * CX / width
    P[1, 1], P[1, 2] = 2 * FY / height, 2 * CY / height - 1
    P[2, 2], P[2, 3], P[3, 2] = -1, -0.001, -1
    return P


def drawn(points: np.ndarray, T: np.ndarray, landscape: bool) -> np.ndarray:
    """Where points of the world lie in the photo as shown, in widths and heights from the top left."""
    view = np.linalg.inv(T)
    clip = np.column_stack([points, np.ones(len(points))]) @ (projection() @ view).T
    ndc = clip[:, :2] / clip[:, 3:]
    if landscape:
        return np.column_stack([(1 + ndc[:, 0]) / 2, (1 - ndc[:, 1]) / 2])
    return (1 + ndc[:, ::-1]) / 2


def camera(T: np.ndarray, packing=packed, columns_first: bool = False) -> bytes:
    K = np.array([[FX, 0, CX], [0, FY, CY], [0, 0, 1]])
    K = K.T if columns_first else K
    return (
        integer(1, 3)
        + packing(3, T)
        + integer(5, SENSOR[0])
        + integer(6, SENSOR[1])
        + packing(7, K)
        + packing(8, projection())
        + packing(9, np.linalg.inv(T))
    )


def annotation(poses: list[np.ndarray], category: str, landscape: bool) -> bytes:
    R = box_rotation()
    corners = (UNIT * SIZE) @ R.T + CENTRE
    keypoints = b"".join(counted(7, b"".join(single(i + 1, float(v)) for i, v in enumerate(p))) for p in UNIT)
    box = integer(1, 0) + counted(2, category.encode()) + integer(3, 1)
    out = counted(1, box + packed(4, R) + packed(5, CENTRE) + packed(6, SIZE) + keypoints)
    for k, T in enumerate(poses):
        if k % 2:  # not every frame is annotated
            continue
        uv = drawn(corners, T, landscape)
        points = b"".join(
            counted(2, integer(1, i) + counted(3, single(1, u) + single(2, v) + single(3, 0.9)))
            for i, (u, v) in enumerate(uv)
        )
        out += counted(
            2, integer(1, k) + counted(2, integer(1, 0) + points) + counted(3, camera(T)) + double(4, k / 30)
        )
    return out


def write(
    root: Path,
    name: str = "chair/batch-3/12",
    category: str = "chair",
    landscape: bool = False,
    jump: float = 0.0,
    stream: bool = True,
    video: bool = False,
    packing=packed,
    columns_first: bool = False,
    count: int = 12,
) -> Path:
    """One clip as in the bucket.

    Args:
        category: what the annotation calls its object.
        jump: metres by which the pose leaps before frame 8.
        packing: how floats are stored; readers must take both.
    """
    poses = [transform(k, count) for k in range(count)]
    for T in poses[8:]:
        T[0, 3] += jump
    clip = root / "videos" / name
    clip.mkdir(parents=True)
    if stream:
        frames = [double(1, k / 30) + counted(4, camera(T, packing, columns_first)) for k, T in enumerate(poses)]
        content = b"".join(len(frame).to_bytes(4, "little") + frame for frame in frames)
        (clip / "geometry.pbdata").write_bytes(content)
    file = root / "annotations" / f"{name}.pbdata"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(annotation(poses, category, landscape))
    (root / "index").mkdir(exist_ok=True)
    index = root / "index" / f"{name.split('/')[0]}_annotations_train"
    index.write_text((index.read_text() if index.exists() else "") + name + "\n")
    if video or not stream:
        write_video(clip / "video.MOV", SENSOR if landscape else SENSOR[::-1], count)
    return root


def write_video(path: Path, size: tuple[int, int], count: int) -> None:
    """Frame k is grey of brightness 10 k."""
    import av

    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=30)
        stream.width, stream.height = size
        stream.pix_fmt = "yuv420p"
        for k in range(count):
            image = np.full((size[1], size[0], 3), 10 * k, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())
