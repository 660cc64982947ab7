"""ExcavaTwin: photos of an earthworks site in, metric semantic elevation map out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from excavatwin.exchange import load_observations, save_observations
    from excavatwin.mapper import Mapper
    from excavatwin.scene.observations import Observations, View
    from excavatwin.survey import map_photos

_HOMES = {
    "Mapper": "excavatwin.mapper",
    "Observations": "excavatwin.scene.observations",
    "View": "excavatwin.scene.observations",
    "load_observations": "excavatwin.exchange",
    "save_observations": "excavatwin.exchange",
    "map_photos": "excavatwin.survey",
}
__all__ = [
    "Mapper",
    "Observations",
    "View",
    "__version__",
    "load_observations",
    "map_photos",
    "save_observations",
]


def __getattr__(name: str) -> Any:  # import lazily: `excavatwin --help` must not pay for numba
    if name not in _HOMES:
        raise AttributeError(f"module 'excavatwin' has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
