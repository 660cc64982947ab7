"""Under what conditions photos are taken: the hour, the air, and what the camera does wrong."""

from __future__ import annotations

from dataclasses import dataclass, replace

from excavatwin.errors import require
from excavatwin.simulation.site import DigSite


@dataclass(frozen=True)
class Conditions:
    """All effects are off, but for a good sensor's grain, by default."""

    sun_elevation: float | None = None
    """Height of the sun instead of the site's own; 12 is a low evening sun [deg]."""
    turbidity: float = 3.0
    """Haze of the sky: 2 very clear, 6 hazy. The photorealistic renderer only."""
    dust: float = 0.0
    """Optical depth of a cloud of dust about the excavator's bucket; 1 hides two thirds of what is behind it."""
    motion_blur: float = 0.0
    """Mean length of the smear that the drone's own motion leaves [px]."""
    exposure_drift: float = 0.0
    """Standard deviation of the exposure from photo to photo [stops]."""
    grain: float = 0.8
    """Standard deviation of the sensor's noise in mid grey [grey levels of 255]."""

    def __post_init__(self) -> None:
        require(self, "sun_elevation", 3, 90)
        require(self, "turbidity", 1, 10)
        for name, high in (("dust", 10), ("motion_blur", 60), ("exposure_drift", 3), ("grain", 50)):
            require(self, name, 0, high)

    def at(self, site: DigSite) -> DigSite:
        """The site at that hour."""
        return site if self.sun_elevation is None else replace(site, sun=(site.sun[0], self.sun_elevation))
