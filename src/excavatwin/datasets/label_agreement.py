"""Does a scan fit its photo? Labelled returns are projected into the labelled photo and asked what they see there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float64, UInt8

from excavatwin.scene.frames import invert_rigid, transform
from excavatwin.scene.recording import PointCloud

#: Returns that must land in the photo before their agreement tells anything.
ENOUGH = 50
#: Least share of agreeing returns; the right calibration of RELLIS-3D reaches 77 %, the inverted one 0.03 %.
LEAST = 0.5


@dataclass(frozen=True)
class Agreement:
    """How many labelled returns land in the photo, and how many of them find their own class there."""

    landed: int
    agreed: int

    @property
    def share(self) -> float:
        """Of the landed returns, 0..1; 0 when too few land."""
        return self.agreed / self.landed if self.landed >= ENOUGH else 0.0


def label_agreement(
    cloud: PointCloud,
    label: UInt8[np.ndarray, "H W"],
    K_cam: Float64[np.ndarray, "3 3"],
    distortion: tuple[float, float, float, float],
    T_L_cam: Float64[np.ndarray, "4 4"],
    ignored: tuple[int, ...] = (0,),
) -> Agreement:
    """Compare the labels of returns with those of the pixels that they project to.

    Args:
        T_L_cam: pose of the camera in the frame of the scan.
        ignored: ids that do not count, on either side.
    """
    if cloud.label is None:
        return Agreement(0, 0)
    uv, inside = project_distorted(cloud.xyz, K_cam, distortion, T_L_cam, (label.shape[1], label.shape[0]))
    seen = label[uv[inside, 1].astype(int), uv[inside, 0].astype(int)]
    told = cloud.label[inside]
    counted = ~np.isin(seen, ignored) & ~np.isin(told, ignored)
    return Agreement(int(counted.sum()), int((seen == told)[counted].sum()))


def project_distorted(
    xyz: Float[np.ndarray, "N 3"],
    K_cam: Float64[np.ndarray, "3 3"],
    distortion: tuple[float, float, float, float],
    T_L_cam: Float64[np.ndarray, "4 4"],
    size: tuple[int, int],
) -> tuple[Float64[np.ndarray, "N 2"], Bool[np.ndarray, "N"]]:
    """Pixels of points in a photo with lens distortion (Brown's model), and which lie in front and inside."""
    p = transform(invert_rigid(T_L_cam), np.asarray(xyz, np.float64))
    front = p[:, 2] > 0.1
    z = np.where(front, p[:, 2], 1.0)
    x, y = p[:, 0] / z, p[:, 1] / z
    # The polynomial folds far rays back into the photo: keep those that a lens without distortion would nearly see.
    near = (np.abs(x * K_cam[0, 0]) < size[0]) & (np.abs(y * K_cam[1, 1]) < size[1])
    k1, k2, p1, p2 = distortion
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    yd = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    uv = np.stack([xd * K_cam[0, 0] + K_cam[0, 2], yd * K_cam[1, 1] + K_cam[1, 2]], -1)
    inside = front & near & (uv >= 0).all(1) & (uv[:, 0] < size[0]) & (uv[:, 1] < size[1])
    return uv, inside
