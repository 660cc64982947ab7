"""Point clouds with cameras from every kind of file; the last one goes on to a map."""

from __future__ import annotations

import json
from dataclasses import replace

import laspy
import numpy as np
import pyproj
import pytest
from PIL import Image
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from excavatwin.backbones.reconstructors.cloud import Cloud
from excavatwin.capture import find_photos
from excavatwin.errors import InputError
from finished_site import assert_true, shots, spec, write_colmap, write_photos

H, W = shots()[0].depth.shape
K = shots()[0].K
ORIGIN = np.array([431_700.0, 5_301_800.0, 450.0])
OPENGL = np.diag([1.0, -1, -1, 1])


def write_cloud(path, points, epsg=None, unit=None):
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, 0.001), np.floor(points.min(axis=0))
    if epsg or unit:
        header.add_crs(pyproj.CRS.from_epsg(epsg or unit))
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    path.parent.mkdir(parents=True, exist_ok=True)
    las.write(path)


def points(shift=(0.0, 0.0, 0.0)):
    found = np.concatenate([shot.points[np.isfinite(shot.depth)] for shot in shots()]).astype(float)
    return found[::3] + np.asarray(shift)


def absolute(T):
    T = T.copy()
    T[:3, 3] += ORIGIN
    return T


def write_csv(path, *, lens=True, sep=","):
    columns = ["imageName", "X", "Y", "Z", "Omega", "Phi", "Kappa"]
    columns += ["f", "cx", "cy", "width", "height"] if lens else []
    rows = [sep.join(columns)]
    for shot in shots():
        T = absolute(shot.T)
        angles = Rotation.from_matrix(T[:3, :3] @ OPENGL[:3, :3]).as_euler("XYZ", degrees=True)
        values = [shot.name, *(f"{value:.9f}" for value in (*T[:3, 3], *angles))]
        values += [f"{value:.6f}" for value in (K[0, 0], K[0, 2], K[1, 2], W, H)] if lens else []
        rows.append(sep.join(values))
    path.write_text("\n".join(rows) + "\n")


