"""Intrinsics against the lattice, and the unit against common sense: what a camera's numbers say by themselves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from excavatwin.contract.findings import Finding, named, refusal, report
from excavatwin.scene.observations import Observations, View

#: K and the lattice may differ by this at any corner of the lattice [px].
CONSISTENT = 0.2
#: A principal point farther from the middle of its photo than this share of its longer side is doubtful.
OFF_MIDDLE = 0.1
#: Median distances outside this range are not those of photos of a work site [m].
SENSIBLE = (0.2, 1500.0)


def intrinsics(views: Sequence[View]) -> tuple[Finding, ...]:
    """Mistakes of K and of the lattice that show without any point or picture."""
    return (*_against_lattice(views), *_half_pixel(views), *_principal_point(views))


def units(observations: Observations) -> tuple[Finding, ...]:
    """Whether what is declared to be metres can be metres."""
    unit = observations.metres_per_unit
    if unit is None or observations.georeference is not None:
        return ()
    reach = [_reach(view) for view in observations.views]
    known = [one for one in reach if np.isfinite(one)]
    if not known:
        return ()
    distance = unit * float(np.median(known))
    if SENSIBLE[0] <= distance <= SENSIBLE[1]:
        return ()
    far = distance > SENSIBLE[1]
    cause = "millimetres are declared as metres" if far else "metres are declared as millimetres, or there is no scale"
    remedy = f"set metres_per_unit to {unit / 1000 if far else unit * 1000:g}, or to None when the unit is arbitrary"
    return (
        report(
            f"the cameras are {distance:,.3g} m from what they see, by metres_per_unit = {unit:g}",
            cause,
            remedy,
            distance_m=distance,
        ),
    )


def off_middle(view: View) -> float:
    """Distance of the principal point from the middle of the photo, as a share of its longer side."""
    point, size = view.K_cam[:2, 2], np.array(view.shape[::-1], float)
    if view.lattice is not None:
        A = view.lattice.affine
        point = np.linalg.solve(A[:, :2], point - A[:, 2])
        size = np.array([view.lattice.width, view.lattice.height], float)
    return float(np.linalg.norm(point - size / 2) / size.max())


def _against_lattice(views: Sequence[View]) -> tuple[Finding, ...]:
    """K_cam must be the intrinsics of the photo carried over to the lattice."""
    wrong, shifts, ratios = [], [], []
    for view in views:
        if view.lattice is None:
            continue
        carried = np.vstack([view.lattice.affine, [0, 0, 1]]) @ view.lattice.K_photo
        H, W = view.shape
        corners = np.array([[0.0, 0, 1], [W, 0, 1], [0, H, 1], [W, H, 1]])
        there = corners @ np.linalg.inv(view.K_cam).T @ carried.T
        if np.abs(there[:, :2] - corners[:, :2]).max() > CONSISTENT:
            wrong.append(view.name)
            shifts.append(view.K_cam[:2, 2] - carried[:2, 2])
            ratios.append(np.diag(view.K_cam)[:2] / np.diag(carried)[:2])
    if not wrong:
        return ()
    dx, dy = np.median(shifts, axis=0)
    across, down = (float(r) for r in np.median(ratios, axis=0))
    cause, remedy = _lattice_cause(float(dx), float(dy), across, down)
    what = f"K of {named(wrong, len(views))} is not that of the photo carried over by the lattice"
    figures = {"shift_x_px": float(dx), "shift_y_px": float(dy), "ratio_x": across, "ratio_y": down}
    off = f"off by {dx:+.2f}, {dy:+.2f} px, {across:.3g} x {down:.3g} times"
    say = report if half_pixel(float(dx), float(dy)) and cause.startswith("half") else refusal
    return (say(f"{what} ({off})", cause, remedy, **figures),)


def _lattice_cause(dx: float, dy: float, across: float, down: float) -> tuple[str, str]:
    if abs(across / down - 1) > 0.01:
        return "one of both is stretched, the other cropped or padded", "make K_cam affine @ K_photo"
    if abs(across - 1) > 0.01:
        return f"one of both belongs to an image {across:.3g} times as large", "make K_cam affine @ K_photo"
    if half_pixel(dx, dy):
        return "half a pixel: one of both counts pixel centres at whole numbers", "pixel centres lie at +0.5 in both"
    return "the offset of the crop or padding is in one of both only", "make K_cam affine @ K_photo"


def half_pixel(dx: float, dy: float) -> bool:
    """Whether a shift is that of pixel centres at whole numbers (of an image that was resized, up to half a pixel)."""
    return dx * dy > 0 and all(0.2 <= abs(d) <= 0.7 for d in (dx, dy)) and abs(dx - dy) < 0.2


def _half_pixel(views: Sequence[View]) -> tuple[Finding, ...]:
    """Networks put the principal point exactly into the middle; which is W / 2, not (W - 1) / 2."""
    wrong = []
    for view in views:
        (H, W), (cx, cy) = view.shape, view.K_cam[:2, 2]
        if max(abs(cx - (W - 1) / 2), abs(cy - (H - 1) / 2)) < 1e-3:
            wrong.append(view.name)
    if 2 * len(wrong) <= len(views):  # now and then a refined principal point lies there by chance
        return ()
    return (
        report(
            f"K of {named(wrong, len(views))} has its principal point at exactly ((W - 1) / 2, (H - 1) / 2)",
            "half a pixel: K counts pixel centres at whole numbers",
            "add 0.5 to cx and cy; pixel centres lie at +0.5 and the middle of the lattice at (W / 2, H / 2)",
            shift_x_px=-0.5,
            shift_y_px=-0.5,
        ),
    )


def _principal_point(views: Sequence[View]) -> tuple[Finding, ...]:
    wrong = [view.name for view in views if off_middle(view) > OFF_MIDDLE]
    if not wrong:
        return ()
    first = next(view for view in views if view.name == wrong[0])
    H, W = first.shape
    return (
        report(
            f"the principal point of {named(wrong, len(views))} is far from the middle of the photo: "
            f"({first.K_cam[0, 2]:.0f}, {first.K_cam[1, 2]:.0f}) on a lattice of {W} x {H}",
            "K belongs to another size of the image, or a crop or padding is forgotten in it",
            "give K in pixels of the lattice, unless the photos themselves were cropped",
            share=off_middle(first),
        ),
    )


def _reach(view: View) -> float:
    points = view.points.reshape(-1, 3)[:: max(1, view.points.size // 6_000)]
    points = points[np.isfinite(points[:, 0])]
    return float(np.median(np.linalg.norm(points - view.centre, axis=-1))) if len(points) else float("nan")
