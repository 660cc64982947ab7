"""How many photos a network can see at once: estimated before anything is computed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from excavatwin.backbones.sequence.chunking import LEAST
from excavatwin.errors import InputError

if TYPE_CHECKING:
    from excavatwin.backbones.sequence.feed_forward import FeedForward

MOST = 64
"""More photos at once make networks slow (their attention grows with the square), and no better: trained on fewer."""
USED = 0.85
"""Share of the free memory that is planned with."""
HOPELESS = 1.5
"""An estimate is good to about this factor: smallest chunks that need more than the free memory times this are refused.
"""


@dataclass(frozen=True)
class Room:
    """What fits."""

    size: int
    """Photos at once."""
    need: float
    """Estimated peak memory of the network with them [bytes]."""
    free: float | None
    """Memory that it may take [bytes]; None where that is not known."""
    where: str
    """``"memory"`` or ``"memory of the device"``."""

    def sentence(self, count: int) -> str:
        """What the user is told before the work starts."""
        many = "all" if self.size >= count else str(self.size)
        free = "" if self.free is None else f" of {self.free / 1e9:.1f} GB free {self.where}"
        return f"{many} of {count} photos at once, estimated to need {self.need / 1e9:.1f} GB{free}"


def room(model: FeedForward, shape: tuple[int, int], count: int) -> Room:
    """The chunk size for so many photos on a lattice (H, W): as asked for, else what fits.

    Raises:
        InputError: not even the smallest chunk can be computed.
    """
    asked = model.chunking.size
    if asked is not None:
        size = min(asked, count)
        return Room(size, model.memory(size, *shape), None, "memory")
    free, where = free_memory(model)
    size = min(count, MOST)
    while free is not None and size > min(LEAST, count) and model.memory(size, *shape) > USED * free:
        size -= 1
    need = model.memory(size, *shape)
    if free is not None and need > HOPELESS * free:
        raise InputError(
            f"{model.card.name} needs about {need / 1e9:.1f} GB for {size} photos on {shape[1]} x {shape[0]} px and "
            f"{free / 1e9:.1f} GB of {where} are free; use a smaller --{model.card.name}.lattice or smaller weights."
        )
    return Room(size, need, free, where)


def free_memory(model: FeedForward) -> tuple[float | None, str]:
    """Memory that a network may take on its device, and what to call it."""
    free = model.device.free()
    if free is not None:
        return free, "memory of the device"
    return available(), "memory"


def available() -> float | None:
    """Main memory that this process may still take [bytes]; None where the system does not tell."""
    known = [value for value in (_system(), _control_group()) if value is not None]
    return min(known) if known else None


def _system() -> float | None:
    try:
        rows = Path("/proc/meminfo").read_text().splitlines()
    except OSError:  # not Linux
        return None
    found = [row for row in rows if row.startswith("MemAvailable:")]
    return float(found[0].split()[1]) * 1024 if found else None


def _control_group() -> float | None:
    """What is left of a container's limit (control group v2)."""
    group = Path("/sys/fs/cgroup")
    try:
        limit, used = (group / "memory.max").read_text().strip(), (group / "memory.current").read_text()
    except OSError:
        return None
    return None if limit == "max" else max(float(limit) - float(used), 0.0)
