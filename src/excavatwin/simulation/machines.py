"""Machines with joints and of exact size, in a local frame: x forward, y left, z up, ground at z = 0 [m]."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float64

from excavatwin.errors import InputError
from excavatwin.simulation.bodies import Body, Kind, Material
from excavatwin.simulation.models import box, rod, turn_z

M = Material

FOOT = (0.9, 0.8)
"""Boom's foot pin: distance in front of the swing axis, height [m]."""
BOOM, ARM, BUCKET = 2.35, 1.15, 0.72
"""Lengths from pin to pin, and from the bucket's pin to its teeth [m]."""
KNEE = 0.4
"""Height of the boom's bend over its chord [m]."""


@dataclass(frozen=True)
class Excavator:
    """A compact excavator of 3 t with the proportions of its class (compact radius, 1.55 m wide, 2.48 m high).

    Reach 5.0 m at ground level, digging depth 2.8 m, tail within 0.78 m of the swing axis. Angles in degrees.
    """

    swing: float = 0.0
    """Of the house against the tracks, counter-clockwise."""
    boom: float = 42.0
    """Elevation of the line from the boom's foot to its tip."""
    arm: float = -95.0
    """From the boom's line to the arm's; negative folds the arm down."""
    bucket: float = -40.0
    """From the arm's line to the bucket's (pin to teeth); negative curls it in."""

    def __post_init__(self) -> None:
        limits = (("boom", -45, 80), ("arm", -160, -20), ("bucket", -150, 60))
        for name, low, high in limits:
            if not low <= getattr(self, name) <= high:
                raise InputError(
                    f"The excavator's {name} is at {getattr(self, name):g} degrees; it turns from {low} to {high}."
                )

    @classmethod
    def reaching(cls, reach: float, height: float, swing: float = 0.0, attack: float = -100.0) -> Excavator:
        """The pose that holds the bucket's teeth ``reach`` from the swing axis and ``height`` above the ground.

        Args:
            attack: elevation of the bucket's line; -90 points straight down, -170 carries soil.

        Raises:
            InputError: the machine cannot get there.
        """
        a = np.deg2rad(attack)
        wrist = np.array([reach, height]) - BUCKET * np.array([np.cos(a), np.sin(a)]) - FOOT
        distance = float(np.hypot(*wrist))
        if not abs(BOOM - ARM) < distance < BOOM + ARM:
            raise InputError(
                f"The bucket cannot get to {reach:g} m in front and {height:g} m up; "
                f"its wrist would be {distance:.2f} m from the boom's foot, and can be 1.2 to 3.5 m from it."
            )
        opening = np.arccos((BOOM**2 + distance**2 - ARM**2) / (2 * BOOM * distance))
        boom = float(np.arctan2(wrist[1], wrist[0]) + opening)
        rest = wrist - BOOM * np.array([np.cos(boom), np.sin(boom)])
        arm = float(np.arctan2(rest[1], rest[0]))
        fold, curl = np.rad2deg(arm - boom), attack - np.rad2deg(arm)
        return cls(swing, float(np.rad2deg(boom)), float((fold + 180) % 360 - 180), float((curl + 180) % 360 - 180))

    def joints(self) -> Float64[np.ndarray, "5 2"]:
        """Foot, knee, boom tip, wrist and teeth: distance in front of the swing axis and height [m]."""
        angles = np.deg2rad(np.cumsum([self.boom, self.arm, self.bucket]))
        e = np.stack([np.cos(angles), np.sin(angles)], -1)
        foot = np.array(FOOT)
        knee = foot + 0.48 * BOOM * e[0] + KNEE * np.array([-e[0, 1], e[0, 0]])
        tip = foot + BOOM * e[0]
        wrist = tip + ARM * e[1]
        return np.stack([foot, knee, tip, wrist, wrist + BUCKET * e[2]])

    def __call__(self) -> list[Body]:
        """Its bodies."""
        upper = _house() + self._attachment()
        return _undercarriage() + [body.moved(turn_z(np.deg2rad(self.swing)), np.zeros(3)) for body in upper]

    def _attachment(self) -> list[Body]:
        """Boom, arm, bucket and their cylinders."""
        foot, knee, tip, wrist, teeth = self.joints()
        along_arm, along_bucket = (wrist - tip) / ARM, (teeth - wrist) / BUCKET
        heel = tip - 0.28 * along_arm
        over_arm = np.array([along_arm[1], -along_arm[0]])
        over_arm *= np.sign(over_arm @ (knee - tip)) * -1  # the side that faces away from the boom

        def beam(a: np.ndarray, b: np.ndarray, half: tuple[float, float], paint: Material, kind: Kind) -> Body:
            return rod((a[0], 0.0, a[1]), (b[0], 0.0, b[1]), half, paint, kind)

        mid = 0.5 * (tip + wrist)
        parts = [
            beam(foot, knee, (0.09, 0.14), M.YELLOW_PAINT, Kind.BOX),
            beam(knee, tip, (0.08, 0.12), M.YELLOW_PAINT, Kind.BOX),
            rod((knee[0], -0.09, knee[1]), (knee[0], 0.09, knee[1]), (0.15, 0.15), M.YELLOW_PAINT),
            beam(heel, wrist, (0.075, 0.095), M.YELLOW_PAINT, Kind.BOX),
            beam(np.array([1.05, 0.56]), knee - np.array([0.0, 0.1]), (0.05, 0.05), M.DARK_STEEL, Kind.CYLINDER),
            beam(knee + np.array([0.0, 0.16]), heel, (0.045, 0.045), M.DARK_STEEL, Kind.CYLINDER),
            beam(heel + 0.12 * over_arm, mid + 0.15 * over_arm, (0.04, 0.04), M.DARK_STEEL, Kind.CYLINDER),
            beam(mid + 0.15 * over_arm, wrist + 0.1 * over_arm, (0.03, 0.03), M.DARK_STEEL, Kind.CYLINDER),
        ]
        belly = np.array([-along_bucket[1], along_bucket[0]])
        shell = ((-0.06, 0.05), (0.1, 0.34), (0.42, 0.34), (BUCKET, 0.0))
        profile = [wrist + e * along_bucket + n * belly for e, n in shell]
        for a, b in pairwise(profile):
            parts.append(beam(a, b, (0.3, 0.02), M.DARK_STEEL, Kind.BOX))
        start, end = wrist + 0.03 * along_bucket + 0.16 * belly, wrist + 0.52 * along_bucket + 0.16 * belly
        for y in (-0.28, 0.28):
            parts.append(rod((start[0], y, start[1]), (end[0], y, end[1]), (0.02, 0.16), M.DARK_STEEL, Kind.BOX))
        return parts


