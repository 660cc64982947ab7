"""Where the scanner of RELLIS-3D was, scan by scan, and in between when a photo was taken."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64

from excavatwin.datasets.readers import read_matrix
from excavatwin.scene.recording import Scan

#: Poses farther apart in time are not interpolated [s].
GAP = 0.5
#: The world of the poses is doubted when it leans more than this against the scanner's mean up [deg].
LEAN = 15.0


def read_poses(path: Path | None) -> Float64[np.ndarray, "n 4 4"]:
    """T_world_lidar of every scan: rows of 3 x 4, row-major, as KITTI writes them; none without a file.

    Raises:
        InputError: a row is damaged.
    """
    rows = read_matrix(path, 12) if path else np.zeros((0, 12))
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3] = rows.reshape(-1, 3, 4)
    return poses


def poses_at(
    times: Float64[np.ndarray, "m"], scans: Sequence[Scan]
) -> tuple[Float64[np.ndarray, "m 4 4"], Bool[np.ndarray, "m"]]:
    """T_world_lidar at times between scans, and where it is known: the robot turns and drives while a scan lasts.

    Positions are interpolated linearly, rotations along the shortest arc.
    """
    from scipy.spatial.transform import Rotation, Slerp

    known = {scan.time: scan.T_W_L for scan in scans if scan.time is not None and scan.T_W_L is not None}
    poses = np.tile(np.eye(4), (len(times), 1, 1))
    if len(known) < 2 or not len(times):
        return poses, np.zeros(len(times), bool)
    clock = np.array(sorted(known))
    T = np.array([known[time] for time in clock])
    after = np.clip(np.searchsorted(clock, times), 1, len(clock) - 1)
    between = (times >= clock[after - 1]) & (times <= clock[after]) & (clock[after] - clock[after - 1] <= GAP)
    inside = np.clip(times, clock[0], clock[-1])
    poses[:, :3, :3] = Slerp(clock - clock[0], Rotation.from_matrix(T[:, :3, :3]))(inside - clock[0]).as_matrix()
    poses[:, :3, 3] = np.stack([np.interp(inside, clock, T[:, axis, 3]) for axis in range(3)], axis=-1)
    return poses, between


def tilt(poses: Float64[np.ndarray, "n 4 4"]) -> float:
    """Angle between the world's z axis and the scanner's mean up [deg]; 0 without poses.

    The robot drives on open ground: on average its scanner stands upright, and so does a world that is fit for heights.
    """
    if not len(poses):
        return 0.0
    up = poses[:, :3, 2].mean(0)
    return float(np.degrees(np.arccos(np.clip(up[2] / np.linalg.norm(up), -1, 1))))
