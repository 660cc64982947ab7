"""Oriented boxes: the rectangle of least area around a footprint, and which of its points are its core."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64


@dataclass(frozen=True)
class Rectangle:
    """A rectangle in the plane."""

    centre: Float64[np.ndarray, "2"]
    length: float
    """Longer side [m]."""
    width: float
    """Shorter side [m]."""
    yaw: float
    """Direction of the longer side, in [-90, 90) [deg]."""


def convex_hull(xy: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "h 2"]:
    """Corners counter-clockwise (Andrew's monotone chain); fewer than three for collinear points."""
    points = np.unique(xy, axis=0)
    if len(points) < 3:
        return points

    def chain(ordered: np.ndarray) -> list[np.ndarray]:
        line: list[np.ndarray] = []
        for p in ordered:
            while len(line) >= 2:
                a, b = line[-1] - line[-2], p - line[-1]
                if a[0] * b[1] - a[1] * b[0] > 0:
                    break
                line.pop()
            line.append(p)
        return line[:-1]

    return np.array(chain(points) + chain(points[::-1]))


def smallest_rectangle(hull: Float64[np.ndarray, "h 2"]) -> Rectangle:
    """Rectangle of least area around a convex hull: one of its sides lies along an edge of the hull."""
    if len(hull) < 2:
        return Rectangle(hull[0].copy() if len(hull) else np.zeros(2), 0.0, 0.0, 0.0)
    edges = np.roll(hull, -1, axis=0) - hull
    angles = np.arctan2(edges[:, 1], edges[:, 0])
    c, s = np.cos(angles), np.sin(angles)
    along, across = hull @ np.stack([c, s]), hull @ np.stack([-s, c])
    extent = np.stack([np.ptp(along, axis=0), np.ptp(across, axis=0)])
    best = int(np.argmin(extent.prod(axis=0)))
    middle = 0.5 * np.array(
        [along[:, best].max() + along[:, best].min(), across[:, best].max() + across[:, best].min()]
    )
    centre = np.array([c[best] * middle[0] - s[best] * middle[1], s[best] * middle[0] + c[best] * middle[1]])
    a, b = extent[:, best]
    angle = np.degrees(angles[best]) + (0.0 if a >= b else 90.0)
    yaw = float((angle + 90.0) % 180.0 - 90.0)  # a hair below -90 comes out as +90
    return Rectangle(centre, float(max(a, b)), float(min(a, b)), yaw if yaw < 90.0 else -90.0)


def core(xy: Float64[np.ndarray, "n 2"], weight: Float64[np.ndarray, "n"], trim: float) -> Bool[np.ndarray, "n"]:
    """The points inside the smallest of the rectangles, one a degree, that leave out ``trim`` of the weight a side.

    Unlike the hull of all points, its direction does not depend on the outermost ones.
    """
    best, inside = np.inf, np.ones(len(xy), bool)
    for angle in np.radians(np.arange(90)):
        c, s = np.cos(angle), np.sin(angle)
        sides = (xy @ np.array([c, s]), xy @ np.array([-s, c]))
        (a0, a1), (b0, b1) = (weighted_bounds(side, weight, trim) for side in sides)
        if (a1 - a0) * (b1 - b0) < best:
            best = (a1 - a0) * (b1 - b0)
            inside = (sides[0] >= a0) & (sides[0] <= a1) & (sides[1] >= b0) & (sides[1] <= b1)
    return inside


def weighted_bounds(x: Float64[np.ndarray, "n"], weight: Float64[np.ndarray, "n"], trim: float) -> tuple[float, float]:
    """The smallest and the largest value that do not lie in the outermost ``trim`` of the weight."""
    order = np.argsort(x)
    share = np.cumsum(weight[order])
    low = int(np.searchsorted(share, trim * share[-1], side="right"))
    high = int(np.searchsorted(share, (1 - trim) * share[-1], side="left"))
    last = len(x) - 1
    return float(x[order[min(low, last)]]), float(x[order[min(max(high, low), last)]])
