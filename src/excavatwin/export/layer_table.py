"""The layers of the map as rows of a table, from the registry that also drives the files."""

from __future__ import annotations

from dataclasses import dataclass

from excavatwin.scene.elevation_map import LAYERS


@dataclass(frozen=True)
class LayerRow:
    """One layer, ready to print."""

    name: str
    dtype: str
    unit: str
    fill: str
    """Value of a cell that has none."""
    meaning: str
    values: str
    """``0 unknown, 1 construction_terrain, ...`` of a categorical layer, else empty."""


def describe_layers() -> list[LayerRow]:
    """The rows of ``excavatwin layers``, in the order of ``LAYERS``."""
    return [
        LayerRow(
            layer.name,
            layer.dtype,
            layer.unit if layer.unit != "1" else "",
            f"{layer.fill:g}",
            layer.meaning,
            ", ".join(f"{value} {name}" for value, name in layer.categories.items()),
        )
        for layer in LAYERS
    ]
