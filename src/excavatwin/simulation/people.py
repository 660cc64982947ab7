"""People and what they carry about: figures, pipes and blocks of exact size; ground at z = 0, x forward [m]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from excavatwin.simulation.bodies import Body, Kind, Material
from excavatwin.simulation.models import block, box, pipe_row, rod

M = Material


@dataclass(frozen=True)
class Person:
    """A standing person in a high-visibility vest and a helmet."""

    height: float = 1.75
    """Of the helmet's top [m]."""
    stride: float = 0.12
    """Distance of each foot before or behind the hips [m]."""
    reach: float = 0.1
    """How far the right hand is held forward, 0 (down) to 1 (level)."""
    helmet: Material = M.WHITE_PAINT
    vest: Material = M.HI_VIS

    def __call__(self) -> list[Body]:
        """Its bodies."""
        k = self.height / 1.75
        parts = []
        for side, step in ((0.1, self.stride), (-0.1, -self.stride)):
            parts += [
                box(
                    (k * (step - 0.1), k * (side - 0.05), 0),
                    (k * (step + 0.17), k * (side + 0.05), 0.09),
                    M.DARK_STEEL,
                ),
                rod((k * step, k * side, 0.05 * k), (0, k * side, 0.86 * k), (0.075 * k, 0.085 * k), M.DENIM),
            ]
        low = np.array([0.0, -0.25, 0.87])
        low += self.reach * np.array([0.5, 0.02, 0.5])
        parts += [
            Body(Kind.ELLIPSOID, k * np.array([0, 0, 0.9]), np.eye(3), k * np.array([0.13, 0.18, 0.16]), M.DENIM),
            Body(Kind.ELLIPSOID, k * np.array([0, 0, 1.18]), np.eye(3), k * np.array([0.14, 0.21, 0.31]), self.vest),
            rod((0, 0.21 * k, 1.38 * k), (-0.08 * k, 0.26 * k, 0.85 * k), (0.05 * k, 0.05 * k), self.vest),
            rod((0, -0.21 * k, 1.38 * k), tuple(k * low), (0.05 * k, 0.05 * k), self.vest),
            Body(Kind.ELLIPSOID, k * np.array([0.01, 0, 1.585]), np.eye(3), k * np.array([0.095, 0.08, 0.125]), M.SKIN),
            Body(Kind.ELLIPSOID, k * np.array([0, 0, 1.66]), np.eye(3), k * np.array([0.14, 0.115, 0.09]), self.helmet),
        ]
        return parts


@dataclass(frozen=True)
class Pipes:
    """Concrete pipes side by side, touching: (length, count * diameter, diameter)."""

    count: int = 3
    diameter: float = 0.6
    length: float = 2.4

    def __call__(self) -> list[Body]:
        """Their bodies."""
        return pipe_row(self.count, self.diameter, self.length)


@dataclass(frozen=True)
class Block:
    """A concrete block."""

    length: float = 1.2
    width: float = 0.6
    height: float = 0.6

    def __call__(self) -> list[Body]:
        """Its body."""
        return block(self.length, self.width, self.height)