def _undercarriage() -> list[Body]:
    """Two rubber tracks 2.0 m long, and the dozer blade."""
    parts = [
        box((1.32, -0.775, 0.06), (1.4, 0.775, 0.4), M.YELLOW_PAINT),
        box((-0.55, -0.5, 0.2), (0.55, 0.5, 0.44), M.DARK_STEEL),
    ]
    for y in (-0.625, 0.625):
        parts += [
            box((-0.78, y - 0.15, 0.0), (0.78, y + 0.15, 0.44), M.DARK_STEEL),
            rod((-0.78, y - 0.15, 0.22), (-0.78, y + 0.15, 0.22), (0.22, 0.22), M.DARK_STEEL),
            rod((0.78, y - 0.15, 0.22), (0.78, y + 0.15, 0.22), (0.22, 0.22), M.DARK_STEEL),
            rod((0.4, 0.62 * y, 0.28), (1.34, 0.62 * y, 0.22), (0.05, 0.06), M.YELLOW_PAINT, Kind.BOX),
        ]
    return parts


def _house() -> list[Body]:
    """Turntable, deck, engine hood with its round tail, cab with roof and posts, boom bracket."""
    parts = [
        rod((0, 0, 0.42), (0, 0, 0.58), (0.42, 0.42), M.DARK_STEEL),
        rod((0, 0, 0.56), (0, 0, 0.72), (0.775, 0.76), M.YELLOW_PAINT),
        rod((-0.1, 0, 0.62), (-0.1, 0, 1.12), (0.675, 0.73), M.YELLOW_PAINT),
        box((-0.66, -0.6, 0.7), (-0.3, 0.6, 1.3), M.YELLOW_PAINT),
        box((-0.35, -0.72, 0.7), (0.55, -0.16, 1.16), M.YELLOW_PAINT),
        box((0.5, -0.16, 0.58), (0.98, 0.16, 0.9), M.DARK_STEEL),
        box((-0.33, -0.12, 0.72), (0.72, 0.68, 1.15), M.YELLOW_PAINT),
        box((-0.3, -0.1, 1.1), (0.7, 0.66, 2.38), M.GLASS),
        box((-0.36, -0.14, 2.38), (0.76, 0.7, 2.48), M.YELLOW_PAINT),
    ]
    for x in (-0.31, 0.71):
        for y in (-0.1, 0.66):
            parts.append(box((x - 0.035, y - 0.035, 1.1), (x + 0.035, y + 0.035, 2.4), M.DARK_STEEL))
    return parts


