"""The SITE folder: every format, written whole or not at all."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from excavatwin.export.cameras import cameras_table
from excavatwin.export.label_images import encode_label_image, label_file_names
from excavatwin.export.run_record import run_record, to_json
from excavatwin.scene.site import Site
from excavatwin.scene.staging import whole_folder

#: The file by which a SITE folder is known.
MARK = "run.json"
#: What a SITE folder may hold of ours. Anything else in it is the user's and survives the next run.
OURS = (
    "README.txt", "cameras.json", "elevation.tif", "label.tif", "labels", "map.nc", "objects.geojson",
    "objects_wgs84.geojson", "points.laz", "preview.png", "run.json",
)  # fmt: skip

_README = """\
This folder was written by ExcavaTwin. Which program opens what:

  preview.png            a first look: photo, classes, relief
  elevation.tif          terrain elevation{unit}: QGIS, ArcGIS, GDAL (drag it into QGIS)
  label.tif              class of every cell, with colours and names: QGIS, ArcGIS, GDAL
  objects.geojson        machines and obstacles, footprints and boxes: QGIS, any text editor
{wgs84}  points.laz             fused points with class, confidence, colour: CloudCompare, QGIS, PDAL
  map.nc                 all layers in one file: Python (xarray), QGIS, Panoply
  labels/<photo>.png     class of every pixel of a photo; the pixel value is the class id: GIMP, Pillow
  cameras.json           where each photo was taken, or why that is not known: any text editor
  run.json               versions, parameters, inputs, times, warnings: any text editor

Classes: 0 unknown, 1 construction_terrain, 2 other_terrain, 3 removable_cover, 4 excavator, 5 obstacle,
255 not observed. In points.laz the class id is in `task_class`; `classification` holds the ASPRS code.

Frame: {frame}.
{doubts}
Running ExcavaTwin again on this folder replaces these files and keeps any other file in it.
"""


def write_site(site: Site, folder: str | Path) -> list[Path]:
    """Write the SITE folder and name its files.

    An earlier SITE of that name is replaced as a whole, after the last byte of the new one is on the disk; files in it
    that ExcavaTwin did not write are kept.

    Raises:
        OutputError: full disk, read-only target, or a folder that holds something that is no SITE; nothing
            half-written is left behind and what was there before is untouched.
    """
    folder = Path(folder)
    written = []
    with whole_folder(folder, MARK, _is_ours) as staged:
        for name, content in _files(site):
            file = staged / name
            file.parent.mkdir(exist_ok=True)
            file.write_bytes(content)
            written.append(name)
        (staged / MARK).write_text(to_json(run_record(site, [*written, MARK]), indent=2) + "\n", "utf-8")
    return [folder / name for name in (*written, MARK)]


def _is_ours(name: str) -> bool:
    """Our own files, and what GIS programs leave beside them (``elevation.tif.aux.xml``): stale after a new run."""
    return name in OURS or any(name.startswith(f"{ours}.") for ours in OURS)


def _files(site: Site) -> Iterator[tuple[str, bytes]]:
    """Name and content of every file, one at a time, so that only one is in memory. Heavy writers load here."""
    from excavatwin.export.geotiff import category_sidecar, encode_geotiff
    from excavatwin.export.netcdf import encode_netcdf
    from excavatwin.export.objects import objects_table, objects_wgs84_table
    from excavatwin.export.point_cloud import encode_laz
    from excavatwin.export.preview import encode_preview

    yield "map.nc", encode_netcdf(site)
    yield "elevation.tif", encode_geotiff(site.map, "elevation")
    yield "label.tif", encode_geotiff(site.map, "label")
    yield "label.tif.aux.xml", category_sidecar("label").encode()
    yield "points.laz", encode_laz(site.points, site.map)
    yield "objects.geojson", to_json(objects_table(site.map), indent=1).encode()
    wgs84 = objects_wgs84_table(site.map)
    if wgs84 is not None:
        yield "objects_wgs84.geojson", to_json(wgs84, indent=1).encode()
    label_files = label_file_names([view.name for view in site.views])
    for view in site.views:
        yield f"labels/{label_files[view.name]}", encode_label_image(view.label)
    label_paths = {name: f"labels/{file}" for name, file in label_files.items()}
    yield "cameras.json", to_json(cameras_table(site, label_paths), indent=1).encode()
    yield "preview.png", encode_preview(site)
    yield "README.txt", readme(site).encode()


def readme(site: Site) -> str:
    """Which program opens which file, what the numbers mean, and what to doubt."""
    from excavatwin.export.placement import frame_sentence

    doubts = "".join(f"  - {doubt}\n" for doubt in site.map.doubts)
    return _README.format(
        unit=" in metres" if site.map.metric else " (unit arbitrary)",
        wgs84="  objects_wgs84.geojson  the same footprints in longitude, latitude: web maps, Google Earth\n"
        if site.map.georeference
        else "",
        frame=frame_sentence(site.map),
        doubts=f"Doubts:\n{doubts}" if doubts else "",
    )
