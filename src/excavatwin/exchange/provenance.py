"""What our own stages know beyond the contract (lattices, georeference, doubts), as JSON beside the arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from excavatwin.errors import ObservationError
from excavatwin.scene.observations import Georeference, Lattice, Observations, Unplaced


@dataclass(frozen=True)
class Provenance:
    """The optional part of an observations file."""

    lattices: Mapping[str, Lattice] = field(default_factory=dict)
    """View name -> where its lattice lies in the photo."""
    georeference: Georeference | None = None
    unplaced: tuple[Unplaced, ...] = ()
    doubts: tuple[str, ...] = ()
    source: Mapping[str, str] = field(default_factory=dict)


def write_provenance(observations: Observations) -> dict[str, Any]:
    """JSON-ready form; float64 survives exactly."""
    g = observations.georeference
    return {
        "lattices": {v.name: _lattice_table(v.lattice) for v in observations.views if v.lattice is not None},
        "georeference": None if g is None else {"epsg": g.epsg, "origin": list(g.origin), "residual": g.residual},
        "unplaced": [{"name": u.name, "reason": u.reason} for u in observations.unplaced],
        "doubts": list(observations.doubts),
        "source": dict(observations.source),
    }


def parse_provenance(table: Any, views: int) -> Provenance:
    """The inverse of ``write_provenance``; None gives an empty one.

    Raises:
        ObservationError: it is not what ``write_provenance`` writes.
    """
    if table is None:
        return Provenance()
    try:
        g = table.get("georeference")
        return Provenance(
            {name: _lattice(lattice) for name, lattice in table.get("lattices", {}).items()},
            None if g is None else Georeference(int(g["epsg"]), _three(g["origin"]), float(g["residual"])),
            tuple(Unplaced(str(u["name"]), str(u["reason"])) for u in table.get("unplaced", ())),
            tuple(str(doubt) for doubt in table.get("doubts", ())),
            {str(key): str(value) for key, value in table.get("source", {}).items()},
        )
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ObservationError(
            f"provenance of the {views} views is not what ExcavaTwin writes ({type(error).__name__}: {error}); "
            "leave the key out, it is optional."
        ) from None


def _lattice_table(lattice: Lattice) -> dict[str, Any]:
    return {
        "width": lattice.width,
        "height": lattice.height,
        "affine": np.asarray(lattice.affine, float).tolist(),
        "K_photo": np.asarray(lattice.K_photo, float).tolist(),
        "distortion": [float(k) for k in lattice.distortion],
    }


def _lattice(table: dict[str, Any]) -> Lattice:
    k1, k2, p1, p2 = (float(k) for k in table["distortion"])
    affine, K_photo = np.array(table["affine"], float), np.array(table["K_photo"], float)
    if affine.shape != (2, 3) or K_photo.shape != (3, 3):
        raise ValueError(f"affine {affine.shape} and K_photo {K_photo.shape} should be (2, 3) and (3, 3)")
    return Lattice(int(table["width"]), int(table["height"]), affine, K_photo, (k1, k2, p1, p2))


def _three(values: Any) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z
