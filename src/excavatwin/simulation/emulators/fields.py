"""Smooth random fields: errors of networks come in patches, some fixed to the picture, some to the world."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32

from excavatwin.simulation.camera import Camera
from excavatwin.simulation.render import RenderedView

OCTAVE_RATIO = 3.0
"""Wavelength of the first octave of a field over that of its second."""
OCTAVE_GAIN = 0.6
"""Amplitude of the second octave over that of the first."""
VALUE_NOISE_STD = 0.369
"""Standard deviation of one octave of the noise kernel, averaged over space: sqrt(0.743^3 / 3)."""


def stream(seed: int, *keys: int) -> np.random.Generator:
    """A generator of its own for each combination of keys, such as (stage, view) or (stage, object)."""
    return np.random.default_rng([seed, *keys])


def patches(
    shape: tuple[int, int], wavelength: float, rng: np.random.Generator, channels: int = 1
) -> Float32[np.ndarray, "H W C"]:
    """Gaussian fields of unit standard deviation over a picture: two octaves, the first of ``wavelength`` pixels.

    Args:
        shape: (H, W) of the picture.
        wavelength: distance over which a field forgets itself [px].
        channels: number of independent fields.
    """
    out = np.zeros((*shape, channels), np.float32)
    for length, amplitude in ((wavelength, 1.0), (wavelength / OCTAVE_RATIO, OCTAVE_GAIN)):
        for channel in range(channels):
            out[..., channel] += amplitude * spread(shape, length, rng)
    return out / np.float32(np.hypot(1.0, OCTAVE_GAIN))


def spread(shape: tuple[int, int], wavelength: float, rng: np.random.Generator) -> Float32[np.ndarray, "H W"]:
    """One Gaussian field of unit variance everywhere: random knots every ``wavelength`` pixels, smoothly joined."""
    import cv2

    rows, cols = (int(np.ceil(n / wavelength)) + 3 for n in shape)
    knots = rng.normal(size=(rows, cols)).astype(np.float32)
    shift = rng.uniform(1, 2, 2)
    v, u = (np.arange(n, dtype=np.float32) / wavelength + s for n, s in zip(shape, shift, strict=True))
    grid_u, grid_v = np.meshgrid(u.astype(np.float32), v.astype(np.float32))
    return cv2.remap(knots, grid_u, grid_v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE) / 0.83


def anchored(
    points: Float32[np.ndarray, "*n 3"], wavelength: float, seed: int, channels: int = 1
) -> Float32[np.ndarray, "*n C"]:
    """Fields of about unit standard deviation that belong to the world: the same at a point in every view.

    Args:
        points: world points, frame M [m]; a field is 0 where they are NaN.
        wavelength: distance over which a field forgets itself [m].
        channels: number of independent fields.
    """
    from excavatwin.kernels.noise import noise_points

    flat = np.ascontiguousarray(points.reshape(-1, 3), np.float32)
    scale = np.float32(1 / (VALUE_NOISE_STD * np.hypot(1.0, OCTAVE_GAIN)))
    seeds = stream(seed, 0xF1E1D).integers(0, 2**31, channels)
    fields = [scale * noise_points(flat, wavelength, OCTAVE_RATIO, OCTAVE_GAIN, 2, int(s)) for s in seeds]
    return np.stack(fields, -1).reshape(*points.shape[:-1], channels)


def footprint(view: RenderedView, camera: Camera, window: int = 15) -> Float32[np.ndarray, "H W"]:
    """Length of surface that a pixel covers along its longer side, smoothed over ``window`` pixels [m].

    Far and grazing pixels cover more; networks see less detail there. NaN in the sky.
    """
    import cv2

    seen = np.isfinite(view.depth)
    points = np.where(seen[..., None], view.points, 0).astype(np.float32)
    size = np.zeros_like(view.depth)
    for axis in (0, 1):
        step = np.linalg.norm(np.diff(points, axis=axis, append=points.take([-1], axis)), axis=-1)
        size = np.maximum(size, step)
    square = view.depth / np.float32(camera.focal)  # of a surface that faces the camera
    size = np.where(seen, np.clip(size, square, 8 * square), 0)  # steps across depth edges are not surface
    weight = cv2.blur(seen.astype(np.float32), (window, window))
    return np.where(seen, cv2.blur(size, (window, window)) / np.maximum(weight, 1e-6), np.nan).astype(np.float32)
