"""The semantic elevation map M (eq:multilayer_map) and the registry of its layers."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32, UInt8

from excavatwin.scene.grid import Grid
from excavatwin.scene.observations import Georeference
from excavatwin.scene.taxonomy import NOT_OBSERVED, Reason, Support, TaskClass

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True)
class Layer:
    """One layer of the map: it drives band names, files, documentation and the tests of every exporter."""

    name: str
    dtype: str
    unit: str
    fill: float | int
    """Value of a cell that has none."""
    meaning: str
    values: type[IntEnum] | None = None
    """Enumeration of a categorical layer."""

    @property
    def categories(self) -> dict[int, str]:
        """Value -> lower-case name of a categorical layer; empty for the others."""
        if self.values is None:
            return {}
        members = {int(member): member.name.lower() for member in self.values}
        return members | ({NOT_OBSERVED: "not_observed"} if self.fill == NOT_OBSERVED else {})


LAYERS: tuple[Layer, ...] = (
    Layer("elevation", "float32", "m", np.nan, "terrain elevation H_c, median of its points (eq:semantic_elevation)"),
    Layer("elevation_std", "float32", "m", np.nan, "standard deviation of H_c, without what the whole map shares"),
    Layer("label", "uint8", "1", NOT_OBSERVED, "task class L_c (eq:grid_semantics); 255 = not observed", TaskClass),
    Layer("confidence", "float32", "1", 0.0, "share of the cell's votes that its class won"),
    Layer("observed", "uint8", "1", 0, "1 where at least one point with trustworthy depth lies in the cell"),
    Layer("reason", "uint8", "1", int(Reason.UNOBSERVED), "why the cell has no class", Reason),
    Layer("object_id", "int32", "1", 0, "object that occupies the cell; 0 = none"),
    Layer("object_top", "float32", "m", np.nan, "highest point of the object in the cell"),
    Layer("object_base", "float32", "m", np.nan, "lowest point of the object in the cell"),
    Layer("support", "uint8", "1", int(Support.NONE), "geometric support of the cell", Support),
)  # fmt: skip


@dataclass(frozen=True)
class MapObject:
    """One excavator or obstacle, with its oriented box in frame M."""

    object_id: int
    task_class: TaskClass
    centre: tuple[float, float, float]
    """Centre of the box [m]."""
    size: tuple[float, float, float]
    """Length >= width along the box, height [m]."""
    yaw: float
    """Direction of the length axis, counter-clockwise from +x, in [-90, 90) [deg]."""
    z_base: float
    """Elevation of the terrain that it stands on, or of its lowest point where terrain is unknown [m]."""
    z_top: float
    """Elevation of its top [m]."""
    confidence: float
    """Mean confidence of its voxels, 0..1."""
    footprint: Float64[np.ndarray, "corners 2"]
    """Corners of the footprint polygon, counter-clockwise, not closed [m]."""


@dataclass(frozen=True)
class ElevationMap:
    """A co-registered set of rasters (Y, X), row 0 north, in frame M, with its objects."""

    grid: Grid
    elevation: Float32[np.ndarray, "Y X"]
    elevation_std: Float32[np.ndarray, "Y X"]
    label: UInt8[np.ndarray, "Y X"]
    confidence: Float32[np.ndarray, "Y X"]
    observed: UInt8[np.ndarray, "Y X"]
    reason: UInt8[np.ndarray, "Y X"]
    object_id: Int32[np.ndarray, "Y X"]
    object_top: Float32[np.ndarray, "Y X"]
    object_base: Float32[np.ndarray, "Y X"]
    support: UInt8[np.ndarray, "Y X"]
    objects: tuple[MapObject, ...] = ()
    metric: bool = True
    """False when no scale is known: then "m" in every unit reads "units of the reconstruction"."""
    georeference: Georeference | None = None
    doubts: tuple[str, ...] = ()
    provenance: dict[str, Any] = field(default_factory=dict)

    @property
    def unit(self) -> str:
        """``"m"``, or ``"unit"`` (arbitrary) when no scale is known."""
        return "m" if self.metric else "unit"

    @property
    def work(self) -> Bool[np.ndarray, "Y X"]:
        """M^work: cells of construction or other terrain with an elevation."""
        return np.isin(self.label, (TaskClass.CONSTRUCTION_TERRAIN, TaskClass.OTHER_TERRAIN)) & np.isfinite(
            self.elevation
        )

    @property
    def noise(self) -> Bool[np.ndarray, "Y X"]:
        """M^noise: cells of removable cover."""
        return self.label == TaskClass.REMOVABLE_COVER

    @property
    def object(self) -> Bool[np.ndarray, "Y X"]:
        """M^object: cells that an excavator or an obstacle occupies."""
        return self.object_id > 0

    def layers(self) -> dict[str, np.ndarray]:
        """Layer name -> array (Y, X), in the order of ``LAYERS``."""
        return {layer.name: getattr(self, layer.name) for layer in LAYERS}

    def to_xarray(self) -> xarray.Dataset:
        """The map as a CF-style ``xarray.Dataset`` with coordinates x (ascending) and y (descending), without I/O."""
        import xarray

        data = {}
        for layer in LAYERS:
            attributes: dict[str, Any] = {
                "long_name": layer.meaning,
                "units": self.unit if layer.unit == "m" else "1",
            }
            if layer.categories:
                attributes["flag_values"] = np.array(list(layer.categories), layer.dtype)
                attributes["flag_meanings"] = " ".join(layer.categories.values())
            data[layer.name] = (("y", "x"), getattr(self, layer.name), attributes)
        origin = self.georeference.origin if self.georeference else (0.0, 0.0, 0.0)
        axis = {"units": self.unit}
        x_name, y_name = ("projection_x_coordinate", "projection_y_coordinate") if self.georeference else (None, None)
        x = {**axis, "axis": "X", "long_name": "easting" if x_name else "local x"}
        y = {**axis, "axis": "Y", "long_name": "northing" if y_name else "local y"}
        if x_name:
            x["standard_name"], y["standard_name"] = x_name, str(y_name)
        dataset = xarray.Dataset(
            data, coords={"y": ("y", self.grid.y + origin[1], y), "x": ("x", self.grid.x + origin[0], x)}
        )
        if self.georeference:
            for name in ("elevation", "object_top", "object_base"):
                dataset[name] = (
                    (dataset[name] + np.float64(origin[2])).astype("float32").assign_attrs(dataset[name].attrs)
                )
        dataset.attrs.update(self.provenance)
        return dataset
