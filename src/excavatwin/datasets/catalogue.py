"""Which data sets can be read, where they come from and under which terms. Nothing is downloaded from here."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Source:
    """One data set as its authors publish it."""

    name: str
    """What it is called here, and its folder below EXCAVATWIN_DATASETS."""
    title: str
    serves: str
    """What it is evaluated for, as in the paper's tables."""
    place: str
    """Where its authors offer it."""
    licence: str
    take: tuple[str, ...]
    """What to download of it."""
    layout: str
    """How it lies when unpacked."""
    vocabulary: str | None = None
    """Class mapping of its labels, with policies."""


SOURCES: tuple[Source, ...] = (
    Source(
        "rellis-3d", "RELLIS-3D (Jiang et al. 2021)", "terrain elevation against LiDAR",
        "https://github.com/unmannedlab/RELLIS-3D", "CC BY-NC-SA 3.0",
        (
            "Full Images (11 GB), Image Annotations ID Format (94 MB), Image Split File (44 kB)",
            "LiDAR SemanticKITTI Format (14 GB), its Annotation (174 MB), Scan Poses (174 MB)",
            "Camera Intrinsic (2 kB), Camera to LiDAR (3 kB)",
            "for the scans' times, LiDAR with Color Annotation PLY Format (26 GB; names alone are used)",
        ),
        "unpack all side by side: Rellis_3D_*/Rellis-3D/00000 ... 00004 are merged", "rellis-3d",
    ),
    Source(
        "goose-ex", "GOOSE-Ex (Hagmanns et al. 2025)", "segmentation on an excavator's own photos",
        "https://goose-dataset.de", "CC BY-SA 4.0",
        ("gooseEx_2d_train.zip, gooseEx_2d_val.zip", "for clouds, gooseEx_3d_train.zip, gooseEx_3d_val.zip"),
        "images/<split>/<scene>, labels/<split>/<scene>, lidar/<split>/<scene>", "goose-64",
    ),
    Source(
        "goose", "GOOSE (Mortimer et al. 2024)", "segmentation off the road",
        "https://goose-dataset.de", "CC BY-SA 4.0",
        ("goose_2d_train.zip, goose_2d_val.zip", "for clouds, goose_3d_train.zip, goose_3d_val.zip"),
        "as GOOSE-Ex", "goose-64",
    ),
    Source(
        "objectron", "Objectron (Ahmadyan et al. 2021)", "object dimensions",
        "https://github.com/google-research-datasets/Objectron (bucket: https://storage.googleapis.com/objectron)",
        "C-UDA-1.0",
        (
            "per clip: videos/<class>/batch-i/j/video.MOV and geometry.pbdata, annotations/<class>/batch-i/j.pbdata",
            "index/<class>_annotations_train and _test (all clips: 1.9 TB; the paper takes 20 of each class)",
        ),
        "videos/, annotations/ and index/ as in the bucket",
    ),
    Source(
        "oces", "OCES-like, simulated", "everything: elevation, dimensions, classes, volumes",
        "excavatwin simulate (the paper's own OCES is not public)", "yours",
        ("nothing: `excavatwin simulate` writes it",), "docs/oces-layout.md", "task",
    ),
    Source(
        "isprs", "ISPRS filter test (Sithole and Vosselman 2004)", "bare earth in plain clouds",
        "http://www.itc.nl/isprswgIII-3/filtertest (also in PointCloudLibrary/data, terrain/)",
        "not stated; cite the test",
        ("Reference.zip (15 samples)",),
        "samp11.txt ... samp71.txt (x y z class), or samp11.npz (xyz, ground)",
    ),
    Source(
        "orfd", "ORFD (Min et al. 2022)", "elevation of tracks against LiDAR depth",
        "https://github.com/chaytonmin/Off-Road-Freespace-Detection", "Apache 2.0 (README), MIT (LICENSE)",
        ("ORFD, or one sequence of examples/",),
        "training/<sequence>/ (image_data, calib, dense_depth, lidar_data), or one sequence's folder",
    ),
)  # fmt: skip
