"""Poses of the machine that hold its bucket free over the ground."""

from __future__ import annotations

import numpy as np

from excavatwin.simulation.machines import Excavator
from excavatwin.simulation.site import DigSite, Placement
from excavatwin.simulation.worksite import Worksite

CLEAR = 0.3
"""Least height of the bucket's teeth over the ground about them [m]."""


def aimed(
    site: DigSite, machine: Placement, target: tuple[float, float], reach: float, aside: float, tipping: bool
) -> Excavator:
    """The pose that holds the bucket in the direction of ``target``, as low as the ground lets it.

    Args:
        reach: of the teeth from the swing axis [m]; drawn in where the bucket would be too high for it.
        aside: by how much the boom misses the direction of the target [deg].
        tipping: teeth forward as if soil had just been let go, instead of downward as if to dig.

    Raises:
        InputError: the ground is too high for the machine to reach over.
    """
    works = site.earthworks
    assert isinstance(works, Worksite)
    heading = float(np.rad2deg(np.arctan2(target[1] - machine.y, target[0] - machine.x))) + aside
    swing = (heading - machine.yaw + 180) % 360 - 180
    turn = np.deg2rad(heading)
    x, y = machine.x + reach * np.cos(turn), machine.y + reach * np.sin(turn)
    span = 0.1 * np.arange(-10, 11)
    parts = works.layers(x + span, y + span, site.half, site.pads, site.seed)
    here = works.layers(np.array([machine.x]), np.array([machine.y]), site.half, site.pads, site.seed).natural[0, 0]
    highest = float((parts.natural + parts.rough + parts.added - parts.taken).max() - here)
    height = max(0.0, highest) + CLEAR
    return Excavator.reaching(reach, height, float(swing), -60.0 if tipping else -80.0)
