"""The tables of the paper as they are printed there, to stand beside ours."""

from __future__ import annotations

from collections.abc import Mapping

Row = tuple[float, float]
"""mIoU and coverage [%]."""

#: Data set -> backbone -> row of tab:semantic_accuracy.
SEMANTICS: Mapping[str, Mapping[str, Mapping[str, Row]]] = {
    "goose-ex": {
        "yoloe": {"backbone": (3.34, 2.57), "full method": (20.77, 90.52)},
        "mask2former": {"backbone": (21.40, 94.26), "full method": (38.03, 96.15)},
    },
    "oces": {
        "yoloe": {"backbone": (6.53, 2.70), "full method": (34.57, 80.40)},
        "mask2former": {"backbone": (34.71, 91.85), "full method": (53.19, 99.28)},
    },
}

#: Data set -> row of tab:yoloe_ablation; the paper has it for YOLOE only.
ABLATION: Mapping[str, Mapping[str, Row]] = {
    "goose-ex": {
        "w/o local geometry": (9.12, 70.46),
        "w/o terrain continuity": (17.84, 81.28),
        "w/o object support": (18.40, 89.07),
        "w/o spatial consistency": (10.36, 63.18),
        "w/o view reliability": (19.11, 90.87),
    },
    "oces": {
        "w/o local geometry": (21.82, 64.13),
        "w/o terrain continuity": (29.63, 79.72),
        "w/o object support": (30.28, 81.94),
        "w/o spatial consistency": (17.92, 50.47),
        "w/o view reliability": (32.18, 78.06),
    },
}

#: Task and data set -> MAE [cm], RMSE [cm], relative error [%] of tab:geometry_accuracy.
GEOMETRY: Mapping[tuple[str, str], tuple[float, float, float | None]] = {
    ("Object dimension", "objectron"): (2.63, 4.55, 9.01),
    ("Object dimension", "oces"): (6.23, 8.94, 10.43),
    ("Terrain elevation", "rellis-3d"): (28.30, 32.14, None),
    ("Terrain elevation", "oces"): (12.61, 15.32, None),
}

TITLES = {"goose-ex": "GOOSE-Ex", "oces": "OCES", "objectron": "Objectron", "rellis-3d": "RELLIS-3D"}
"""Names of the data sets as the paper writes them."""
BACKBONES = {"yoloe": "YOLOE", "mask2former": "Mask2Former"}


def published(dataset: str, backbone: str, configuration: str) -> Row | None:
    """mIoU and coverage that the paper has for a configuration, or None."""
    if backbone == "yoloe" and configuration in ABLATION.get(dataset, {}):
        return ABLATION[dataset][configuration]
    return SEMANTICS.get(dataset, {}).get(backbone, {}).get(configuration)
