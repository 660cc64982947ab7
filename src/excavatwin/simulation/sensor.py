"""From light to a photo: dust in the air, smear, exposure, the sensor's tone curve and its grain."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from excavatwin.scene.taxonomy import TaskClass
from excavatwin.simulation.camera import Camera
from excavatwin.simulation.conditions import Conditions
from excavatwin.simulation.site import Contents

DUST_SPREAD = np.array([1.7, 1.7, 1.0])
"""Standard deviations of the cloud along x, y, z [m]."""
DUST_ALBEDO = np.array([0.62, 0.52, 0.40])
"""Light that dust scatters, red green blue."""


def develop(
    radiance: Float32[np.ndarray, "H W 3"], conditions: Conditions, exposure: float, seed: tuple[int, ...]
) -> UInt8[np.ndarray, "H W 3"]:
    """A photo from linear radiance.

    Args:
        exposure: factor that brings a white wall in the sun to about 1.
        seed: of smear, exposure error and grain.
    """
    rng = np.random.default_rng(seed)
    stops, angle, length = rng.normal(), rng.uniform(0, np.pi), rng.gamma(4.0, 0.25)
    light = smeared(radiance, conditions.motion_blur * length, angle)
    linear = np.clip(light * exposure * 2.0 ** (conditions.exposure_drift * stops), 0, None)
    grey = 255 * tone(linear)
    # About even in grey levels: shot noise grows with the root of the light, and the tone curve flattens that.
    noise = conditions.grain * rng.normal(0, 1, linear.shape).astype(np.float32)
    return np.clip(grey + noise, 0, 255).round().astype(np.uint8)


def tone(linear: Float32[np.ndarray, "*n"]) -> Float32[np.ndarray, "*n"]:
    """Display value 0..1: sRGB's curve, with a shoulder above 0.7 that keeps highlights from being cut off."""
    knee = 0.7
    over = np.maximum(linear - knee, 0)
    soft = np.minimum(linear, knee) + (1 - knee) * (1 - np.exp(-over / (1 - knee)))
    return np.where(soft <= 0.0031308, 12.92 * soft, 1.055 * np.maximum(soft, 1e-9) ** (1 / 2.4) - 0.055)


def smeared(image: Float32[np.ndarray, "H W 3"], length: float, angle: float) -> Float32[np.ndarray, "H W 3"]:
    """The picture moved along a line while the shutter is open.

    Args:
        length: of the line [px].
        angle: from the image's x axis [rad].
    """
    if length < 0.5:
        return image
    import cv2

    steps = max(3, int(np.ceil(2 * length)) | 1)
    size = 2 * int(np.ceil(length / 2)) + 3
    kernel = np.zeros((size, size), np.float32)
    for s in np.linspace(-length / 2, length / 2, steps):
        x, y = size // 2 + s * np.cos(angle), size // 2 + s * np.sin(angle)
        i, j = int(np.floor(x)), int(np.floor(y))
        for dj in (0, 1):
            for di in (0, 1):
                kernel[j + dj, i + di] += (1 - abs(x - i - di)) * (1 - abs(y - j - dj))
    return np.asarray(cv2.filter2D(image, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE))


def bucket_place(inside: Contents) -> Float64[np.ndarray, "3"] | None:
    """Where the excavator digs: its part that is farthest out and low; None without an excavator, frame M [m]."""
    for thing in inside.objects:
        if thing.task_class != TaskClass.EXCAVATOR:
            continue
        parts = [b for b, i in zip(inside.bodies, inside.instances, strict=True) if i == thing.object_id]
        middle = np.mean([b.centre for b in parts], axis=0)
        out = [np.hypot(*(b.centre - middle)[:2]) - 0.5 * (b.centre[2] - thing.z_base) for b in parts]
        return np.array(parts[int(np.argmax(out))].centre, float)
    return None


def dusty(
    radiance: Float32[np.ndarray, "H W 3"],
    camera: Camera,
    rays: Float64[np.ndarray, "H W 3"],
    depth: Float64[np.ndarray, "H W"],
    centre: Float64[np.ndarray, "3"],
    optical_depth: float,
    falling: Float64[np.ndarray, "3"],
) -> Float32[np.ndarray, "H W 3"]:
    """The picture through a Gaussian cloud: what is behind it fades, and the cloud itself scatters light.

    Args:
        rays: of unit depth, frame M.
        depth: where each ray ends, NaN for the sky [m].
        optical_depth: through the cloud's middle, along x.
        falling: irradiance of sun and sky.
    """
    from scipy.special import erf

    o = (camera.T_M_cam[:3, 3] - centre) / DUST_SPREAD
    d = rays / DUST_SPREAD
    a = (d * d).sum(-1)
    b = (d * o).sum(-1)
    nearest = np.exp(-0.5 * np.maximum((o * o).sum() - b * b / a, 0))
    end = np.where(np.isnan(depth), 1e4, depth)
    along = np.sqrt(a / 2)
    share = 0.5 * (erf(along * (end + b / a)) - erf(along * (b / a)))
    length = np.linalg.norm(rays, axis=-1) / np.sqrt(a)  # spread of the cloud along the ray [m]
    thickness = optical_depth * nearest * share * length / DUST_SPREAD[0]
    through = np.exp(-thickness)[..., None]
    return (radiance * through + (1 - through) * DUST_ALBEDO * falling / (2 * np.pi)).astype(np.float32)
