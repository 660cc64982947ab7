"""The sample that ships with the project: photos as a drone would have brought them home, and the truth beside them."""

from __future__ import annotations

from datetime import datetime, timedelta
from fractions import Fraction
from pathlib import Path

import numpy as np
from jaxtyping import Float64, UInt8
from PIL import Image, TiffImagePlugin

from excavatwin.scene.observations import Georeference
from excavatwin.scene.progress import Progress, silent
from excavatwin.simulation.camera import Camera, orbit
from excavatwin.simulation.render import render_view
from excavatwin.simulation.site import DigSite
from excavatwin.simulation.truth import save_truth, site_truth

PLACE = Georeference(32632, (691000.0, 5334000.0, 520.0), 0.0)
"""Where the made-up site lies; altitudes are above the ellipsoid."""
FILM = 27
"""Equivalent focal length on a frame of 36 mm x 24 mm: an integer, as EXIF wants it, and the true one [mm]."""
FOCAL_RATIO = FILM / np.hypot(36, 24) * 1.25
"""True focal length over image width: CIPA DCG-001 relates the diagonals, and that of a 4:3 image is 1.25 widths."""
SENSOR = 6.4
"""Width of the sensor [mm]."""
SIGMA = (0.02, 0.03)
"""Standard deviation of the written positions, horizontal and vertical, as of RTK [m]."""
START = datetime(2025, 5, 20, 10, 0, 0)


def render_sample(out: Path, seed: int = 7, views: int = 14, width: int = 1280, progress: Progress = silent) -> None:
    """Render the sample into ``out``: ``photos/DIG_*.jpg`` and ``truth.npz``.

    Args:
        out: folder, made when it is missing.
        seed: of the site, the flight and the noise.
        views: number of photos on the orbit.
        width: of the photos [px].
    """
    site = DigSite(seed=seed)
    cameras = orbit(views, width=width, focal_ratio=FOCAL_RATIO, seed=seed)
    names = [f"DIG_{number:04d}.jpg" for number in range(1, views + 1)]
    (out / "photos").mkdir(parents=True, exist_ok=True)
    for number, (name, camera) in enumerate(zip(names, cameras, strict=True)):
        image = render_view(site, camera).image
        error = np.random.default_rng((seed, number)).normal(size=3) * np.array([SIGMA[0], SIGMA[0], SIGMA[1]])
        write_photo(out / "photos" / name, image, camera, error, START + timedelta(seconds=5 * number))
        progress("render", number + 1, views)
    save_truth(site_truth(site, list(zip(names, cameras, strict=True)), georeference=PLACE), out / "truth.npz")


def write_photo(
    path: Path, image: UInt8[np.ndarray, "H W 3"], camera: Camera, error: Float64[np.ndarray, "3"], time: datetime
) -> None:
    """Write a JPEG with the EXIF and XMP that a drone with RTK writes.

    Args:
        error: of the written position, east, north, up [m].
    """
    import pyproj

    easting, northing, altitude = np.array(PLACE.origin) + camera.T_M_cam[:3, 3] + error
    utm = pyproj.Proj(PLACE.epsg)
    longitude, latitude = utm(easting, northing, inverse=True)
    convergence = utm.get_factors(longitude, latitude).meridian_convergence
    exif = Image.Exif()
    exif[0x010F], exif[0x0110], exif[0x0132] = "ExcavaTwin", "sample camera", f"{time:%Y:%m:%d %H:%M:%S}"
    detail = exif.get_ifd(0x8769)
    detail[0x9003] = f"{time:%Y:%m:%d %H:%M:%S}"
    detail[0x920A] = rational(FOCAL_RATIO * SENSOR, 10000)
    detail[0xA405] = FILM
    detail[0xA002], detail[0xA003] = camera.width, camera.height
    gps = exif.get_ifd(0x8825)
    gps[0] = b"\x02\x03\x00\x00"
    gps[1], gps[2] = "N" if latitude >= 0 else "S", sexagesimal(abs(latitude))
    gps[3], gps[4] = "E" if longitude >= 0 else "W", sexagesimal(abs(longitude))
    gps[5], gps[6] = b"\x00", rational(altitude, 1000)
    gps[18] = "WGS-84"
    Image.fromarray(image).save(
        path, quality=90, subsampling=2, optimize=True, exif=exif.tobytes(), xmp=drone_xmp(camera, convergence)
    )


def rational(value: float, denominator: int) -> TiffImagePlugin.IFDRational:
    """A number as EXIF writes it."""
    return TiffImagePlugin.IFDRational(Fraction(round(value * denominator), denominator))


def sexagesimal(degrees: float) -> tuple[TiffImagePlugin.IFDRational, ...]:
    """Degrees, minutes and seconds; the seconds to 0.03 mm on the ground."""
    minutes = degrees % 1 * 60
    return rational(int(degrees), 1), rational(int(minutes), 1), rational(minutes % 1 * 60, 1_000_000)


def drone_xmp(camera: Camera, convergence: float) -> bytes:
    """Attitude and position accuracy in the tags that DJI's drones use; yaw is clockwise from true north."""
    forward, right, down = camera.T_M_cam[:3, 2], camera.T_M_cam[:3, 0], camera.T_M_cam[:3, 1]
    yaw = np.rad2deg(np.arctan2(forward[0], forward[1])) + convergence
    pitch = np.rad2deg(np.arcsin(forward[2]))
    roll = np.rad2deg(np.arctan2(-right[2], -down[2]))
    tags = {
        "GimbalYawDegree": f"{(yaw + 180) % 360 - 180:+.2f}",
        "GimbalPitchDegree": f"{pitch:+.2f}",
        "GimbalRollDegree": f"{roll:+.2f}",
        "RtkStdLat": f"{SIGMA[0]:.5f}",
        "RtkStdLon": f"{SIGMA[0]:.5f}",
        "RtkStdHgt": f"{SIGMA[1]:.5f}",
    }
    attributes = " ".join(f'drone-dji:{name}="{value}"' for name, value in tags.items())
    return (
        '<?xpacket begin="" id="W5M0MpCehiHzreSzNTczkc9d"?><x:xmpmeta xmlns:x="adobe:ns:meta/">'
        '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        '<rdf:Description rdf:about="" xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" '
        f'{attributes}/></rdf:RDF></x:xmpmeta><?xpacket end="w"?>'
    ).encode()
