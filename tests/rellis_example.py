"""A small RELLIS-3D as its archives unpack: a robot drives along -x over sloping ground towards a row of trees.

Grass stands left of the track, dirt lies right of it. Photos and scans are cast from one scene; the lens distorts.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

#: Official calibration of the example frame: fx fy cx cy at 1920 x 1200, and the camera's pose in the lidar frame.
FX_FY_CX_CY = np.array([2813.643275, 2808.326079, 969.285772, 624.049972])
Q_WXYZ = np.array([-0.50507811, 0.51206185, 0.49024953, -0.49228464])
T_XYZ = np.array([-0.13165462, 0.03870398, -0.17253834])
LENS = np.array([-0.134313, -0.025905, 0.002181, 0.00084, 0])
DIRT, GRASS, TREE, SKY = 1, 3, 4, 7
SCALE = 8  # the photos are 240 x 150
STEP = 0.4  # metres between scans, a tenth of a second apart
START = 1581624663.0
LATER = 0.21  # a photo is taken so much of a turn after its scan


def ground_height(x: np.ndarray) -> np.ndarray:
    return -1.2 + 0.03 * x


def cast(origin: np.ndarray, ray: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance along rays (n, 3) from a point of the world, inf in the sky, and class."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ground = (ground_height(origin[0]) - origin[2]) / (ray[:, 2] - 0.03 * ray[:, 0])
        trees = (-25.0 - origin[0]) / ray[:, 0]
    high = origin[2] + trees * ray[:, 2]
    ground = np.where(ground > 0, ground, np.inf)
    trees = np.where((trees > 0) & (high < 4), trees, np.inf)
    distance = np.minimum(ground, trees)
    side = np.where(origin[1] + np.where(np.isfinite(ground), ground, 0) * ray[:, 1] < 0, GRASS, DIRT)
    label = np.where(trees < ground, TREE, side)
    return distance, np.where(np.isfinite(distance), label, SKY)


def rotation(q: np.ndarray) -> np.ndarray:
    w, x, y, z = q / np.linalg.norm(q)
    S = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * S + 2 * S @ S


def pose(k: float) -> np.ndarray:
    """T_world_lidar at scan k, or between two: the world begins in the first scan, z up."""
    T = np.eye(4)
    T[:3, 3] = (-STEP * k, 0.0, ground_height(np.array(-STEP * k)) - ground_height(np.array(0.0)))
    return T


def camera_pose() -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation(Q_WXYZ), T_XYZ
    return T


def photo_label(k: float) -> np.ndarray:
    """Class image of a photo taken with (or after) scan k, through the lens as OpenCV has it."""
    import cv2

    fx, fy, cx, cy = FX_FY_CX_CY / SCALE
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    col, row = np.meshgrid(np.arange(1920 // SCALE, dtype=float), np.arange(1200 // SCALE, dtype=float))
    xy = cv2.undistortPoints(np.stack([col, row], -1).reshape(-1, 1, 2), K, LENS).reshape(-1, 2)
    T = pose(k) @ camera_pose()
    _, label = cast(T[:3, 3], np.column_stack([xy, np.ones(len(xy))]) @ T[:3, :3].T)
    return label.reshape(col.shape).astype(np.uint8)


def scan(k: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Rows (x, y, z, intensity) and labels of scan k; four tenths have no return but carry a label all the same."""
    azimuth, elevation = np.meshgrid(
        np.linspace(-np.pi, np.pi, 512, endpoint=False), np.deg2rad(np.linspace(-22, 22, 32))
    )
    ray = np.stack([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)], -1)
    ray = ray.reshape(-1, 3)
    distance, label = cast(pose(k)[:3, 3], ray)
    xyz = np.where(np.isfinite(distance)[:, None], ray * np.where(np.isfinite(distance), distance, 0)[:, None], 0)
    blades = (label == GRASS) & np.isfinite(distance)
    xyz[blades, 2] += rng.uniform(0, 0.15, blades.sum())
    xyz[rng.random(len(xyz)) < 0.4] = 0
    return np.column_stack([xyz, np.full(len(xyz), 0.5)]).astype("<f4"), label.astype("<u4")


def write(
    root: Path, scans: int = 6, photos: dict[int, int] | None = None, stamped: bool = True, inverted: bool = False
) -> Path:
    """Unpack a sequence 00000 as its archives do.

    Args:
        photos: number of a photo -> scan that it was taken with; by default numbers that differ.
        stamped: with the coloured clouds, whose names carry the scans' times.
        inverted: with the calibration written in the other direction.
    """
    rng = np.random.default_rng(0)
    photos = {0: 1, 1: 3, 2: 5} if photos is None else photos
    images = root / "Rellis_3D_pylon_camera_node" / "Rellis-3D"
    ids = root / "Rellis_3D_pylon_camera_node_label_id" / "Rellis-3D"
    clouds = root / "Rellis_3D_os1_cloud_node_kitti_bin" / "Rellis-3D"
    calibration = root / "Rellis_3D_calibration" / "Rellis-3D"
    folders = {
        "image": images / "00000" / "pylon_camera_node",
        "label": ids / "00000" / "pylon_camera_node_label_id",
        "bin": clouds / "00000" / "os1_cloud_node_kitti_bin",
        "cloud_label": clouds / "00000" / "os1_cloud_node_semantickitti_label_id",
        "ply": clouds / "00000" / "os1_cloud_node_color_ply",
        "calibration": calibration / "00000",
    }
    for folder in folders.values():
        folder.mkdir(parents=True)
    for number, k in photos.items():
        label = photo_label(k + LATER)
        stem = f"frame{number:06d}-{int(START)}_{round(100 * (k + LATER)):03d}"
        Image.fromarray(label).save(folders["label"] / f"{stem}.png")
        Image.fromarray(np.repeat(label[..., None] * 20, 3, -1)).save(folders["image"] / f"{stem}.jpg")
    for k in range(scans):
        rows, label = scan(k, rng)
        (folders["bin"] / f"{k:06d}.bin").write_bytes(rows.tobytes())
        (folders["cloud_label"] / f"{k:06d}.label").write_bytes(label.tobytes())
        if stamped:
            (folders["ply"] / f"frame{k:06d}-{int(START)}_{100 * k:03d}.ply").touch()
    rows = [" ".join(f"{v:.9f}" for v in pose(k)[:3].ravel()) for k in range(scans)]
    (clouds / "00000" / "poses.txt").write_text("\n".join(rows) + "\n")
    (clouds / "00000" / "calib.txt").write_text("Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n")
    (folders["calibration"] / "camera_info.txt").write_text(" ".join(f"{v:.6f}" for v in FX_FY_CX_CY / SCALE) + "\n")
    q, t = Q_WXYZ, T_XYZ
    if inverted:
        q, t = Q_WXYZ * (1, -1, -1, -1), -rotation(Q_WXYZ).T @ T_XYZ
    lines = ["os1_cloud_node-pylon_camera_node:", "  q:", *(f"    {a}: {v}" for a, v in zip("wxyz", q, strict=True))]
    lines += ["  t:", *(f"    {a}: {v}" for a, v in zip("xyz", t, strict=True))]
    (folders["calibration"] / "transforms.yaml").write_text("\n".join(lines) + "\n")
    stems = sorted(file.stem for file in folders["image"].iterdir())
    listed = {"train": stems[:1], "val": stems[1:2], "test": []}
    for split, names in listed.items():
        text = "".join(f"00000/pylon_camera_node/{s}.jpg 00000/pylon_camera_node_label_id/{s}.png\n" for s in names)
        (root / f"{split}.lst").write_text(text)
    return root
