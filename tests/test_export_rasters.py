"""map.nc and the GeoTIFFs, reopened with other people's readers."""

from __future__ import annotations

import io
import json
import struct

import h5py
import numpy as np
import pyproj
import pytest
import rasterio
import rasterio.shutil
import xarray
from rasterio.io import MemoryFile

from excavatwin.export import describe_layers
from excavatwin.export.geotiff import category_sidecar, encode_geotiff
from excavatwin.export.netcdf import encode_netcdf
from excavatwin.scene.elevation_map import LAYERS
from excavatwin.scene.taxonomy import PALETTE
from site_example import UTM, example_map, example_site

HEIGHTS = ("elevation", "object_top", "object_base")
FRAMES = {"georeferenced": (True, True), "local": (False, True), "unitless": (False, False)}


@pytest.fixture(scope="module", params=FRAMES)
def site(request):
    return example_site(*FRAMES[request.param], cell=0.05)


def expected(site, name):
    """A layer in map coordinates, as every file should hold it."""
    values = getattr(site.map, name)
    if name in HEIGHTS and site.map.georeference:
        return (values.astype(float) + UTM.origin[2]).astype(np.float32)
    return values


def origin(site):
    return UTM.origin if site.map.georeference else (0.0, 0.0, 0.0)


def test_netcdf_in_xarray(site):
    with xarray.open_dataset(io.BytesIO(encode_netcdf(site)), engine="h5netcdf") as dataset:
        for layer in LAYERS:
            variable = dataset[layer.name]
            assert variable.dims == ("y", "x")
            assert variable.dtype == layer.dtype
            np.testing.assert_array_equal(variable.values, expected(site, layer.name))
            if layer.values:
                names = variable.attrs["flag_meanings"].split()
                assert dict(zip(variable.attrs["flag_values"].tolist(), names, strict=True)) == layer.categories
        assert (np.diff(dataset.y) < 0).all()
        assert (np.diff(dataset.x) > 0).all()
        np.testing.assert_array_equal(dataset.x, site.map.grid.x + origin(site)[0])
        np.testing.assert_array_equal(dataset.y, site.map.grid.y + origin(site)[1])
        assert dataset.attrs["Conventions"] == "CF-1.11"
        assert json.loads(dataset.attrs["run_config"]) == site.run["config"]
        assert json.loads(dataset.attrs["parameters"]) == {"tau": 0.4}
        assert dataset.attrs["doubts"].startswith("The GPS track")
        assert dataset.elevation.attrs["units"] == ("m" if site.map.metric else "1")
        assert ("arbitrary" in dataset.elevation.attrs.get("comment", "")) == (not site.map.metric)
        if site.map.georeference:
            assert dataset.elevation.attrs["grid_mapping"] == "crs"
            assert pyproj.CRS.from_cf(dataset.crs.attrs).to_epsg() == UTM.epsg
            assert dataset.x.attrs["standard_name"] == "projection_x_coordinate"
            assert dataset.attrs["frame"].startswith("x east, y north in EPSG:32617")
        else:
            assert "crs" not in dataset
            assert dataset.attrs["frame"].startswith("local frame")


def test_netcdf_in_plain_hdf5(site):
    with h5py.File(io.BytesIO(encode_netcdf(site))) as file:
        for layer in LAYERS:
            stored = file[layer.name]
            assert stored.compression == "gzip"
            assert ("_FillValue" in stored.attrs) == (np.dtype(layer.dtype).kind == "f")
            np.testing.assert_array_equal(stored[()], expected(site, layer.name))
            assert [scale.values()[0].name for scale in stored.dims] == ["/y", "/x"]


def test_netcdf_opens_in_gdal_north_up():
    site = example_site(cell=0.05)
    with MemoryFile(encode_netcdf(site), ext=".nc") as memory:
        if "netCDF" not in rasterio.drivers.raster_driver_extensions().values():
            pytest.skip("this GDAL has no netCDF driver")
        with rasterio.open(f"netcdf:{memory.name}:elevation") as raster:
            assert raster.crs.to_epsg() == UTM.epsg


def test_long_provenance_does_not_break_the_file():
    site = example_site()
    site.run["inputs"] = {f"IMG_{i:05d}.JPG": "0" * 64 for i in range(2000)}
    with xarray.open_dataset(io.BytesIO(encode_netcdf(site)), engine="h5netcdf") as dataset:
        assert dataset.attrs["run_inputs"] == "too long for an attribute: see run.json"


