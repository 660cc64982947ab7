"""Names for the difference between where the lattice puts a picture and where it lies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from excavatwin.contract.cameras import half_pixel
from excavatwin.contract.registration import Affine
from excavatwin.scene.observations import Lattice


@dataclass(frozen=True)
class Displacement:
    """From where a picture should lie to where it does."""

    x: float
    """In the middle of the lattice [px]."""
    y: float
    scale_x: float
    """True size over reported size."""
    scale_y: float
    largest: float
    """At the worst corner [px]."""


def displacement(reported: Affine, fitted: Affine, shape: tuple[int, int]) -> Displacement:
    """How far a picture of shape (H, W) lies beside its place."""
    H, W = shape
    spots = np.array([[W / 2, H / 2], [0, 0], [W, 0], [0, H], [W, H]], float)
    photo = np.concatenate([spots, np.ones((5, 1))], axis=1) @ np.linalg.inv(np.vstack([reported, [0, 0, 1]])).T
    moved = photo @ fitted.T - spots
    ratio = np.linalg.norm(fitted[:, :2], axis=0) / np.linalg.norm(reported[:, :2], axis=0)
    largest = float(np.abs(moved).max())
    return Displacement(float(moved[0, 0]), float(moved[0, 1]), float(ratio[0]), float(ratio[1]), largest)


def placements(size: tuple[int, int], shape: tuple[int, int]) -> dict[str, Affine]:
    """How a photo of ``size`` (width, height) usually comes onto a lattice (H, W), by name."""
    (w, h), (H, W) = size, shape
    found = {"stretched": _affine(W / w, H / h, 0, 0)}
    for name, scale in (("cropped", max(W / w, H / h)), ("padded", min(W / w, H / h))):
        resized = max(1, round(w * scale)), max(1, round(h * scale))
        x, y = resized[0] / w, resized[1] / h
        found[f"{name} in the middle"] = _affine(x, y, (W - resized[0]) // 2, (H - resized[1]) // 2)
        found[f"{name} at the right and below"] = _affine(x, y, 0, 0)
    return found


def described(reported: Lattice, fitted: Affine, shape: tuple[int, int]) -> tuple[str, str]:
    """Cause and remedy of a displacement."""
    found = displacement(reported.affine, fitted, shape)
    size = (reported.width, reported.height)
    usual = _usual(fitted, size, shape)
    if max(abs(found.scale_x - 1), abs(found.scale_y - 1)) * max(shape) > 0.5:
        if usual and not _proportional(reported.affine, fitted, shape):
            return (
                f"the photo was {usual}, which the lattice does not say{_forgotten(usual)}",
                f"give the lattice the affine {_spoken(fitted)}",
            )
        return (
            f"the lattice has the scale of another resized image ({found.scale_x:.3g} x {found.scale_y:.3g} would fit)",
            f"its affine is {_spoken(fitted)}",
        )
    if half_pixel(found.x, found.y):
        return (
            "half a pixel: pixel centres at whole numbers",
            f"pixel centres lie at +0.5 in photo and lattice; add ({found.x:+.2f}, {found.y:+.2f}) to the affine",
        )
    offset, true = reported.affine[:, 2], fitted[:, 2]
    if np.abs(true).max() < 0.5:
        kind = "crop" if offset.min() < -0.5 else "padding"
        return f"the lattice has the offset of a {kind} that was not made", "set the offset of the affine to 0"
    kind = "padding" if (true - offset)[np.argmax(np.abs(true - offset))] > 0 else "crop"
    if np.abs(offset).max() < 0.5 and (usual or np.abs(true).max() > 1):
        return (
            f"the offset of the {kind} is forgotten in the lattice{f' (the photo was {usual})' if usual else ''}",
            f"the affine is {_spoken(fitted)}",
        )
    return f"the offset of the {kind} is wrong", f"the affine is {_spoken(fitted)}"


def _proportional(reported: Affine, fitted: Affine, shape: tuple[int, int]) -> bool:
    """Whether both differ by one factor, as when the image is enlarged or shrunk after its lattice is known."""
    factor = float(np.sqrt(abs(np.linalg.det(fitted[:, :2]) / np.linalg.det(reported[:, :2]))))
    return displacement(factor * reported, fitted, shape).largest < 0.5


def _affine(x: float, y: float, dx: float, dy: float) -> Affine:
    return np.array([[x, 0.0, dx], [0.0, y, dy]])


def _usual(fitted: Affine, size: tuple[int, int], shape: tuple[int, int]) -> str:
    """Which of the usual placements a measured one is; empty when it is none."""
    near = {
        name: displacement(affine, fitted, shape).largest
        for name, affine in placements(size, shape).items()
    }  # fmt: skip
    best = min(near, key=lambda name: near[name])
    return best if near[best] < 1.5 else ""


def _forgotten(usual: str) -> str:
    return {"cropped": ": the crop is forgotten", "padded": ": the padding is forgotten"}.get(usual.split()[0], "")


def _spoken(affine: Affine) -> str:
    rows = (f"[{a:.6g}, {b:.6g}, {c:.2f}]" for a, b, c in np.where(np.abs(affine) < 1e-6, 0.0, affine))
    return f"[{', '.join(rows)}]"