@dataclass(frozen=True)
class Truck:
    """A small tipper truck of exact size, its bed filled to a level."""

    length: float = 5.6
    width: float = 2.0
    height: float = 2.35
    """Of the cab [m]."""
    load: float = 0.5
    """Soil in the bed, 0 (empty) to 1 (level with its sides)."""
    paint: Material = M.WHITE_PAINT

    def __call__(self) -> list[Body]:
        """Its bodies."""
        front, tail, side = self.length / 2, -self.length / 2, self.width / 2
        cab, floor, rim = front - 1.55, 0.95, 1.45
        parts = [
            box((tail + 0.15, -0.4, 0.5), (front - 0.3, 0.4, 0.8), M.DARK_STEEL),
            box((front - 0.12, -side, 0.42), (front, side, 0.75), M.DARK_STEEL),
            box((cab, -side + 0.04, 0.55), (front - 0.05, side - 0.04, 1.35), self.paint),
            box((cab + 0.1, -side + 0.1, 1.35), (front - 0.2, side - 0.1, self.height - 0.1), M.GLASS),
            box((cab + 0.02, -side + 0.08, self.height - 0.1), (front - 0.25, side - 0.08, self.height), self.paint),
            box((cab + 0.02, -side + 0.08, 1.3), (cab + 0.16, side - 0.08, self.height - 0.05), self.paint),
            box((tail, -side, floor - 0.12), (cab - 0.15, side, floor), M.DARK_STEEL),
            box((tail, -side, floor), (tail + 0.06, side, rim), self.paint),
            box((cab - 0.21, -side, floor), (cab - 0.15, side, rim + 0.25), self.paint),
            box((tail, -side, floor), (cab - 0.15, -side + 0.06, rim), self.paint),
            box((tail, side - 0.06, floor), (cab - 0.15, side, rim), self.paint),
        ]
        for x in (front - 0.95, tail + 1.1):
            for y in (-side + 0.16, side - 0.16):
                parts.append(rod((x, y - 0.14, 0.42), (x, y + 0.14, 0.42), (0.42, 0.42), M.DARK_STEEL))
        if self.load > 0:
            middle, deep = (tail + cab - 0.15) / 2, self.load * (rim - floor)
            parts.append(
                box((tail + 0.06, -side + 0.06, floor), (cab - 0.21, side - 0.06, floor + 0.7 * deep), M.LOOSE_SOIL)
            )
            half = np.array([(cab - 0.15 - tail) / 2 - 0.15, side - 0.15, 0.3 * deep + 0.12 * self.load])
            parts.append(Body(Kind.ELLIPSOID, np.array([middle, 0, floor + 0.7 * deep]), np.eye(3), half, M.LOOSE_SOIL))
        return parts


@dataclass(frozen=True)
class Dumper:
    """A wheeled site dumper of exact size: skip in front, articulated in the middle, seat under a roll bar."""

    length: float = 4.1
    width: float = 1.85
    height: float = 2.65
    """Of the roll bar [m]."""
    load: float = 0.0
    """Soil in the skip, 0 to 1."""
    paint: Material = M.ORANGE_PLASTIC

    def __call__(self) -> list[Body]:
        """Its bodies."""
        front, tail, side = self.length / 2, -self.length / 2, self.width / 2
        back = front - 1.9  # rear wall of the skip
        floor, rim = 0.75, 1.4
        parts = [
            box((tail + 0.2, -0.35, 0.45), (front - 0.5, 0.35, 0.75), M.DARK_STEEL),
            box((tail, -0.6, 0.5), (back - 0.75, 0.6, 1.25), self.paint),
            box((back - 0.75, -0.3, 0.75), (back - 0.2, 0.3, 1.15), M.DARK_STEEL),
            box((tail + 0.5, -0.25, 1.25), (tail + 0.62, 0.25, 1.75), M.DARK_STEEL),
            box((back, -side, floor), (front, side, floor + 0.08), self.paint),
            box((front - 0.06, -side, floor), (front, side, rim - 0.2), self.paint),
            box((back, -side, floor), (back + 0.06, side, rim), self.paint),
            box((back, -side, floor), (front, -side + 0.06, rim - 0.1), self.paint),
            box((back, side - 0.06, floor), (front, side, rim - 0.1), self.paint),
            rod(
                (tail + 0.45, -0.6, self.height - 0.05),
                (tail + 0.45, 0.6, self.height - 0.05),
                (0.05, 0.05),
                M.DARK_STEEL,
            ),
        ]
        for y in (-0.55, 0.55):
            parts.append(rod((tail + 0.45, y, 1.2), (tail + 0.45, y, self.height - 0.05), (0.05, 0.05), M.DARK_STEEL))
        for x in (tail + 0.6, front - 1.0):
            for y in (-side + 0.2, side - 0.2):
                parts.append(rod((x, y - 0.17, 0.45), (x, y + 0.17, 0.45), (0.45, 0.45), M.DARK_STEEL))
        if self.load > 0:
            half = np.array([0.85, side - 0.12, 0.15 + 0.45 * self.load])
            parts.append(Body(Kind.ELLIPSOID, np.array([back + 0.97, 0, floor + 0.3]), np.eye(3), half, M.LOOSE_SOIL))
        return parts