def write_transforms(path):
    frames = [
        {"file_path": f"images/{shot.name}", "transform_matrix": (absolute(shot.T) @ OPENGL).tolist()}
        for shot in shots()
    ]
    meta = {"fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2], "cy": K[1, 2], "w": W, "h": H, "frames": frames}
    path.write_text(json.dumps(meta))


def write_opensfm(path):
    from test_backbones_imports_opendronemap import write_reconstruction

    size = max(W, H)
    camera = {
        "projection_type": "brown",
        "width": W,
        "height": H,
        "k1": 0.0,
        "k2": 0.0,
        "k3": 0.0,
        "p1": 0.0,
        "p2": 0.0,
    }
    camera |= {"focal_x": K[0, 0] / size, "focal_y": K[1, 1] / size}
    camera |= {"c_x": (K[0, 2] - W / 2) / size, "c_y": (K[1, 2] - H / 2) / size}
    write_reconstruction(path, {shot.name: absolute(shot.T) for shot in shots()}, camera)


def write_cameras(folder, kind):
    if kind == "colmap":
        camera = spec("PINHOLE", W, H, K[0, 0], K[1, 1], K[0, 2], K[1, 2])
        poses = {shot.name: absolute(shot.T) for shot in shots()}
        write_colmap(folder / "sparse" / "0", dict.fromkeys(poses, camera), poses)
    elif kind == "transforms":
        write_transforms(folder / "transforms.json")
    elif kind == "opensfm":
        write_opensfm(folder / "reconstruction.json")
    else:
        write_csv(folder / "cameras.csv", sep={"csv": ",", "spaces": " ", "tabs": "\t"}[kind])


@pytest.mark.parametrize("kind", ["colmap", "transforms", "opensfm", "csv", "spaces", "tabs"])
def test_a_georeferenced_cloud_with_cameras_of_any_kind(tmp_path, kind):
    """Full coordinates of a CRS: R's origin is whole metres near the cameras, and float32 keeps the points."""
    photos = write_photos(tmp_path / "photos")
    write_cloud(tmp_path / "scan" / "scan.laz", points(ORIGIN), 32632)
    write_cameras(tmp_path / "scan", kind)
    obs = Cloud(source=str(tmp_path / "scan" / "scan.laz"))(photos)
    assert obs.georeference.epsg == 32632
    shift = np.array(obs.georeference.origin) - ORIGIN
    assert np.array_equal(shift, np.round(shift))
    moved = []
    for view in obs.views:
        T = view.T_R_cam.copy()
        T[:3, 3] += shift
        np.testing.assert_allclose(T, shots()[len(moved)].T, atol=1e-5)
        moved.append(replace(view, points=(view.points + shift).astype(np.float32), T_R_cam=T))
    assert_true(replace(obs, views=tuple(moved)), tolerance=3e-3, covered=0.85)
    assert obs.metres_per_unit == 1.0


def test_a_table_without_a_lens_asks_the_photo(tmp_path):
    photos = write_photos(tmp_path / "photos")
    write_cloud(tmp_path / "scan.las", points(ORIGIN))
    write_csv(tmp_path / "cameras.csv", lens=False)
    with pytest.raises(InputError, match=r"neither the file of cameras nor shot_00\.png tells a focal length"):
        Cloud(source=str(tmp_path))(photos)
    known = [replace(photo, focal=K[0, 0], focal_source="exif-35mm") for photo in photos]
    obs = Cloud(source=str(tmp_path))(known)
    assert "tells no lens" in obs.doubts[0]
    assert obs.metres_per_unit is None  # no CRS: nobody says that these are metres
    assert np.array_equal(obs.up, (0, 0, 1))
    assert np.abs(np.array(obs.source["origin"].split(), float)).max() > 1e6


def test_a_site_is_seen_again(tmp_path, dig_site, dig_site_map):
    """points.laz and cameras.json of a SITE that we exported."""
    import tiny_site
    from excavatwin.export import write_site

    site = tmp_path / "site"
    write_site(dig_site_map, site)
    (tmp_path / "photos").mkdir()
    rng = np.random.default_rng(0)
    for view in dig_site.views:
        Image.fromarray(rng.integers(0, 255, (*view.shape, 3), np.uint8)).save(tmp_path / "photos" / view.name)
    obs = Cloud(source=str(site))(find_photos(tmp_path / "photos"))
    truth = tiny_site.observations(emulation=tiny_site.Emulation(noise=0.0))
    for view, true in zip(obs.views, truth.views, strict=True):
        np.testing.assert_allclose(view.T_R_cam, true.T_R_cam, atol=1e-6)
        error = np.linalg.norm(view.points - true.points, axis=-1)
        assert np.nanmedian(error) < 0.1
        assert np.isfinite(error).mean() > 0.6
    assert obs.metres_per_unit == 1.0


def test_refusals(tmp_path):
    photos = write_photos(tmp_path / "photos")
    scan = tmp_path / "scan.laz"
    write_cloud(scan, points(ORIGIN), 32632)
    with pytest.raises(InputError, match=r"scan\.laz lies beside no cameras \(cameras\.json, transforms\.json"):
        Cloud(source=str(scan))(photos)
    with pytest.raises(InputError, match=r"nowhere\.json does not exist; give the cameras of"):
        Cloud(source=str(scan), cameras=str(tmp_path / "nowhere.json"))(photos)
    write_csv(tmp_path / "cameras.csv")
    write_cloud(tmp_path / "second.laz", points(ORIGIN))
    with pytest.raises(InputError, match="holds 2 point clouds; name the one"):
        Cloud(source=str(tmp_path))(photos)
    with pytest.raises(InputError, match=r"cameras\.csv is no point cloud that can be read"):
        Cloud(source=str(tmp_path / "cameras.csv"))(photos)
    write_cloud(scan, points(ORIGIN + np.array([3000, 0, 0])), 32632)
    with pytest.raises(
        InputError, match=r"no point of .*scan\.laz lies in any of the photos; the cloud and the cameras"
    ):
        Cloud(source=str(scan))(photos)
    write_cloud(scan, points(), unit=4326)
    with pytest.raises(InputError, match=r"scan\.laz is in WGS 84, not in a projected CRS"):
        Cloud(source=str(scan))(photos)
    write_cloud(scan, points(), unit=2263)
    with pytest.raises(InputError, match=r"scan\.laz counts in US survey foot; convert it to metres first"):
        Cloud(source=str(scan))(photos)
    write_cloud(scan, points(ORIGIN), 32632)
    table = tmp_path / "cameras.csv"
    table.write_text("name,x,y,z,omega,phi\na,1,2,3,4,5\n")
    with pytest.raises(InputError, match=r"cameras\.csv lacks the column kappa"):
        Cloud(source=str(scan))(photos)
    table.write_text("name,x,y,z,omega,phi,kappa\na,1,2,3,4,5,six\n")
    with pytest.raises(InputError, match=r"cameras\.csv, row 2 is incomplete or holds a word"):
        Cloud(source=str(scan))(photos)
    table.unlink()
    (tmp_path / "cameras.json").write_text('{"cameras": 3}')
    with pytest.raises(InputError, match=r"cameras\.json is no file of cameras that is known"):
        Cloud(source=str(scan))(photos)


@pytest.mark.parametrize("suffix", [".laz", ".las"])
def test_a_cloud_that_was_cut_off_is_refused(tmp_path, suffix):
    """The header is whole, so that it opens; the points are not."""
    photos = write_photos(tmp_path / "photos")
    scan = tmp_path / f"scan{suffix}"
    write_cloud(scan, points(ORIGIN), 32632)
    scan.write_bytes(scan.read_bytes()[:4000])
    write_csv(tmp_path / "cameras.csv")
    with pytest.raises(InputError, match=r"scan\.la[sz] cannot be read as LAS or LAZ .*copy it again"):
        Cloud(source=str(scan))(photos)


def test_identity_follows_the_files(tmp_path):
    write_cloud(tmp_path / "scan.laz", points())
    write_csv(tmp_path / "cameras.csv")
    model = Cloud(source=str(tmp_path))
    before = model.identity()
    assert Cloud(source=str(tmp_path)).identity() == before
    write_csv(tmp_path / "cameras.csv", lens=False)
    assert model.identity() != before
    assert "none" in Cloud().identity()


def test_photos_become_a_map_through_a_finished_reconstruction(tmp_path):
    """The whole way: a scan with cameras, the built-in segmenter, the mapper; heights equal the truth."""
    from excavatwin.backbones.appearance import Appearance
    from excavatwin.backbones.protocols import Picture
    from excavatwin.mapper import Mapper

    photos = write_photos(tmp_path / "photos")
    write_cloud(tmp_path / "scan.laz", points(ORIGIN), 32632)
    write_csv(tmp_path / "cameras.csv")
    obs = Cloud(source=str(tmp_path))(photos)
    seen = []
    for view in obs.views:
        result = Appearance()(Picture(view.image, view.name, view.lattice))
        seen.append(replace(view, evidence=result.evidence))
    site = Mapper()(replace(obs, views=tuple(seen)))
    grid = site.map.grid
    x, y = np.meshgrid(grid.x, grid.y)
    shift = np.array(obs.georeference.origin) - ORIGIN
    true = np.concatenate([shot.points[np.isfinite(shot.depth)] for shot in shots()])
    cells = np.stack([x.ravel(), y.ravel()], axis=1) + shift[:2]
    distance, nearest = cKDTree(true[:, :2]).query(cells)
    use = (site.map.elevation.ravel() > -np.inf) & (distance < 0.1) & (np.abs(cells) < 8).all(1)
    error = site.map.elevation.ravel()[use] + shift[2] - true[nearest[use], 2]
    assert use.sum() > 300
    assert np.median(np.abs(error)) < 0.06
