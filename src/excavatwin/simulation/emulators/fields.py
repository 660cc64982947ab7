"""Smooth random fields: errors of networks come in patches, some fixed to the picture, some to the world."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32

from excavatwin.errors import InputError
from excavatwin.simulation.camera import Camera
from excavatwin.simulation.render import RenderedView

OCTAVE_RATIO = 3.0
"""Wavelength of the first octave of a field over that of its second."""
OCTAVE_GAIN = 0.6
"""Amplitude of the second octave over that of the first."""
VALUE_NOISE_STD = 0.369
"""Standard deviation of one octave of the noise kernel, averaged over space: sqrt(0.743^3 / 3)."""
LAB_PATCH = 20.0
"""Difference of colour over which a field that follows looks forgets itself [CIE L*a*b* units]: about that between dry
and wet soil, or between pale and dark grass."""
LAB_BLUR = 2.0
"""Blur before colours are compared, standard deviation [px]: networks judge a neighbourhood, not a pixel's grain."""


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


def look_alike(view: RenderedView, seed: int, channels: int = 1) -> Float32[np.ndarray, "H W C"]:
    """Fields of about unit standard deviation that belong to colours: the same wherever, and in whichever view, things
    look the same.

    Args:
        view: a view with colours.
        seed: of the functions of colour; the same seed gives the same ones in every view and site.
        channels: number of independent fields.
    """
    return anchored(lab(view), LAB_PATCH, seed, channels)


def lab(view: RenderedView) -> Float32[np.ndarray, "H W 3"]:
    """Colours of a view, a little blurred, in CIE L*a*b* (D65)."""
    import cv2

    smooth = cv2.GaussianBlur(view.image.astype(np.float32) / 255, (0, 0), LAB_BLUR)
    return cv2.cvtColor(smooth, cv2.COLOR_RGB2LAB)


def require_colours(owner: object, views: Sequence[RenderedView]) -> None:
    """Refuse views without colours where errors are to follow looks.

    Args:
        owner: the segmenter.

    Raises:
        InputError: a view's image is black all over, as that of truth without colours is.
    """
    for number, view in enumerate(views):
        if not view.image.any():
            raise InputError(
                f"View {number} is black all over, but {type(owner).__name__}.look needs colours; "
                "render it with samples of at least 1, or set look=0."
            )


def lasting_field(
    view: RenderedView, wavelength: float, look: float, seeds: tuple[int, int], channels: int = 1
) -> Float32[np.ndarray, "H W C"]:
    """Fields of about unit standard deviation that are the same in every view: by place, and by looks.

    Args:
        view: a view; with colours when ``look`` is above 0.
        wavelength: distance over which the part that belongs to places forgets itself [m].
        look: share of the variance that follows looks, 0..1.
        seeds: of the part that belongs to places, and of the part that follows looks.
        channels: number of independent fields.
    """
    by_place = anchored(view.points, wavelength, seeds[0], channels)
    if look == 0:
        return by_place
    alike = look_alike(view, seeds[1], channels)
    return np.float32(np.sqrt(1 - look)) * by_place + np.float32(np.sqrt(look)) * alike


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