@pytest.mark.parametrize("layer", LAYERS, ids=lambda layer: layer.name)
def test_geotiff_of_every_layer(site, layer):
    with MemoryFile(encode_geotiff(site.map, layer.name)) as memory, memory.open() as raster:
        assert raster.dtypes == (layer.dtype,)
        np.testing.assert_array_equal(raster.read(1), expected(site, layer.name))
        assert raster.nodata == layer.fill or (np.isnan(raster.nodata) and np.isnan(layer.fill))
        assert raster.overviews(1) == [2]
        assert raster.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert raster.descriptions == (layer.name,)
        assert raster.tags(1)["meaning"] == layer.meaning
        for value, name in layer.categories.items():
            assert raster.tags(1)[f"class_{value}"] == name
        assert raster.units == ({"m": site.map.unit, "1": ""}[layer.unit] or None,)
        if site.map.georeference:
            assert raster.crs.to_epsg() == UTM.epsg
        else:
            assert (raster.crs is not None) == site.map.metric
            assert site.map.metric is False or "ExcavaTwin local frame" in raster.crs.wkt


def test_geotiff_lies_where_the_map_says(site):
    with MemoryFile(encode_geotiff(site.map, "elevation")) as memory, memory.open() as raster:
        x, y = raster.xy(0, 0)  # centre of the north-west cell
        assert x == pytest.approx(site.map.grid.x[0] + origin(site)[0], abs=1e-6)
        assert y == pytest.approx(site.map.grid.y[0] + origin(site)[1], abs=1e-6)
        assert raster.transform.e < 0
        west, north = site.map.grid.x[40] + origin(site)[0], site.map.grid.y[7] + origin(site)[1]
        (sampled,) = next(raster.sample([(west, north)]))
        assert sampled == expected(site, "elevation")[7, 40]


def test_label_colours_and_names(tmp_path):
    m = example_map()
    (tmp_path / "label.tif").write_bytes(encode_geotiff(m, "label"))
    (tmp_path / "label.tif.aux.xml").write_text(category_sidecar("label"))
    with rasterio.open(tmp_path / "label.tif") as raster:
        colours = raster.colormap(1)
        assert {int(k): colours[int(k)][:3] for k in PALETTE} == {int(k): rgb for k, rgb in PALETTE.items()}
    rasterio.shutil.copy(tmp_path / "label.tif", tmp_path / "label.vrt", driver="VRT")
    vrt = (tmp_path / "label.vrt").read_text()  # GDAL's own view of the file
    assert vrt.index("<Category>unknown</Category>") < vrt.index("<Category>obstacle</Category>")
    assert vrt.count("<Category>") == 6


def test_cloud_optimised_layout():
    """Image file directories come first, then overviews; tiles follow, small to big."""
    content = encode_geotiff(example_map(cell=0.03), "elevation")
    assert content[:4] == b"II*\0"
    offset, tiles = struct.unpack_from("<I", content, 4)[0], []
    directories = []
    while offset:
        directories.append(offset)
        (count,) = struct.unpack_from("<H", content, offset)
        for i in range(count):
            tag, kind, n, value = struct.unpack_from("<HHII", content, offset + 2 + 12 * i)
            if tag == 324:  # TileOffsets
                assert kind == 4
                tiles.append(value if n == 1 else struct.unpack_from("<I", content, value)[0])
        (offset,) = struct.unpack_from("<I", content, offset + 2 + 12 * count)
    assert len(directories) == len(tiles) >= 3
    assert directories == sorted(directories)
    assert tiles == sorted(tiles, reverse=True)
    assert max(directories) < min(tiles)
    assert b"LAYOUT=IFDS_BEFORE_DATA" in content[:300]


def test_layer_table_says_all():
    rows = {row.name: row for row in describe_layers()}
    assert list(rows) == [layer.name for layer in LAYERS]
    assert rows["elevation"].unit == "m"
    assert rows["elevation"].fill == "nan"
    assert rows["label"].values.startswith("0 unknown, 1 construction_terrain")
    assert rows["label"].values.endswith("255 not_observed")
    assert all(row.meaning for row in rows.values())
